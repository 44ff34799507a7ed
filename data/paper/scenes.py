"""The MuJoCo scenes: a block that is pressed, and an arm that moves."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from data.paper.part import Mask, Vector
from wrenchbook.service.client.mount.mujoco_mount import MujocoMount, engine

ARM = Path(__file__).parents[1] / "scenes" / "arm.xml"

BLOCK_WEIGHT = 0.01 * 9.81  # N, of a block of 10 g: it shows that the sign is right
# Steps that a load stays: the pose follows the answer, and the lever moves with the pose; each
# step multiplies the remaining error by some 1e-3.
HOLD = 8
SYNC = 0.01  # s
WAYPOINTS = np.array(
    [
        [0.0, 0.4, 0.8, 0.0, 0.5, 0.0],
        [0.6, 0.7, 0.5, 0.4, 0.1, 0.5],
        [-0.9, 0.2, 1.2, -0.5, 0.8, -0.4],
    ]
)  # rad, of the six joints

_BLOCK = """
<mujoco>
  <worldbody>
    <body name="base" mocap="true" pos="0 0 0">
      <body name="mounted">
        <site name="mount"/>
        <geom type="sphere" size="0.01" mass="0.01" pos="{lever} 0 0" contype="0" conaffinity="0"/>
      </body>
    </body>
  </worldbody>
  <sensor>
    <force name="mount_force" site="mount"/>
    <torque name="mount_torque" site="mount"/>
  </sensor>
</mujoco>
"""


@dataclass(frozen=True, eq=False)
class LoopRun:
    """The record of a simulation at n times."""

    times: Vector  # (n,), s
    wrenches: Vector  # (n, 6), N and N·m, as read from the sensors
    displacements: Vector  # (n, 6), m and rad, of the interface in the simulation
    covered: Mask  # (n,): whether the last answer was covered
    coverage: tuple[int, int, int, int]  # answers that were covered, thin, outside, unknown
    wall_s: float  # duration of the run


def press(source: Any, component: str, loads: Any, lever: float = 0.0, **options: Any) -> LoopRun:
    """Press a component downwards by loads (n,), N, one by one, and read pose and sensors.

    The loads act at a `lever`, m, along x. `source` is a `Table` or a `Client`; `options` are those
    of the mount.
    """
    model = engine.MjModel.from_xml_string(_BLOCK.format(lever=lever))
    data = engine.MjData(model)
    mounted = engine.mj_name2id(model, engine.mjtObj.mjOBJ_BODY, "mounted")
    mount = MujocoMount(model, data, source=source, component=component, **options)
    began, trace = perf_counter(), _Trace(mount, data)
    for load in loads:
        data.xfrc_applied[mounted, 2] = BLOCK_WEIGHT - load  # at the block, in the world's axes
        for _ in range(HOLD):
            engine.mj_step(model, data)
            mount.step()
        trace.record()
    mount.close()
    return trace.run(perf_counter() - began)


def move_arm(source: Any, component: str, seconds: float, **options: Any) -> LoopRun:
    """Move the arm past its waypoints in `seconds` on a component; others as of `press`."""
    model = engine.MjModel.from_xml_path(str(ARM))
    data = engine.MjData(model)
    data.qpos[:], data.ctrl[:] = WAYPOINTS[0], WAYPOINTS[0]
    mount = MujocoMount(model, data, source=source, component=component, sync=SYNC, **options)
    began, trace = perf_counter(), _Trace(mount, data)
    while data.time < seconds:
        data.ctrl[:] = _between_waypoints(data.time / seconds)
        engine.mj_step(model, data)
        if mount.step():
            trace.record()
    mount.close()
    return trace.run(perf_counter() - began)


class _Trace:
    """Collects what a simulation meets; the interface's displacement is read off the mocap body."""

    def __init__(self, mount: MujocoMount, data: Any) -> None:
        self._mount, self._data = mount, data
        self._point = data.mocap_pos[0].copy()
        self._lines: list[Vector] = []
        self._covered: list[bool] = []

    def record(self) -> None:
        """Note time, reading and pose."""
        rotation = np.empty(3)
        engine.mju_quat2Vel(rotation, self._data.mocap_quat[0], 1.0)  # rad: its rotation vector
        moved = self._data.mocap_pos[0] - self._point
        wrench, answer = self._mount.wrench, self._mount.mount.last
        assert wrench is not None
        # Without an answer, while wrenches are recorded, there is nothing to be covered.
        self._covered.append(answer is not None and answer.covered)
        self._lines.append(np.concatenate([[self._data.time], wrench, moved, rotation]))

    def run(self, wall_s: float) -> LoopRun:
        """Return all that was noted in a run of so many seconds."""
        lines, coverage = np.array(self._lines), self._mount.mount.coverage
        counts = (coverage.covered, coverage.thin, coverage.outside, coverage.unknown)
        covered = np.array(self._covered)
        return LoopRun(lines[:, 0], lines[:, 1:7], lines[:, 7:], covered, counts, wall_s)


def _between_waypoints(part: float) -> Vector:
    """Return joint angles, shape (6,), rad, at a part of the way, 0 to 1; at rest at waypoints."""
    legs = len(WAYPOINTS) - 1
    leg = min(int(part * legs), legs - 1)
    along = min(max(part * legs - leg, 0.0), 1.0)
    smooth = along**3 * (10 - 15 * along + 6 * along**2)  # no jerk at the ends
    return WAYPOINTS[leg] + (WAYPOINTS[leg + 1] - WAYPOINTS[leg]) * smooth
