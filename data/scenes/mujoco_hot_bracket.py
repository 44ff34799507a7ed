"""A mass in MuJoCo that swings on the shipped `hot_bracket` while the bracket heats up.

Start ``wrenchbook serve``, then ``python data/scenes/mujoco_hot_bracket.py``: a pendulum of 3 kg
hangs from the bracket's seat. Five times its wrench is read from the simulation, the bracket's
temperature goes from 20 to 120 degC, and the server answers how far the seat moved.
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
  <worldbody>
    <body name="seat">
      <site name="seat"/>
      <geom type="box" size="0.02 0.02 0.002" mass="0.1"/>
      <body name="mass">
        <joint type="hinge" axis="1 0 0" damping="0.01"/>
        <geom type="sphere" size="0.04" pos="0 0 -0.2" mass="3" contype="0" conaffinity="0"/>
      </body>
    </body>
  </worldbody>
  <sensor><force site="seat"/><torque site="seat"/></sensor>
</mujoco>
"""
COLD, HOT = 20.0, 120.0  # degC


def main(server: str, seconds: float) -> float:
    """Run the swing, and return the largest translation of the seat, m."""
    model = mujoco.MjModel.from_xml_string(MODEL)
    data = mujoco.MjData(model)
    data.qpos[:] = 0.5
    largest = 0.0
    with Client(server, timeout=120) as client:
        for part in np.linspace(0.2, 1.0, 5):
            while data.time < part * seconds:
                mujoco.mj_step(model, data)
            mujoco.mj_forward(model, data)
            wrench = conventions.from_mujoco(*data.sensordata.reshape(2, 3), "parent")
            warm = {"temperature": COLD + (HOT - COLD) * float(part)}
            answer = client.displacement(
                "hot_bracket", wrench[:3], wrench[3:], inputs=warm, on_thin="wait", wait_s=100
            )
            moved = answer.translation
            assert moved is not None  # it waited for the solve
            print(f"{data.time:.2f} s: {wrench[:3].round(1)} N at {warm['temperature']:.0f} degC:")
            print(f"  the seat moves by {(1e3 * moved).round(3)} mm ({answer.source})")
            largest = max(largest, float(np.linalg.norm(moved)))
    print(f"largest translation: {1e3 * largest:.3f} mm")
    return largest


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    server = os.environ.get("WRENCHBOOK_SERVER", "http://127.0.0.1:8000")
    parser.add_argument("--server", default=server)
    parser.add_argument("--seconds", type=float, default=1.0)
    main(**vars(parser.parse_args()))
