"""Steps of joints in the kernel: the caller writes input arrays, calls once, and reads replies."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from .replies import Floats

if TYPE_CHECKING:
    from .binding import PackedTable

FREEDOMS = 6  # degrees of freedom of an interface: three translations, then three rotations
MAX_INTERFACES = 4  # the largest number of interfaces of a joint, as in wb_joint.c


def shape_of(interfaces: int, *numbers: int) -> tuple[int, ...]:
    """Return the shape of an array of k interfaces, (k, *numbers); of one interface (*numbers,)."""
    return numbers if interfaces == 1 else (interfaces, *numbers)


def types_of(k: int) -> tuple[np.dtype[np.void], np.dtype[np.void]]:
    """Return the types of ``wb_joint_reply`` and the kernel's ``history`` for k interfaces."""
    each = shape_of(k, 6)
    square = (6 * k, 6 * k)
    largest = np.dtype([(name, float, each) for name in ("value", "step", "time")])
    reply = [
        *((name, float, each) for name in ("wrench", "displacement", "still", "force")),
        *(
            ("rate", float, square),
            ("stiffness", float, square),
            ("spin", float, shape_of(k, 3, 3)),
        ),
        *((name, float, each) for name in ("frequency", "pose_error", "wrench_error")),
        *(("ranges", float), ("coverage", np.int32, shape_of(k)), ("status", np.int32)),
        *([] if k % 2 else [("unused", np.int32)]),
    ]
    history = [
        *((name, float) for name in ("steps", "covered", "time")),
        *(("pose_error", largest), ("wrench_error", largest), ("stored", float)),
        *((name, float, each) for name in ("still", "displacement")),
        *([] if k == 1 else [("covered_at", float, k)]),
    ]
    return np.dtype(reply), np.dtype(history)


class _Options(ctypes.Structure):
    """`wb_joint` of wrenchbook.h; its first three fields are those of `wb_options`."""

    _fields_ = (
        *(("method", ctypes.c_int), ("tolerance", ctypes.c_void_p), ("rows", ctypes.c_int)),
        *((name, ctypes.c_void_p) for name in ("inputs", "axes")),
        *((name, ctypes.c_double) for name in ("dt", "damping")),
        *(("errors", ctypes.c_int), ("law", ctypes.c_int)),
    )


class JointSteps:
    """n joints of one table, as ``wb_joint_step`` of wrenchbook.h describes them.

    `interfaces`: the number k of interfaces that move; arrays of one interface lack this dimension.
    `poses` (n, k, 7), m and quaternions; `velocities` (n, k, 6), m/s and rad/s; `inverse_masses`
    (n, 6 k, 6 k), 1/kg to 1/(kg·m^2); `inputs` (of the table,), SI, for the further inputs. The
    caller writes these arrays, then calls `step` or `law`.
    `replies` (n,), structured as ``wb_joint_reply``.
    `memory` (n, s): the state of the joints between steps; zeros reset it.
    `history` (n,), structured as the kernel's ``history``: the end of the memory.
    `arguments`: the arguments of `PackedTable.joints` that made the joints.
    """

    def __init__(
        self,
        table: PackedTable,
        call: Callable[..., int],
        arguments: tuple[int, str | None, Floats | None],
        *,
        method: int,
        interfaces: int,
        memory: int,
        scratch: int,
    ) -> None:
        """Allocate the arrays.

        `call`: the kernel's function; `method`: the number of the method.
        `memory`: doubles of a joint's memory; `scratch`: bytes of scratch.
        """
        count, _, self._axes = arguments
        self._table = table
        self._call = call
        self.arguments = arguments
        self.inputs = np.zeros(table.inputs)
        self.interfaces = k = interfaces
        if not 1 <= k <= MAX_INTERFACES:
            raise ValueError(
                f"the table has {k} interfaces that move, those with a freedom that is not locked; "
                f"a joint needs 1 to {MAX_INTERFACES}. Change `locked` in component.toml"
            )
        self.poses, self.velocities = (np.zeros((count, *shape_of(k, m))) for m in (7, FREEDOMS))
        self.poses[..., 3] = 1.0
        self.inverse_masses = np.zeros((count, FREEDOMS * k, FREEDOMS * k))
        reply, history = types_of(k)
        self.memory = np.zeros((count, memory))
        self.replies = np.zeros(count, reply)
        self.history = self.memory[:, -(history.itemsize // 8) :].view(history)[:, 0]
        self._scratch = np.zeros(scratch // 8 + 1)
        self._options = _Options(
            *(method, None, 0, self.inputs.ctypes.data),
            *(None if self._axes is None else self._axes.ctypes.data, 0.0, 0.0, 1, 0),
        )
        buffers = (self.poses, self.velocities, self.inverse_masses, self.memory, self.replies)
        poses, velocities, masses, *state = (array.ctypes.data for array in buffers)
        head = ctypes.addressof(self._options), count, poses
        self._step = *head, velocities, masses, *state
        self._state = *head, None, None, *state
        self._at = self._scratch.ctypes.data

    def __reduce__(self) -> tuple[Any, ...]:
        """Return for pickle: the table and arguments of the joints, and their arrays."""
        names = "inputs", "poses", "velocities", "inverse_masses", "memory", "replies"
        return self._table.joints, self.arguments, {name: getattr(self, name) for name in names}

    def __setstate__(self, arrays: dict[str, Floats]) -> None:
        for name, array in arrays.items():
            getattr(self, name)[:] = array

    def step(self, dt: float, damping: float, threads: int = 1, *, law: bool = False) -> None:
        """Compute the wrenches of a step of `dt`, s; `damping` is a ratio of critical damping.

        `law`: see the method of this name.
        """
        self._options.dt = dt
        self._options.damping = damping
        self._options.law = law
        self._compute(self._step, threads)

    def law(self, dt: float, damping: float, threads: int = 1) -> None:
        """Compute the force, and its rate by the velocities, before a step of `dt`, s.

        The simulator then solves for the velocities after the step.
        """
        self.step(dt, damping, threads, law=True)

    def state(self) -> None:
        """Compute the wrenches of the poses alone, without velocities and masses."""
        self._compute(self._state, 1)

    def _compute(self, arguments: tuple[int | None, ...], threads: int) -> None:
        if self._call(self._table.handle, *arguments, threads, self._at):
            raise MemoryError(f"there is no memory for {len(self.poses)} joints; create fewer")
