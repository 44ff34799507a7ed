"""A packed table in Python: the kernel by ctypes, with numpy and the standard library only.

A single answer keeps the interpreter (it takes microseconds); batches release it.
"""

from __future__ import annotations

import ctypes
import os
import struct
from collections.abc import Sequence
from functools import cache, cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..packed.codes import ANSWERED, COVERAGE, METHODS
from ..packed.format import Packed, PackedTableError, map_file, read
from ..packed.reasons import Reason, text_of, unmeasured_text
from .build import ready_library

Floats = NDArray[np.float64]

MOST, MOST_REASONS = 64, 16  # WB_MOST and WB_MOST_REASONS of wrenchbook.h
_HEAD, _REASON = struct.Struct("=8i2qQ"), struct.Struct("=4i2d")
_FIELDS = 6  # of MOST doubles each: inputs, outputs, and the errors
_REASONS_AT = _HEAD.size + _FIELDS * MOST * 8
_REPLY_SIZE = _REASONS_AT + MOST_REASONS * _REASON.size
_WITHIN = {1: True, 0: False, -1: None}
_WHY = 512  # bytes of a reason why a table cannot be opened
_AXIS = struct.Struct("=8i12d" + _REASON.format.lstrip("="))


class UnknownMethodError(ValueError):
    """A method that a table does not have; the text names those that there are."""

    def __init__(self, method: str) -> None:
        super().__init__(f"unknown method {method!r}: one of {', '.join(sorted(METHODS))}")


class InverseError(ArithmeticError):
    """A displacement for which no wrench was found; the text says why."""


class Reply(NamedTuple):
    """The answer to one wrench; m outputs, m and rad.

    Attributes
    ----------
    outputs, error, interpolation, discretisation, linearity : tuple of m floats or None
        The displacement, its total 95 % error and the parts whose sum that is. None where unknown,
        as a whole and in one place.
    coverage : str
        "covered", "thin" or "outside".
    reason : str
        Why not covered, or which outputs no row holds; may be empty.
    within_tolerance : bool or None
        Whether the total error is within the tolerance; None where that is not known.
    method : str
        What answered: a method, "row" or "estimate" (there are no rows).
    row : int or None
        The number of the row that answered.
    exact : bool
        Whether that row has just this wrench, rather than one within 1e-6 of the range.
    source : str or None
        The sources of the rows at that wrench.
    missing : tuple of str
        The outputs that no row of the table holds.
    """

    outputs: tuple[float, ...] | None
    error: tuple[float, ...] | None
    interpolation: tuple[float, ...] | None
    discretisation: tuple[float, ...] | None
    linearity: tuple[float, ...] | None
    coverage: str
    reason: str
    within_tolerance: bool | None
    method: str
    row: int | None
    exact: bool
    source: str | None
    missing: tuple[str, ...]


class Replies(NamedTuple):
    """The answers to k wrenches.

    Attributes
    ----------
    outputs, errors : ndarray, shape (k, m), m and rad
        Total errors; NaN where unknown.
    coverage : ndarray of uint8, shape (k,)
        0 covered, 1 thin, 2 outside.
    """

    outputs: Floats
    errors: Floats
    coverage: NDArray[np.uint8]


class AxisPart(NamedTuple):
    """What one axis contributes: all six outputs and errors, m and rad.

    Attributes
    ----------
    origin : int
        The axis whose rows answered, -1 without rows.
    corners : tuple of int
        The points of its triangulation that were read.
    """

    outputs: tuple[float, ...]
    error: tuple[float, ...]
    coverage: str
    reason: str
    origin: int
    corners: tuple[int, ...]


class _Options(ctypes.Structure):
    _fields_ = (("method", ctypes.c_int), ("tolerance", ctypes.c_void_p))


class _Work:
    """The buffers of one answer: inputs, options, reply, scratch."""

    def __init__(self, inputs: int, outputs: int, scratch: int) -> None:
        self.inputs = (ctypes.c_double * inputs)()
        self.tolerance = (ctypes.c_double * outputs)()
        self.reply = ctypes.create_string_buffer(_REPLY_SIZE)
        self.scratch = (ctypes.c_double * (scratch // 8 + 1))()
        self.options = _Options(-1, None)
        self.at = tuple(
            map(ctypes.addressof, (self.options, self.inputs, self.reply, self.scratch))
        )


class PackedTable:
    """A packed table; any number of threads may use one.

    `open` and `from_bytes` make one.

    Attributes
    ----------
    inputs, outputs : int
        How many there are: n and m.
    words : dict
        The table's JSON block: contract, space, interface, groups, sources, provenance.
    arrays : dict of str to ndarray
        Read-only views of the mapped file.
    """

    def __init__(self, handle: int, packed: Packed, kept: object = None) -> None:
        """Take an open handle, the file's views, and what must outlive the handle."""
        self._handle, self._packed, self._kept = handle, packed, kept
        self.arrays, self.words = packed
        kernel = _kernel()
        self._answer = kernel.held.wb_answer
        self.inputs, self.outputs = kernel.held.wb_inputs(handle), kernel.held.wb_outputs(handle)
        self._scratch = kernel.held.wb_scratch(handle)
        self._idle: list[_Work] = []  # its pop and append are atomic
        self._pack = struct.Struct(f"={self.inputs}d").pack_into
        gap = 8 * (MOST - self.outputs)
        fields = f"{self.outputs}d{gap}x" * (_FIELDS - 1)
        self._unpack = struct.Struct(f"{_HEAD.format}{8 * MOST}x{fields}").unpack_from

    @classmethod
    def open(cls, path: str | os.PathLike[str]) -> PackedTable:
        """Map the file of a packed table, after its checksum.

        Raises
        ------
        PackedTableError
            If it cannot be opened, is no packed table, damaged, or of another format.
        """
        why = ctypes.create_string_buffer(_WHY)
        handle = _kernel().free.wb_open(os.fsencode(Path(path)), why, _WHY)
        if not handle:
            raise PackedTableError(f"{path}: {why.value.decode(errors='replace')}")
        return cls(handle, map_file(path, checked=True))

    @classmethod
    def from_bytes(cls, content: bytes) -> PackedTable:
        """Open the bytes of a packed table.

        Raises
        ------
        PackedTableError
            As `open`.
        """
        kept = np.empty(len(content) // 8 + 1, dtype=np.float64)  # which aligns them
        kept.view(np.uint8)[: len(content)] = np.frombuffer(content, dtype=np.uint8)
        packed = read(memoryview(kept.view(np.uint8))[: len(content)])
        why = ctypes.create_string_buffer(_WHY)
        handle = _kernel().free.wb_open_bytes(kept.ctypes.data, len(content), why, _WHY)
        if not handle:
            raise PackedTableError(why.value.decode(errors="replace"))
        return cls(handle, packed, kept)

    def answer(
        self,
        wrench: Sequence[float],
        tolerance: Sequence[float] | None = None,
        method: str | None = None,
    ) -> Reply:
        """Answer one wrench of n finite floats, N and N·m.

        Parameters
        ----------
        tolerance
            The largest error of each output, m and rad; the component's own without.
        method
            One of `METHODS`; the component's own without.

        Raises
        ------
        UnknownMethodError
            If the table does not have the method.
        ValueError
            If a number is not finite, or there are not n.
        """
        work = self._work()
        self._fill(work, wrench)
        options, inputs, reply, scratch = work.at
        if tolerance is None and method is None:
            options = None
        else:
            self._choose(work, tolerance, method)
        wrong = self._answer(self._handle, options, inputs, reply, scratch)
        if wrong:
            self._idle.append(work)
            raise _mistake(wrong, method)
        found = self._unpack(work.reply)
        if found[0] == 0 and not found[6] and not found[10] and found[2] < len(METHODS):
            self._idle.append(work)
            return self._plain(found)
        made = self._whole(found, work)
        self._idle.append(work)
        return made

    def _plain(self, found: tuple[Any, ...]) -> Reply:
        """Return a covered reply of a method in which nothing is unknown."""
        m = self.outputs
        a, b, c, d, e = 11, 11 + m, 11 + 2 * m, 11 + 3 * m, 11 + 4 * m
        return Reply(
            *(found[a:b], found[b:c], found[c:d], found[d:e], found[e:], "covered", ""),
            *(_WITHIN[found[1]], ANSWERED[found[2]], None, False, None, ()),
        )

    def _whole(self, found: tuple[Any, ...], work: _Work) -> Reply:
        """Return any reply: what is unknown is None, reasons are words."""
        coverage, within, method, exact, count = found[:5]
        row, place, missing = found[8:11]
        values = found[11:]
        fields: list[Any] = [
            values[start : start + self.outputs] for start in range(0, len(values), self.outputs)
        ]
        if found[6]:
            fields = [_known(field) for field in fields]
        reasons = [
            Reason(*_REASON.unpack_from(work.reply, _REASONS_AT + _REASON.size * number))
            for number in range(count)
        ]
        text = text_of(reasons, list(work.inputs), self._acting(work, reasons)) if reasons else ""
        names = ()
        if missing:
            text = "; ".join(filter(None, (text, unmeasured_text(missing, self._packed))))
            names = tuple(
                name for bit, name in enumerate(self._output_names) if missing >> bit & 1
            )
        source = self._source_at(found[5], place) if place >= 0 else None
        own = None if row < 0 else row
        return Reply(
            *(*fields, COVERAGE[coverage], text, _WITHIN[within], ANSWERED[method]),
            *(own, bool(exact) and own is not None, source, names),
        )

    def _acting(self, work: _Work, reasons: list[Reason]) -> Packed:
        """Put the loads as they were used, without those on locked freedoms, into the inputs."""
        used = struct.unpack_from(f"={self.inputs}d", work.reply, _HEAD.size)
        work.inputs[:] = used
        return self._packed

    def batch(
        self,
        wrenches: ArrayLike,
        tolerance: Sequence[float] | None = None,
        method: str | None = None,
        threads: int = 1,
    ) -> Replies:
        """Answer many wrenches, shape (k, n), N and N·m, with the numbers of `answer`.

        The number of threads changes none of them. Parameters and errors are those of `answer`.
        """
        asked = self._many(wrenches)
        out = np.empty((len(asked), self.outputs)), np.empty((len(asked), self.outputs))
        coverage = np.empty(len(asked), dtype=np.uint8)
        options, kept = self._options(tolerance, method)
        wrong = _kernel().free.wb_answer_many(
            *(self._handle, options, len(asked), asked.ctypes.data),
            *(out[0].ctypes.data, out[1].ctypes.data, coverage.ctypes.data, threads),
        )
        del kept
        if wrong:
            raise _mistake(wrong, method)
        return Replies(*out, coverage)

    def derivative(
        self,
        wrench: Sequence[float],
        tolerance: Sequence[float] | None = None,
        method: str | None = None,
    ) -> Floats:
        """Return du/dw (m, n), SI, of the answer to one wrench; NaN where it is not known."""
        return self.derivatives(np.asarray(wrench, dtype=float)[None], tolerance, method)[0]

    def derivatives(
        self,
        wrenches: ArrayLike,
        tolerance: Sequence[float] | None = None,
        method: str | None = None,
        threads: int = 1,
    ) -> Floats:
        """Return du/dw (k, m, n), SI, of the answers to wrenches (k, n).

        That of the method's interpolant, or the tangent of the row that answers. Parameters and
        errors are those of `batch`.
        """
        asked = self._many(wrenches)
        found = np.empty((len(asked), self.outputs, self.inputs))
        options, kept = self._options(tolerance, method)
        wrong = _kernel().free.wb_derivative_many(
            *(self._handle, options, len(asked), asked.ctypes.data, found.ctypes.data, threads)
        )
        del kept
        if wrong:
            raise _mistake(wrong, method)
        return found

    def inverse(
        self,
        outputs: ArrayLike,
        start: ArrayLike | None = None,
        method: str | None = None,
    ) -> tuple[Floats, Floats]:
        """Return the wrench (n,) of a displacement (m,), m and rad, and the stiffness (n, m) there.

        Parameters
        ----------
        start
            Where Newton's method starts, shape (n,), N and N·m; no load without.

        Raises
        ------
        InverseError
            If no wrench has that displacement, or the derivative has no inverse.
        """
        target = np.ascontiguousarray(outputs, dtype=float)
        found = np.zeros(self.inputs) if start is None else np.array(start, dtype=float)
        if target.shape != (self.outputs,) or found.shape != (self.inputs,):
            raise ValueError(f"a displacement of {self.outputs} and a wrench of {self.inputs}")
        stiffness = np.empty((self.inputs, self.outputs))
        options, kept = self._options(None, method)
        work = self._work()
        wrong = _kernel().held.wb_inverse(
            *(self._handle, options, target.ctypes.data, found.ctypes.data),
            *(stiffness.ctypes.data, work.at[3]),
        )
        self._idle.append(work)
        del kept
        if wrong:
            raise _mistake(wrong, method)
        return found, stiffness

    def axis(
        self,
        group: int,
        axis: int,
        wrench: Sequence[float],
        tolerance: Sequence[float] | None = None,
    ) -> AxisPart | None:
        """Return what axis 0, 1 or 2 contributes to the answer of a group of outputs.

        None where the group has no rows to compose from. The wrench has n loads, N and N·m.
        """
        reply = ctypes.create_string_buffer(_AXIS.size)
        options, kept = self._options(tolerance, None)
        work = self._work()
        self._fill(work, wrench)
        wrong = _kernel().held.wb_axis(
            *(self._handle, options, group, axis, work.at[1], ctypes.addressof(reply))
        )
        self._idle.append(work)
        del kept
        if wrong == _NO_METHOD:
            return None
        if wrong:
            raise _mistake(wrong, None)
        found = _AXIS.unpack_from(reply)
        reasons = [Reason(*found[20:])._replace(group=group)] if found[7] else []
        locked = self.arrays["space/locked"].tolist()
        acting = [0.0 if idle else load for load, idle in zip(wrench, locked, strict=True)]
        return AxisPart(
            outputs=found[8:14],
            error=found[14:20],
            coverage=COVERAGE[found[0]],
            reason=text_of(reasons, acting, self._packed),
            origin=found[1],
            corners=found[3 : 3 + found[2]],
        )

    def close(self) -> None:
        """Unmap the table; it must not be used after that, nor by another thread meanwhile."""
        handle, self._handle = self._handle, 0
        if handle:
            self._answer = _closed
            _kernel().held.wb_close(handle)

    def __del__(self) -> None:
        """Unmap the table once nobody uses it."""
        if getattr(self, "_handle", 0):
            self.close()

    @cached_property
    def _output_names(self) -> list[str]:
        return [one["name"] for one in self.words["space"]["outputs"]]

    def _source_at(self, group: int, place: int) -> str:
        number = int(self.arrays[f"g{group}/row/source"][place])
        return ", ".join(self.words["sources"][number])

    def _work(self) -> _Work:
        try:
            return self._idle.pop()
        except IndexError:
            return _Work(self.inputs, self.outputs, self._scratch)

    def _fill(self, work: _Work, wrench: Sequence[float]) -> None:
        try:
            self._pack(work.inputs, 0, *wrench)
        except struct.error as error:
            self._idle.append(work)
            raise ValueError(f"a wrench of {self.inputs} numbers: {error}") from error

    def _choose(
        self, work: _Work, tolerance: Sequence[float] | None, method: str | None
    ) -> None:
        work.options.method = _code(method)
        work.options.tolerance = None
        if tolerance is not None:
            work.tolerance[:] = tuple(tolerance)
            work.options.tolerance = ctypes.addressof(work.tolerance)

    def _options(
        self, tolerance: Sequence[float] | None, method: str | None
    ) -> tuple[int | None, object]:
        """Return the address of options, and what must be kept while they are used."""
        if tolerance is None and method is None:
            return None, None
        own = None if tolerance is None else np.array(tolerance, dtype=float)
        if own is not None and own.shape != (self.outputs,):
            raise ValueError(f"a tolerance has {self.outputs} numbers")
        options = _Options(_code(method), None if own is None else own.ctypes.data)
        return ctypes.addressof(options), (options, own)

    def _many(self, wrenches: ArrayLike) -> Floats:
        return np.ascontiguousarray(wrenches, dtype=float).reshape(-1, self.inputs)


_NO_METHOD = 2


def _closed(*_: object) -> int:
    raise ValueError("the packed table is closed")


def _known(values: tuple[float, ...]) -> tuple[float | None, ...] | None:
    """Return None for each number that is none, and in the place of all where none is one."""
    found = tuple(None if value != value else value for value in values)  # noqa: PLR0124
    return None if all(value is None for value in found) else found


def _code(method: str | None) -> int:
    if method is None:
        return -1
    try:
        return METHODS.index(method)
    except ValueError:
        raise UnknownMethodError(method) from None


def _mistake(code: int, method: str | None) -> Exception:
    """Return what a code other than WB_OK means: see wrenchbook.h."""
    return {
        1: ValueError("wrenches and displacements must be finite numbers"),
        _NO_METHOD: UnknownMethodError(method or "(default)"),
        3: MemoryError("no memory for a batch"),
        4: InverseError("only a table of as many outputs as inputs has an inverse"),
        5: InverseError("the derivative has no inverse here, or is not known"),
        6: InverseError("no wrench was found for this displacement"),
    }[code]


class _Kernel(NamedTuple):
    """The library: `held` keeps the interpreter during a call, `free` releases it."""

    held: ctypes.PyDLL
    free: ctypes.CDLL


@cache
def _kernel() -> _Kernel:
    path = str(ready_library())
    found = _Kernel(ctypes.PyDLL(path), ctypes.CDLL(path))
    address, size, whole = ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int
    forms = {
        "wb_open": (address, [ctypes.c_char_p, address, size]),
        "wb_open_bytes": (address, [address, size, address, size]),
        "wb_close": (None, [address]),
        "wb_inputs": (whole, [address]),
        "wb_outputs": (whole, [address]),
        "wb_scratch": (size, [address]),
        "wb_answer": (whole, [address] * 5),
        "wb_answer_many": (whole, [address, address, size, *[address] * 4, whole]),
        "wb_derivative_many": (whole, [address, address, size, address, address, whole]),
        "wb_inverse": (whole, [address] * 6),
        "wb_axis": (whole, [address, address, whole, whole, address, address]),
    }
    for library in found:
        for name, (result, arguments) in forms.items():
            function = getattr(library, name)
            function.restype, function.argtypes = result, arguments
    return found
