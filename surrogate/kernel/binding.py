"""The kernel's Python binding: `PackedTable`, by ctypes, with numpy and the standard library only.

A single answer keeps the interpreter lock, as it takes microseconds; batches release it.
"""

from __future__ import annotations

import ctypes
import math
import os
import struct
from collections.abc import Sequence
from functools import cache, cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..answer import NAMES
from ..table.rows import NEAR
from ..table.space import Space
from ..table.spread import sample_of, weakest
from .build import ready_library
from .format import CHECKSUM, SOLVER_BARS_COMPLETE, Packed, PackedTableError, map_file, read
from .joint import JointSteps
from .reasons import Reason, text_of
from .replies import (
    AXIS,
    REPLY_SIZE,
    AxisPart,
    Floats,
    Replies,
    Reply,
    ReplyReader,
    Status,
    method_code,
    mistake,
)

_MESSAGE_BYTES = 512  # of a table that cannot be opened; the kernel cuts longer messages


class Kernel(NamedTuple):
    """The library, called with the interpreter lock (`with_gil`) or without it (`without_gil`)."""

    with_gil: ctypes.PyDLL
    without_gil: ctypes.CDLL


@cache
def kernel() -> Kernel:
    """Return the library, after compiling it if its sources have changed.

    Raises KernelBuildError if the library is missing and cannot be compiled.
    """
    path = str(ready_library())
    libraries = Kernel(ctypes.PyDLL(path), ctypes.CDLL(path))
    address, size, integer = ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int
    real = ctypes.c_double
    signatures = {  # result and arguments, as in wrenchbook.h and wb_internal.h
        "wb_open_checked": (address, [address, size, address, size]),
        "wb_close": (None, [address]),
        "wb_inputs": (integer, [address]),
        "wb_outputs": (integer, [address]),
        "wb_scratch": (size, [address]),
        "wb_answer": (integer, [address] * 5),
        "wb_answer_many": (integer, [address, address, size, *[address] * 4, integer]),
        "wb_derivative_many": (integer, [address, address, size, address, address, integer]),
        "wb_inverse": (integer, [address] * 6),
        "wb_joint_rate": (integer, [integer, address, address, real, real, address]),
        "wb_joint_interfaces": (integer, [address]),
        "wb_joint_memory": (size, [address]),
        "wb_joint_step": (integer, [address, address, size, *[address] * 5, integer, address]),
        "wb_axis": (integer, [address, integer, integer, address, address]),
    }
    for library in libraries:
        for name, (result, arguments) in signatures.items():
            function = getattr(library, name)
            function.restype = result
            function.argtypes = arguments
    return libraries


class _Options(ctypes.Structure):
    """The struct `wb_options` of wrenchbook.h."""

    _fields_ = (
        ("method", ctypes.c_int),
        ("tolerance", ctypes.c_void_p),
        ("without_rows", ctypes.c_int),
    )


class _Work:
    """The buffers of one answer: inputs, options, reply and scratch.

    `at`: the addresses of inputs, reply and scratch.
    """

    def __init__(self, inputs: int, outputs: int, scratch: int) -> None:
        """Allocate buffers for numbers of inputs and outputs, and `scratch` bytes."""
        self.inputs = (ctypes.c_double * inputs)()
        self.tolerance = (ctypes.c_double * outputs)()
        self.reply = ctypes.create_string_buffer(REPLY_SIZE)
        self.scratch = (ctypes.c_double * (scratch // 8 + 1))()
        self._options = _Options(-1, None, 0)
        self._pack = struct.Struct(f"={inputs}d").pack_into
        self.at = tuple(map(ctypes.addressof, (self.inputs, self.reply, self.scratch)))

    def fill(self, wrench: Sequence[float]) -> None:
        """Store the n loads of a wrench, N and N·m.

        Raises ValueError if they are not n numbers.
        """
        try:
            self._pack(self.inputs, 0, *wrench)
        except struct.error as error:
            wrong = len(wrench) if len(wrench) != len(self.inputs) else list(wrench)
            raise ValueError(f"a wrench must be {len(self.inputs)} numbers, not {wrong}") from error

    def options(
        self, tolerance: Sequence[float] | None, method: str | None, without_rows: bool = False
    ) -> int | None:
        """Store the options of a request; return their address, None for the component's options.

        The tolerance has m numbers, m and rad; with `without_rows` the method alone answers.

        Raises UnknownMethodError if there is no such method, ValueError if the tolerance has not m
        numbers.
        """
        if tolerance is None and method is None and not without_rows:
            return None
        self._options.method = method_code(method)
        self._options.tolerance = None
        self._options.without_rows = without_rows
        if tolerance is not None:
            if len(tolerance) != len(self.tolerance):
                raise ValueError(
                    f"a tolerance must be {len(self.tolerance)} numbers (m, rad), one for each "
                    f"output, not {len(tolerance)}"
                )
            self.tolerance[:] = tuple(map(float, tolerance))
            self._options.tolerance = ctypes.addressof(self.tolerance)
        return ctypes.addressof(self._options)


class PackedTable:
    """A packed table, made by `open` or `from_bytes`; any number of threads may use it.

    `inputs`, `outputs`: their numbers n and m.
    `size`: bytes of the file.
    `meta`: the table's JSON block: contract, space, interface, groups, sources, provenance.
    `arrays`: read-only views of the mapped file.
    `load_range` (2, n), SI: the lowest and the highest load.
    `load_scale` (n,), SI: half the range, or the larger end.
    `locked` (n,): whether each load acts on a locked freedom.
    `tolerance`: the component's, of a translation, m, and of a rotation, rad; None if it has none.
    `bars_are_complete`: whether the error bars have all their parts.
    `method`: the method of queries without `method`; the table's default if None.
    """

    method: str | None = None

    def __init__(self, handle: int, packed: Packed, source: Floats | Path, size: int) -> None:
        """Take an open handle, the views of the file, its buffer or path, and its bytes' number."""
        self._handle = handle
        self._packed = packed
        self._source = source
        self.size = size
        self.arrays = packed.arrays
        self.meta = packed.meta
        arrays = packed.arrays
        self.load_range, self.load_scale = arrays["space/range"], arrays["space/scale"]
        self.locked = arrays["space/locked"] != 0
        limits = arrays["space/tolerance"][[0, 3]].tolist()
        self.tolerance = None if math.isnan(limits[0]) else (limits[0], limits[1])
        self.bars_are_complete = bool(arrays["solver/flags"][SOLVER_BARS_COMPLETE])
        library = kernel().with_gil
        self._answer = library.wb_answer
        self._release = library.wb_close
        self.inputs, self.outputs = library.wb_inputs(handle), library.wb_outputs(handle)
        self._scratch = library.wb_scratch(handle)
        self._read = ReplyReader(packed, self.inputs, self.outputs).read
        self._idle: list[_Work] = []  # its pop and append are atomic

    @classmethod
    def open(cls, path: str | os.PathLike[str]) -> PackedTable:
        """Map the file of a packed table, after a check of its checksum.

        Raises PackedTableError if the file cannot be opened, is no packed table, damaged, or of
        another format.
        """
        try:
            packed = map_file(path)
            address = np.frombuffer(packed.content, dtype=np.uint8).ctypes.data
            return cls._opened(packed, address, Path(path).resolve())
        except PackedTableError as error:
            raise PackedTableError(f"{path}: {error}") from error
        except OSError as error:
            why = f"{error.strerror or error}; name a .wbt file that this program can read"
            raise PackedTableError(f"{path}: {why}") from error

    @classmethod
    def from_bytes(cls, content: bytes) -> PackedTable:
        """Open the bytes of a packed table.

        Raises PackedTableError as `open`.
        """
        # Doubles, because the kernel needs the bytes at a multiple of eight.
        buffer = np.zeros(len(content) // 8 + 1, dtype=np.float64)
        buffer.view(np.uint8)[: len(content)] = np.frombuffer(content, dtype=np.uint8)
        return cls._from_buffer(buffer, len(content))

    @classmethod
    def _from_buffer(cls, buffer: Floats, size: int) -> PackedTable:
        """Open a packed table of `size` bytes that lies in words of eight bytes."""
        return cls._opened(read(buffer.data.cast("B")[:size]), buffer.ctypes.data, buffer)

    @classmethod
    def _opened(cls, packed: Packed, address: int, source: Floats | Path) -> PackedTable:
        """Open the bytes at an address, whose checksum has been checked."""
        message = ctypes.create_string_buffer(_MESSAGE_BYTES)
        size = len(packed.content)
        handle = kernel().without_gil.wb_open_checked(address, size, message, _MESSAGE_BYTES)
        if not handle:
            raise PackedTableError(message.value.decode(errors="replace"))
        try:
            return cls(handle, packed, source, size)
        except (LookupError, TypeError, ValueError) as error:
            entry = f" (no {error.args[0]})" if isinstance(error, KeyError) else ""
            raise PackedTableError(
                f"another version of wrenchbook wrote the table, whose contents differ{entry}; "
                "download it again"
            ) from error

    def __reduce__(self) -> tuple[Any, ...]:
        """Return the arguments for pickle: the file's bytes, as one array."""
        if isinstance(self._source, np.ndarray):
            return PackedTable._from_buffer, (self._source, self.size)
        return PackedTable.open, (self._source,)

    @property
    def content(self) -> bytes:
        """The file's bytes, also of a mapped file that has been removed or replaced since."""
        return bytes(self._packed.content)

    @cached_property
    def space(self) -> Space:
        """The table's inputs and outputs: names, units, interfaces."""
        return Space.read(self.meta["space"])

    @property
    def checksum(self) -> int:
        """The CRC-32 of the file's content, from its header."""
        return int.from_bytes(self._packed.content[CHECKSUM], "little")

    def answer(
        self,
        wrench: Sequence[float],
        tolerance: Sequence[float] | None = None,
        method: str | None = None,
    ) -> Reply:
        """Answer one wrench of n finite floats, N and N·m.

        `tolerance`: the largest error of each output, m and rad; the component's tolerance if None.
        `method`: a name of `METHODS`; the component's default if None.

        Raises UnknownMethodError if the table does not have the method; ValueError if a number is
        not finite, or there are not n numbers.
        """
        work = self._work()
        work.fill(wrench)
        options = work.options(tolerance, method or self.method)
        inputs, reply, scratch = work.at
        wrong = self._answer(self._handle, options, inputs, reply, scratch)
        if wrong:
            loads = np.array([wrench], dtype=float)
            raise mistake(wrong, method or self.method, self._packed, loads)
        reply = self._read(work.reply)
        self._idle.append(work)
        return reply

    def answers_by(self, method: str | None = None) -> str:
        """Return the method that answers a query with `method`, at wrenches without a row.

        In place of a missing kriging the table's default method answers.
        """
        default = self.meta["summary"]["method"]
        name = method or self.method or default
        groups = range(len(self.meta["groups"]))
        has_kriging = name != "kriging" or any(f"g{k}/kriging/x" in self.arrays for k in groups)
        return name if has_kriging else default

    def batch(
        self,
        wrenches: ArrayLike,
        tolerance: Sequence[float] | None = None,
        method: str | None = None,
        threads: int = 1,
        *,
        without_rows: bool = False,
    ) -> Replies:
        """Answer many wrenches, shape (k, n), N and N·m, with the same results as `answer`.

        The results do not depend on the number of threads. With `without_rows` the method answers
        also where the wrench has a row. Other parameters and errors are those of `answer`.
        """
        queries = self._many(wrenches)
        outputs, errors = (np.empty((len(queries), self.outputs)) for _ in range(2))
        coverage = np.empty(len(queries), dtype=np.uint8)
        work = self._work()
        options = work.options(tolerance, method or self.method, without_rows)
        addresses = [array.ctypes.data for array in (queries, outputs, errors, coverage)]
        wrong = kernel().without_gil.wb_answer_many(
            self.handle, options, len(queries), *addresses, threads
        )
        self._idle.append(work)
        if wrong:
            raise mistake(wrong, method or self.method, self._packed, queries)
        return Replies(outputs, errors, coverage)

    def derivative(
        self,
        wrench: Sequence[float],
        tolerance: Sequence[float] | None = None,
        method: str | None = None,
    ) -> Floats:
        """Return du/dw (m, n), SI, of the answer to one wrench; NaN where unknown."""
        return self.derivatives(np.asarray(wrench, dtype=float)[None], tolerance, method)[0]

    def derivatives(
        self,
        wrenches: ArrayLike,
        tolerance: Sequence[float] | None = None,
        method: str | None = None,
        threads: int = 1,
        *,
        without_rows: bool = False,
    ) -> Floats:
        """Return du/dw (k, m, n), SI, of the answers to wrenches (k, n).

        It is the derivative of the method's interpolant, or the tangent of the row that answers;
        with `without_rows` always the method's. Other parameters and errors are those of `batch`.
        """
        queries = self._many(wrenches)
        derivatives = np.empty((len(queries), self.outputs, self.inputs))
        work = self._work()
        options = work.options(tolerance, method or self.method, without_rows)
        wrong = kernel().without_gil.wb_derivative_many(
            self.handle,
            options,
            len(queries),
            queries.ctypes.data,
            derivatives.ctypes.data,
            threads,
        )
        self._idle.append(work)
        if wrong:
            raise mistake(wrong, method or self.method, self._packed, queries)
        return derivatives

    def tangent_at_zero(self) -> tuple[Floats, str]:
        """Return the compliance at zero load, and its origin.

        It is the tangent of the row at zero load, else du/dw of the method there. It differs from
        the fitted compliance (`g0/fit/matrix`), the mean over the load range.

        The compliance has shape (m, n), m/N, m/(N·m), rad/N and rad/(N·m); it is NaN for a load
        without effect in the rows, and for an output that no row has. The origin is ``row``, a
        method, or ``none``.
        """
        arrays, locked = self.arrays, self.locked
        of_method = self.derivatives(np.zeros(self.inputs), without_rows=True)[0]
        of_row = np.full_like(of_method, np.nan)
        for group in range(len(self.meta["groups"])):
            outputs = arrays[f"g{group}/outputs"] != 0
            rows = f"g{group}/row/"
            unknown = (arrays[f"g{group}/fit/known"] == 0) & ~locked
            of_method[np.ix_(outputs, unknown)] = np.nan
            distances = np.abs(arrays[f"{rows}wrench"] / self.load_scale).max(axis=1)
            if len(distances) and distances.min() <= NEAR:
                nearest = np.flatnonzero(distances == distances.min())
                first = nearest[arrays[f"{rows}number"][nearest].argmin()]
                tangent = arrays[f"{rows}tangent_of"][first]
                if tangent >= 0:
                    of_row[outputs] = arrays[f"{rows}tangent"][tangent][outputs]
        of_row[:, locked] = np.where(np.isnan(of_row[:, locked]), np.nan, 0.0)
        is_known = np.isfinite(of_row)
        if is_known.any():
            return np.where(is_known, of_row, of_method), "row"
        return of_method, self.answers_by() if np.isfinite(of_method).any() else "none"

    def inverse(
        self,
        outputs: ArrayLike,
        start: ArrayLike | None = None,
        method: str | None = None,
        near: Floats | None = None,
    ) -> tuple[Floats, Floats]:
        """Return the wrench (n,) of a displacement (m,), m and rad, and the stiffness (n, m) there.

        `start`: start of Newton's method, shape (n,), SI; no load if None. Further inputs keep
        these values.
        `near`: the stiffness of a displacement nearby, shape (n, m), which saves time.

        Raises InverseError if no wrench has that displacement, or the derivative has no inverse.
        """
        target = np.ascontiguousarray(outputs, dtype=float)
        wrench = np.zeros(self.inputs) if start is None else np.array(start, dtype=float)
        for name, values, count in (
            ("displacement", target, self.outputs),
            ("start wrench", wrench, self.inputs),
        ):
            if values.shape != (count,):
                raise ValueError(f"a {name} must be {count} numbers, not of shape {values.shape}")
        shape = (self.inputs, self.outputs)
        stiffness = np.zeros(shape) if near is None else np.array(near, dtype=float).reshape(shape)
        work = self._work()
        options = work.options(None, method or self.method)
        addresses = [array.ctypes.data for array in (target, wrench, stiffness)]
        wrong = kernel().with_gil.wb_inverse(self.handle, options, *addresses, work.at[2])
        self._idle.append(work)
        if wrong:
            free = np.where(self.locked[: self.outputs], 0.0, target)
            raise mistake(wrong, method or self.method, self._packed, wrench[None], free)
        return wrench, stiffness

    def joints(
        self, count: int, method: str | None = None, axes: Floats | None = None
    ) -> JointSteps:
        """Return the steps of joints of this table, for all its k interfaces that move.

        `axes` (k, 3, 3): the interface frame's axes as columns, in the tip's own axes; needed if
        quaternions, angular velocities and moments refer to the tip's axes. Many joints release the
        interpreter lock, a single joint keeps it.
        """
        library = kernel().with_gil if count == 1 else kernel().without_gil
        return JointSteps(
            self,
            library.wb_joint_step,
            (count, method, axes),
            method=method_code(method or self.method),
            interfaces=library.wb_joint_interfaces(self.handle),
            memory=library.wb_joint_memory(self.handle),
            scratch=self._scratch,
        )

    @property
    def handle(self) -> int:
        """The address of the open table.

        Raises ValueError if the table is closed.
        """
        return self._handle or _closed()

    weakest = staticmethod(weakest)

    def sample(self, centre: Floats, indices: NDArray[np.intp]) -> Floats:
        """Return the corners of the load range and wrenches within it: see `sample_of`."""
        return sample_of(self.load_range, centre, indices)

    @staticmethod
    def joint_rate(stiffness: Floats, inverse_mass: Floats, dt: float, damping: float) -> Floats:
        """Return the change of a joint's wrench with the relative velocity; see ``wb_joint_rate``.

        `stiffness`, `inverse_mass`: shape (n, n), n at most 24, contiguous: N/m to N·m/rad, 1/kg to
        1/(kg·m^2). The result has the same shape, N·s/m to N·m·s/rad.

        Raises ValueError if the inverse mass is not symmetric and positive definite, or a number is
        not finite.
        """
        rates = np.empty_like(stiffness)
        addresses = stiffness.ctypes.data, inverse_mass.ctypes.data
        wrong = kernel().with_gil.wb_joint_rate(
            len(rates), *addresses, dt, damping, rates.ctypes.data
        )
        if wrong:
            raise ValueError(_why_no_rate(stiffness, inverse_mass))
        return rates

    def axis(self, group: int, axis: int, wrench: Sequence[float]) -> AxisPart | None:
        """Return the contribution of axis 0, 1 or 2 to the answer of a group of outputs.

        None if the group has no triangulated rows. The wrench has n loads, N and N·m.
        """
        reply = ctypes.create_string_buffer(AXIS.size)
        work = self._work()
        work.fill(wrench)
        wrong = kernel().with_gil.wb_axis(
            self.handle, group, axis, work.at[0], ctypes.addressof(reply)
        )
        self._idle.append(work)
        if wrong == Status.NO_METHOD:
            return None
        if wrong:
            raise mistake(wrong, None, self._packed, np.array([wrench], dtype=float))
        values = AXIS.unpack_from(reply)
        reasons = [Reason(*values[14:])._replace(group=group)] if values[7] else []
        acting = np.where(self.locked, 0.0, wrench).tolist()
        return AxisPart(
            outputs=values[8:14],
            coverage=NAMES[values[0]],
            reason=text_of(reasons, acting, self._packed),
            origin=values[1],
            corners=values[3 : 3 + values[2]],
        )

    def close(self) -> None:
        """Unmap the table. No thread may use it during or after this call."""
        handle = self._handle
        self._handle = 0
        if handle:
            self._answer = _closed
            self._release(handle)

    def __del__(self) -> None:
        """Unmap the table when its last reference is gone."""
        if getattr(self, "_handle", 0):
            self.close()

    def _work(self) -> _Work:
        """Return buffers that no other thread uses; the caller appends them to `_idle` again."""
        try:
            return self._idle.pop()
        except IndexError:
            return _Work(self.inputs, self.outputs, self._scratch)

    def _many(self, wrenches: ArrayLike) -> Floats:
        """Return wrenches as the kernel reads them: contiguous, shape (k, n)."""
        return np.ascontiguousarray(wrenches, dtype=float).reshape(-1, self.inputs)


def _why_no_rate(stiffness: Floats, inverse_mass: Floats) -> str:
    """Return why ``wb_joint_rate`` refuses two matrices (n, n), as a text."""
    for name, matrix in (("stiffness", stiffness), ("inverse effective mass", inverse_mass)):
        if not np.isfinite(matrix).all():
            row, column = np.argwhere(~np.isfinite(matrix))[0].tolist()
            value = matrix[row, column]
            return f"the {name} of a joint must be finite, but entry [{row}, {column}] is {value}"
    asymmetry = np.abs(inverse_mass - inverse_mass.T).max()
    smallest = np.linalg.eigvalsh(inverse_mass)[0]
    return (
        "the inverse effective mass of the joint must be symmetric and positive definite, but "
        f"its asymmetry is {asymmetry:.3g} and its smallest eigenvalue {smallest:.3g}; give every "
        "freedom between base and tip a mass"
    )


def _closed(*_: object) -> int:
    raise ValueError("the packed table is closed; open it again with Table.open(FILE)")
