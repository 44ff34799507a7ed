"""Conversion of the kernel's replies, structs of wrenchbook.h, to Python objects."""

from __future__ import annotations

import ctypes
import struct
from collections.abc import Mapping, Sequence
from enum import IntEnum
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..answer import ANSWERED, BY_AXES, METHODS, NAMES, UnknownMethodError
from .format import Packed
from .reasons import FIXED, Reason, text_of, unmeasured_text

Buffer = ctypes.Array[ctypes.c_char]

Floats = NDArray[np.float64]

MAX_VALUES, MAX_REASONS = 64, 32  # WB_MAX and WB_MAX_REASONS of wrenchbook.h
FIELDS = 7  # fields of MAX_VALUES doubles each: inputs, outputs, total error and its four parts
# Fields of `wb_reply`: coverage, within, method, exact, reasons, group, unknown, unused; row,
# index, missing.
HEAD, REASON = struct.Struct("=8i2qQ"), struct.Struct("=4i2d")
REASONS_AT = HEAD.size + FIELDS * MAX_VALUES * 8
REPLY_SIZE = REASONS_AT + MAX_REASONS * REASON.size + 8  # `solved`
AXIS = struct.Struct("=8i6d" + REASON.format.lstrip("="))
WITHIN = {1: True, 0: False, -1: None}
VALUES = 11  # numbers of a reply before its outputs


class Status(IntEnum):
    """The values that the kernel's functions return: WB_OK to WB_NO_MASS of wrenchbook.h."""

    OK = 0
    NOT_FINITE = 1
    NO_METHOD = 2
    NO_MEMORY = 3
    NOT_SQUARE = 4
    SINGULAR = 5
    NO_CONVERGENCE = 6
    INDEFINITE = 7
    NO_MASS = 8


class InverseError(ArithmeticError):
    """No wrench has the given displacement; the message has the cause."""


class Reply(NamedTuple):
    """The answer to one wrench; m outputs, m and rad."""

    # None if unknown, as a whole or for an entry
    outputs: tuple[float, ...] | None  # the displacement
    error: tuple[float, ...] | None  # total, 95 %: the sum of the four parts
    interpolation: tuple[float, ...] | None
    discretisation: tuple[float, ...] | None
    linearity: tuple[float, ...] | None
    measurement: tuple[float, ...] | None
    coverage: str  # "covered", "thin" or "outside"
    reason: str  # why the answer is not covered, or which outputs no row has; may be empty
    # whether the total error is within the tolerance; None if it cannot be decided
    within_tolerance: bool | None
    method: str  # the method of the answer, "row", or "estimate" (the table has no rows)
    row: int | None  # the number of the row that answered
    # Whether that row has exactly this wrench, or a wrench within 1e-6 of the load range.
    exact: bool
    source: str | None  # the sources of the rows at that wrench
    missing: tuple[str, ...]  # the outputs that no row of the table holds


class Replies(NamedTuple):
    """The answers to k wrenches."""

    # outputs, errors: (k, m), m and rad: total errors; NaN where unknown
    outputs: Floats
    errors: Floats
    coverage: NDArray[np.uint8]  # (k,): 0 covered, 1 thin, 2 outside


class AxisPart(NamedTuple):
    """The contribution of one axis: all six outputs, m and rad."""

    outputs: tuple[float, ...]
    coverage: str
    reason: str
    origin: int  # the axis of the rows that answered, -1 without rows
    corners: tuple[int, ...]  # the points of its triangulation that the answer uses


class ReplyReader:
    """Converts the kernel's bytes to replies.

    `packed`: the table that answers.
    `inputs`, `outputs`: their numbers.
    """

    def __init__(self, packed: Packed, inputs: int, outputs: int) -> None:
        self._packed = packed
        self._names = [output["name"] for output in packed.meta["space"]["outputs"]]
        self._texts: dict[bytes, str] = {}
        self._loads = struct.Struct(f"={inputs}d").unpack_from
        ends = range(VALUES, VALUES + (FIELDS - 1) * outputs + 1, outputs)
        self._fields = [slice(start, end) for start, end in pairwise(ends)]
        gap = 8 * (MAX_VALUES - outputs)
        fields = f"{outputs}d{gap}x" * (FIELDS - 1)  # after the inputs
        self._unpack = struct.Struct(f"{HEAD.format}{8 * MAX_VALUES}x{fields}").unpack_from

    def read(self, reply: Buffer) -> Reply:
        """Return the reply in a buffer."""
        raw = self._unpack(reply)
        coverage, within, method, exact, count, group, unknown, _, row, index, missing = raw[
            :VALUES
        ]
        fields: list[Any] = [raw[part] for part in self._fields]
        # Most replies take this short path.
        if not (coverage or unknown or missing) and method < len(METHODS):
            known_by = "covered", "", WITHIN[within], ANSWERED[method]
            return Reply._make((*fields, *known_by, None, False, None, ()))
        # Any other reply: unknown values are None, reasons are texts.
        if unknown:
            fields = [known(field) for field in fields]
        text = self._text(reply, count) if count else ""
        names = ()
        if missing:
            text = "; ".join(filter(None, (text, unmeasured_text(missing, self._packed))))
            names = tuple(name for bit, name in enumerate(self._names) if missing >> bit & 1)
        by_row = index >= 0
        source = None
        if by_row:
            number = int(self._packed.arrays[f"g{group}/row/source"][index])
            source = ", ".join(self._packed.meta["sources"][number])
        known_by = NAMES[coverage], text, WITHIN[within], ANSWERED[method]
        row, exact = (row, bool(exact)) if by_row else (None, False)
        return Reply._make((*fields, *known_by, row, exact, source, names))

    def _text(self, reply: Buffer, count: int) -> str:
        """Return the text of a reply's reasons; texts without loads are cached."""
        content: bytes = reply[REASONS_AT : REASONS_AT + REASON.size * count]  # pyright: ignore[reportAssignmentType]
        cached = self._texts.get(content)
        if cached is not None:
            return cached
        reasons = [Reason(*REASON.unpack_from(content, REASON.size * k)) for k in range(count)]
        text = text_of(reasons, self._loads(reply, HEAD.size), self._packed)
        if all(reason.code in FIXED for reason in reasons):
            self._texts[content] = text
        return text


def known(values: tuple[float, ...]) -> tuple[float | None, ...] | None:
    """Return numbers with None for NaN; None if all are NaN."""
    entries = tuple(None if value != value else value for value in values)
    return None if all(value is None for value in entries) else entries


def method_code(method: str | None) -> int:
    """Return a method's number, -1 for the component's default.

    Raises UnknownMethodError if there is no such method.
    """
    if method is None:
        return -1
    try:
        return METHODS.index(method)
    except ValueError:
        raise UnknownMethodError(method) from None


def mistake(
    code: int,
    method: str | None,
    packed: Packed,
    inputs: Floats,
    displacement: Floats | None = None,
) -> Exception:
    """Return the exception for a code other than WB_OK, of 1 to 6: see wrenchbook.h.

    `inputs` (k, n), N and N·m: the queries; for an inverse the last wrench of the iteration.
    `displacement` (m,), m and rad: for an inverse, the displacement whose wrench is wanted.
    """
    space = packed.meta["space"]
    if code == Status.NOT_FINITE:
        names = space["inputs"]
        values = inputs
        if displacement is not None and np.isfinite(inputs).all():
            names, values = space["outputs"], displacement[None]
        row, column = np.argwhere(~np.isfinite(values))[0]
        where = f"wrench {row}: " if len(values) > 1 else ""
        name = names[column]["name"]
        value = values[row, column]
        return ValueError(f"{where}{name} must be finite, not {value}")
    if code == Status.NO_METHOD:
        return _no_method(method, packed)
    if code == Status.NO_MEMORY:
        return MemoryError(f"there is no memory for {len(inputs)} wrenches at once; send fewer")
    if code == Status.NOT_SQUARE:
        counts = f"{len(space['inputs'])} loads for {len(space['outputs'])} outputs"
        return InverseError(f"the table has {counts}; an inverse needs as many of both")
    reached = _listed(space["inputs"], inputs[0])
    if code == Status.SINGULAR:
        return InverseError(
            f"the compliance at {reached or 'zero load'} is unknown or singular, so the "
            "displacement has no wrench there; solve or import rows near it"
        )
    assert displacement is not None  # only an inverse iterates
    low, high = packed.arrays["space/range"]
    outside = bool(((inputs[0] < low) | (inputs[0] > high)).any())
    wanted = _listed(space["outputs"], displacement)
    return InverseError(
        f"the inverse did not converge for {wanted or 'zero displacement'}; its last wrench was "
        f"{reached or 'zero'}{', outside the load range' * outside}. Give a smaller displacement, "
        "or pass start= with a wrench near the answer"
    )


def _listed(entries: Sequence[Mapping[str, str]], values: Floats) -> str:
    """Return the values that are not zero, each with its name and unit."""
    return ", ".join(
        f"{entry['name']} = {value:.4g} {entry['unit']}"
        for entry, value in zip(entries, values.tolist(), strict=True)
        if value
    )


def _no_method(method: str | None, packed: Packed) -> UnknownMethodError:
    """Return the error of a table that does not answer by a method."""
    if "scene" in packed.meta:
        default = packed.meta["summary"]["method"]
        return UnknownMethodError(
            method or "(default)",
            f"the table of a scene answers only by its default method, {default}; download the "
            "complete table for others",
        )
    if method in BY_AXES:  # tables of one interface have both
        names = ", ".join(entry["name"] for entry in packed.meta["space"]["inputs"])
        return UnknownMethodError(
            method,
            f"method {method!r} needs one wrench at one interface and no further inputs, but this "
            f"table has {names}; use 'kriging' or 'linear', or give no method",
        )
    return UnknownMethodError(method or "(default)")
