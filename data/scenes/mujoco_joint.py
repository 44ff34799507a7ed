"""A pendulum in MuJoCo at the end of a bar that bends, on a carriage that moves.

Start ``wrenchbook serve``, then ``python data/scenes/mujoco_joint.py``: the carriage swings by 5 cm
at 2 Hz for two seconds, the bar's table is downloaded once. Prints the range of the vertical force,
and how much faster than real time the scene ran.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from pathlib import Path
from typing import Any

import mujoco as _mujoco
import numpy as np

from wrenchbook import Client, MujocoJoint
from wrenchbook.service.client.joint.mujoco_model import scene_with_joint

mujoco: Any = _mujoco  # compiled: it has no types
SCENE = """
<mujoco>
  <option timestep="0.001" integrator="implicitfast"/>
  <default><geom contype="0" conaffinity="0"/></default>
  <worldbody>
    <body name="carriage" pos="0 0 1">
      <joint name="lift" type="slide" axis="0 0 1"/>
      <geom type="box" size=".1 .1 .1" mass="20"/>
      <body name="tip" pos="1 0 0">
        <geom size=".03" mass="1"/>
        <body name="pendulum">
          <joint name="hinge" type="hinge" axis="0 1 0" damping="0.02"/>
          <geom type="capsule" fromto="0 0 0 0 0 -.3" size=".02" mass="2"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator><position joint="lift" kp="4e5" kv="6e3"/></actuator>
</mujoco>
"""


def main(server: str, seconds: float) -> tuple[float, float]:
    """Run the scene, and return the lowest and the highest vertical force on the bar, N."""
    with Client(server, timeout=120) as client:
        client.displacement("bar", [0, 0, -80.0], on_thin="wait", wait_s=100)  # its one solve
        vibration = client.component("bar", wait_s=60)["vibration"]  # waits for the row
        table = client.download("bar")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scene.xml"
        path.write_text(SCENE, encoding="utf-8")
        text = scene_with_joint(path, "carriage", "tip", mass=vibration["condensed_mass"])
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    joint = MujocoJoint(model, data, table, base="carriage", tip="tip")
    data.joint("hinge").qpos[0] = 0.5
    forces, began = [], time.perf_counter()
    while data.time < seconds:
        data.ctrl[0] = 0.025 * (1 - np.cos(2 * np.pi * 2 * data.time))
        joint.step()
        forces.append(joint.wrench[2])
    took = time.perf_counter() - began
    print(f"vertical force on the bar: {min(forces):.1f} to {max(forces):.1f} N")
    print(f"its deflection at the end: {1e3 * joint.displacement[2]:.3f} mm")
    print(f"coverage: {joint.coverage}; {data.time / took:.0f} times real time")
    return min(forces), max(forces)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    server = os.environ.get("WRENCHBOOK_SERVER", "http://127.0.0.1:8000")
    parser.add_argument("--server", default=server)
    parser.add_argument("--seconds", type=float, default=2.0)
    main(**vars(parser.parse_args()))
