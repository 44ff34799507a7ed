"""Steps of joints in the kernel: arrays that are written, one call, arrays that are read."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from .replies import Floats

if TYPE_CHECKING:
    from .binding import PackedTable

FREEDOMS = 6  # of an interface: three translations, then three rotations
OK, NOT_FINITE, SINGULAR, INDEFINITE, NO_MASS = 0, 1, 5, 7, 8  # of the statuses in wrenchbook.h
REPLY = np.dtype(
    [
        *((name, float, 6) for name in ("wrench", "displacement", "still", "force")),
        *((name, float, (6, 6)) for name in ("rate", "stiffness")),
        ("spin", float, (3, 3)),
        *((name, float, 6) for name in ("frequency", "pose_error", "wrench_error")),
        ("ranges", float),
        *((name, np.int32) for name in ("coverage", "status")),
    ]
)

_LARGEST = np.dtype([(name, float, 6) for name in ("value", "step", "time")])
HISTORY = np.dtype(
    [
        *((name, float) for name in ("steps", "covered", "time")),
        *((name, _LARGEST) for name in ("pose_error", "wrench_error")),
        ("stored", float),
        *((name, float, 6) for name in ("still", "displacement")),
    ]
)


class _Options(ctypes.Structure):
    """`wb_joint` of wrenchbook.h; its first three are those of `wb_options`."""

    _fields_ = (
        *(("method", ctypes.c_int), ("tolerance", ctypes.c_void_p), ("rows", ctypes.c_int)),
        *((name, ctypes.c_void_p) for name in ("inputs", "axes")),
        *((name, ctypes.c_double) for name in ("dt", "damping")),
        *((name, ctypes.c_int) for name in ("first", "errors")),
    )


class JointSteps:
    """n joints of one table; see ``wb_joint_step``. `arguments` of ``table.joints`` made them.

    Attributes
    ----------
    inputs : ndarray
        Shape (n inputs of the table,), SI: the further inputs as they are.
    poses, velocities, inverse_masses : ndarray
        Shapes (n, 7), (n, 6) and (n, 6, 6): write them, then call `step` or `law`.
    replies : structured ndarray
        Shape (n,), of `REPLY`, named as ``wb_joint_reply`` has them.
    memory : ndarray
        Shape (n, k): what joints keep from step to step; zeros forget it.
    history : structured ndarray
        Shape (n,), of `HISTORY`: the end of the memory, as the kernel's ``history`` has it.
    """

    def __init__(
        self,
        table: PackedTable,
        call: Callable[..., int],
        count: int,
        options: tuple[int, int, Floats | None],
        sizes: tuple[int, int],
        arguments: tuple[Any, ...],
    ) -> None:
        """Take the kernel's call, the first load, method and axes, and memory and scratch."""
        first, method, self._axes = options
        self._table, self._call, self.arguments = table, call, arguments
        self.inputs = np.zeros(table.inputs)
        self.poses, self.velocities = np.zeros((count, 7)), np.zeros((count, FREEDOMS))
        self.poses[:, 3] = 1.0
        self.inverse_masses = np.zeros((count, FREEDOMS, FREEDOMS))
        self.memory, self.replies = np.zeros((count, sizes[0])), np.zeros(count, dtype=REPLY)
        behind = sizes[0] - HISTORY.itemsize // 8
        self.history = self.memory[:, behind:].view(HISTORY)[:, 0]
        self._scratch = np.zeros(sizes[1] // 8 + 1)
        self._options = _Options(
            *(method, None, 0, self.inputs.ctypes.data),
            *(None if self._axes is None else self._axes.ctypes.data, 0.0, 0.0, first, 1),
        )
        places = (self.poses, self.velocities, self.inverse_masses, self.memory, self.replies)
        poses, velocities, masses, memory, replies = (array.ctypes.data for array in places)
        head = ctypes.addressof(self._options), count, poses
        self._step = *head, velocities, masses, memory, replies
        self._law = *head, None, masses, memory, replies
        self._state = *head, None, None, memory, replies
        self._at = self._scratch.ctypes.data

    def __reduce__(self) -> tuple[Any, ...]:
        """Make a copy by the table, then write its arrays."""
        names = "inputs", "poses", "velocities", "inverse_masses", "memory", "replies"
        return self._table.joints, self.arguments, {name: getattr(self, name) for name in names}

    def __setstate__(self, arrays: dict[str, Floats]) -> None:
        for name, array in arrays.items():
            getattr(self, name)[:] = array

    def step(self, dt: float, damping: float, threads: int = 1) -> None:
        """Find the wrenches of a step of dt, s; damping is a share of critical."""
        self._options.dt, self._options.damping = dt, damping
        self._done(self._call(self._table.handle, *self._step, threads, self._at))

    def law(self, dt: float, damping: float, threads: int = 1) -> None:
        """Find wrench and rate at the poses, for a simulator that has the step's velocity later."""
        self._options.dt, self._options.damping = dt, damping
        self._done(self._call(self._table.handle, *self._law, threads, self._at))

    def state(self) -> None:
        """Find the wrenches of the poses."""
        self._done(self._call(self._table.handle, *self._state, 1, self._at))

    def _done(self, wrong: int) -> None:
        if wrong:
            raise MemoryError("no memory for the joints")
