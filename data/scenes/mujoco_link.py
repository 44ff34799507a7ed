"""A two-joint arm in MuJoCo whose link, the shipped `link`, bends between its joints.

Start ``wrenchbook serve``, then ``python data/scenes/mujoco_link.py``: both joints swing a tool of
3 kg. Five times in the move the loads at both ends of the link are read from the simulation, and
the server answers how far its right end moved relative to its left one.
"""

from __future__ import annotations

import argparse
import os
from typing import Any

import mujoco as _mujoco
import numpy as np

from wrenchbook import Client, conventions

mujoco: Any = _mujoco  # compiled: it has no types
MODEL = """
<mujoco>
  <option timestep="0.001" integrator="implicitfast"/>
  <default>
    <joint type="hinge" axis="0 1 0" damping="1" armature="0.05"/>
    <geom contype="0" conaffinity="0"/>
    <position kp="2000" kv="80"/>
  </default>
  <worldbody>
    <body name="link" pos="0 0 1">
      <joint name="shoulder"/>
      <site name="left"/>
      <geom type="capsule" fromto="0 0 0 0.35 0 0" size="0.0125" mass="0.1523"/>
      <body name="forearm" pos="0.35 0 0">
        <joint name="elbow"/>
        <site name="right"/>
        <geom type="capsule" fromto="0 0 0 0.25 0 0" size="0.0125" mass="0.5"/>
        <geom type="box" size="0.05 0.05 0.05" pos="0.3 0.05 0" mass="3"/>
      </body>
    </body>
  </worldbody>
  <actuator><position joint="shoulder"/><position joint="elbow"/></actuator>
  <sensor>
    <force site="left"/><torque site="left"/><force site="right"/><torque site="right"/>
  </sensor>
</mujoco>
"""
START, END = np.array([0.0, 0.3]), np.array([-0.8, 1.2])  # rad


def loads(data: Any) -> dict[str, np.ndarray]:
    """Return the wrench on each end of the link, shape (6,), N and N·m, in the link's frame."""
    link, forearm = (data.body(name).xmat.reshape(3, 3) for name in ("link", "forearm"))
    reading = data.sensordata.reshape(4, 3)
    right = conventions.from_mujoco(reading[2], reading[3], "parent")  # the forearm's parent
    return {
        "left": conventions.from_mujoco(reading[0], reading[1], "child"),
        "right": conventions.moved(right, rotation=link.T @ forearm),
    }


def main(server: str, seconds: float) -> float:
    """Run the move, and return the largest translation of the right end, m."""
    model = mujoco.MjModel.from_xml_string(MODEL)
    data = mujoco.MjData(model)
    data.qpos[:], data.ctrl[:] = START, START
    largest = 0.0
    with Client(server, timeout=120) as client:
        for stop in np.linspace(0.2, 1.0, 5) * seconds:
            while data.time < stop:
                part = min(data.time / seconds, 1.0)
                data.ctrl[:] = START + (END - START) * part**3 * (10 - 15 * part + 6 * part**2)
                mujoco.mj_step(model, data)
            mujoco.mj_forward(model, data)
            ends = loads(data)
            answer = client.displacement("link", loads=ends, on_thin="wait", wait_s=100)
            moved = answer.interfaces["right"].translation
            assert moved is not None  # it waited for the solve
            force, moment = ends["right"][:3].round(1), ends["right"][3:].round(2)
            print(f"{data.time:.2f} s: {force} N and {moment} N·m at the right end, ", end="")
            print(f"which moves by {(1e3 * moved).round(3)} mm ({answer.source})")
            largest = max(largest, float(np.linalg.norm(moved)))
    print(f"largest translation: {1e3 * largest:.3f} mm")
    return largest


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    server = os.environ.get("WRENCHBOOK_SERVER", "http://127.0.0.1:8000")
    parser.add_argument("--server", default=server)
    parser.add_argument("--seconds", type=float, default=1.0)
    main(**vars(parser.parse_args()))
