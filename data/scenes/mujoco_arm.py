"""A six-joint arm in MuJoCo on a bar that bends.

Start ``wrenchbook serve``, then ``python data/scenes/mujoco_arm.py``: a move of two seconds,
the bar's table downloaded once, answered every 5 ms. Prints how far the bar bent, and how its table
covered that.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import Any

import mujoco as _mujoco
import numpy as np

from wrenchbook import Client, MujocoMount

mujoco: Any = _mujoco  # compiled: it has no types
START = np.array([0.0, 0.4, 0.8, 0.0, 0.5, 0.0])  # rad
END = np.array([0.6, 0.7, 0.5, 0.4, 0.1, 0.5])


def main(server: str, seconds: float) -> float:
    """Run the move, and return the largest translation of the interface, m."""
    model = mujoco.MjModel.from_xml_path(str(Path(__file__).with_name("arm.xml")))
    data = mujoco.MjData(model)
    data.qpos[:], data.ctrl[:] = START, START
    with Client(server, timeout=120) as client:
        client.displacement("bar", [0, 0, -80.0], on_thin="wait", wait_s=100)  # its one solve
        client.component("bar", wait_s=60)  # which waits for the row to be in use
        mount = MujocoMount(model, data, source=client.download("bar"), component="bar", sync=0.005)
        mount.settle()
        largest = 0.0
        while data.time < seconds:
            part = min(data.time / seconds, 1.0)
            data.ctrl[:] = START + (END - START) * part**3 * (10 - 15 * part + 6 * part**2)
            mujoco.mj_step(model, data)
            mount.step()
            largest = max(largest, float(np.linalg.norm(mount.mount.displacement[:3])))
    print(f"wrench at the end: {mount.wrench.round(2).tolist()} N and N·m")
    print(f"largest translation: {1e3 * largest:.3f} mm")
    print(mount.mount.coverage)
    return largest


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    server = os.environ.get("WRENCHBOOK_SERVER", "http://127.0.0.1:8000")
    parser.add_argument("--server", default=server)
    parser.add_argument("--seconds", type=float, default=2.0)
    main(**vars(parser.parse_args()))
