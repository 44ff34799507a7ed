"""The MuJoCo simulations of the paper: a block pressed on a component, an arm that moves on one."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from data.paper.part import Mask, Vector
from wrenchbook.service.client.mount.mujoco_mount import MujocoMount
from wrenchbook.service.client.mujoco import engine

ARM = Path(__file__).parents[1] / "scenes" / "arm.xml"

BLOCK_WEIGHT = 0.01 * 9.81  # N, of a block of 10 g: it shows that the sign is right
# Steps that a load stays: the pose follows the answer, and the lever moves with the pose; each
# step multiplies the remaining error by some 1e-3.
HOLD = 8
SYNC = 0.01  # s between answers of the arm's mount
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
    coverage: dict[str, int]  # numbers of answers that were covered, thin, outside, unknown
    wall_s: float  # duration of the run

    @property
    def not_covered(self) -> int:
        """The number of answers that were not covered."""
        return sum(self.coverage.values()) - self.coverage["covered"]


def press(source: Any, component: str, loads: Any, lever: float = 0.0, **options: Any) -> LoopRun:
    """Press a component downwards by loads (n,), N, in turn; return the record of the run.

    The loads act at a `lever`, m, along x. `source` is a `Table` or a `Client`; `options` are those
    of the mount.
    """
    model = engine.MjModel.from_xml_string(_BLOCK.format(lever=lever))
    data = engine.MjData(model)
    mounted = engine.mj_name2id(model, engine.mjtObj.mjOBJ_BODY, "mounted")
    mount = MujocoMount(model, data, source=source, component=component, **options)
    trace = _Trace(mount, data)
    for load in loads:
        data.xfrc_applied[mounted, 2] = BLOCK_WEIGHT - load  # at the block, in the world's axes
        for _ in range(HOLD):
            engine.mj_step(model, data)
            mount.step()
        trace.record()
    mount.close()
    return trace.run()


def move_arm(source: Any, component: str, seconds: float, **options: Any) -> LoopRun:
    """Move the arm past its waypoints in `seconds` on a component; see `press` for the others."""
    model = engine.MjModel.from_xml_path(str(ARM))
    data = engine.MjData(model)
    data.qpos[:], data.ctrl[:] = WAYPOINTS[0], WAYPOINTS[0]
    mount = MujocoMount(model, data, source=source, component=component, sync=SYNC, **options)
    trace = _Trace(mount, data)
    while data.time < seconds:
        data.ctrl[:] = _between_waypoints(data.time / seconds)
        engine.mj_step(model, data)
        if mount.step():
            trace.record()
    mount.close()
    return trace.run()


class _Trace:
    """Records a simulation; the mocap body has the displacement of the interface."""

    def __init__(self, mount: MujocoMount, data: Any) -> None:
        self._mount, self._data = mount, data
        self._undeformed = data.mocap_pos[0].copy()
        self._began = perf_counter()
        self._records: list[Vector] = []  # time, wrench and displacement
        self._covered: list[bool] = []

    def record(self) -> None:
        """Record the time, the wrench and the displacement."""
        rotation = np.empty(3)
        engine.mju_quat2Vel(rotation, self._data.mocap_quat[0], 1.0)  # its rotation vector, rad
        translation = self._data.mocap_pos[0] - self._undeformed
        wrench, answer = self._mount.wrench, self._mount.mount.last
        assert wrench is not None
        # There is no answer while wrenches are recorded for a table.
        self._covered.append(answer is not None and answer.covered)
        self._records.append(np.concatenate([[self._data.time], wrench, translation, rotation]))

    def run(self) -> LoopRun:
        """Return the records of a simulation that has ended."""
        counts = self._mount.mount.coverage
        records = np.array(self._records)
        return LoopRun(
            times=records[:, 0],
            wrenches=records[:, 1:7],
            displacements=records[:, 7:],
            covered=np.array(self._covered),
            coverage={k: getattr(counts, k) for k in ("covered", "thin", "outside", "unknown")},
            wall_s=perf_counter() - self._began,
        )


def _between_waypoints(fraction: float) -> Vector:
    """Return joint angles (6,), rad, at a fraction of the way, 0 to 1; at rest at waypoints."""
    legs = len(WAYPOINTS) - 1
    leg = min(int(fraction * legs), legs - 1)
    along = min(max(fraction * legs - leg, 0.0), 1.0)
    smooth = along**3 * (10 - 15 * along + 6 * along**2)  # no jerk at the ends
    return WAYPOINTS[leg] + (WAYPOINTS[leg + 1] - WAYPOINTS[leg]) * smooth
