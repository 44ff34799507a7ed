"""The texts of reason codes: why an answer is not covered.

The kernel gives a code and its numbers; all other numbers are in the table's arrays.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from enum import IntEnum
from typing import NamedTuple

from ..table.rows import ZERO_LOAD
from ..table.space import axis_inputs
from .format import Packed

EMPTY = "the table has no rows"
ONLY_BEYOND = "all rows of the table are outside its load range; solve or import rows within it"
FEW_ROWS = (
    "there are too few rows: kriging needs four rows of each output in the load range, and the "
    "compliance needs one row for each load; solve or import more"
)
UNKNOWN_TOGETHER = (
    "too few rows have several loads at once as large as this wrench: neither their joint effect "
    "nor the error is known; solve or import such rows"
)
UNKNOWN_ERROR = "the rows do not show the error of this answer; solve or import rows near it"
LEAVES_LIMITS = "no estimate is given beyond a table's limits, 20 degrees or 10 m; reduce the load"
ERRORS_UNKNOWN = (
    "the error between the rows is not known: the rows are too few, too close together or along "
    "one motion; solve or import rows spread over the load range"
)
TOO_FAR = (
    "the error is not known: this wrench is farther from the rows than any row is from the others; "
    "solve or import rows around it"
)


class Code(IntEnum):
    """The code of a reason: WB_REASON_... of surrogate/kernel/wrenchbook.h."""

    EMPTY = 1
    ONLY_BEYOND = 2
    BEYOND_RANGE = 3
    UNKNOWN_LOAD = 4
    AXIS_NO_ROWS = 5
    AXIS_OFF_HULL = 6
    MOMENT_ALONE = 10
    INTERACTION = 12
    BEYOND_SPAN = 13
    OVER_TOLERANCE = 14
    NO_ERROR = 15
    ERRORS_UNKNOWN = 16
    BEYOND_LIMITS = 17
    TOO_FAR = 19
    NOT_IN_SCENE = 20
    FEW_ROWS = 22


class Reason(NamedTuple):
    """A reason as the kernel gives it: `wb_reason` of wrenchbook.h, whose `index` is `item`."""

    code: int  # of `Code`
    group: int
    axis: int
    item: int
    value: float
    limit: float


def text_of(reasons: Sequence[Reason], inputs: Sequence[float], packed: Packed) -> str:
    """Return the text of reasons, without repetitions, for one wrench of n inputs, N and N·m."""
    texts = [FIXED.get(reason.code) or _filled(reason, inputs, packed) for reason in reasons]
    return "; ".join(dict.fromkeys(texts))


def _name(packed: Packed, index: int) -> tuple[str, str]:
    load = packed.meta["space"]["inputs"][index]
    return load["name"], load["unit"]


def _amount(packed: Packed, index: int, value: float) -> str:
    name, unit = _name(packed, index)
    return f"{name} = {value:.10g} {unit}"


def _axis_amounts(reason: Reason, inputs: Sequence[float], packed: Packed) -> str:
    loads = axis_inputs(reason.axis)
    return ", ".join(_amount(packed, load, inputs[load]) for load in loads if inputs[load])


def _filled(reason: Reason, inputs: Sequence[float], packed: Packed) -> str:
    """Return the text of a reason that has numbers."""
    if reason.code == Code.AXIS_OFF_HULL:
        return _off_hull(reason, inputs, packed)
    side = "outputs" if reason.code == Code.OVER_TOLERANCE else "inputs"
    entry = packed.meta["space"][side][reason.item]
    ends = (0.0, 0.0)
    if reason.code in _RANGES:
        ends = packed.arrays[_RANGES[reason.code].format(reason.group)][:, reason.item].tolist()
    fields = reason._asdict() | {"name": entry["name"], "unit": entry["unit"]}
    fields |= {"low": ends[0], "high": ends[1]}
    fields["axis"] = "" if reason.axis < 0 else f"axis {'xyz'[reason.axis]}: "
    fields["amount"] = "{name} = {value:.10g} {unit}".format(**fields)
    fields["amounts"] = _axis_amounts(reason, inputs, packed) if reason.axis >= 0 else ""
    return WITH_NUMBERS[reason.code].format(**fields)


def _off_hull(reason: Reason, inputs: Sequence[float], packed: Packed) -> str:
    """Return the loads that lie outside the rows' range, and this range, as a text."""
    name = "xyz"[reason.axis]
    axes = f"g{reason.group}/axes/"
    sentences = []
    span = packed.arrays[axes + "span"][reason.axis]
    floats = packed.arrays[axes + "floats"][reason.axis]
    for column, load in enumerate(axis_inputs(reason.axis)):
        low, high = span[column].tolist()
        # The kernel counts wrenches within this distance as on the hull.
        slack = ZERO_LOAD * float(floats[column])
        if low - slack <= inputs[load] <= high + slack:
            continue
        load_name, unit = _name(packed, load)
        if high - low <= slack:
            only = ", ".join(_name(packed, at)[0] for at in axis_inputs(reason.axis))
            where = f": the rows with {only} alone all hold {load_name} = {low:.6g} {unit}"
        else:
            where = f" lies outside the rows, which span {low:.6g}..{high:.6g} {unit}"
        sentences.append(f"{_amount(packed, load, inputs[load])}{where}")
    if sentences:
        return f"axis {name}: {', '.join(sentences)}"
    first = packed.arrays[axes + "point_first"]
    count = int(first[reason.axis + 1] - first[reason.axis])
    amounts = _axis_amounts(reason, inputs, packed)
    return f"axis {name}: {amounts} together lie outside the hull of its {count} rows"


FIXED: Mapping[int, str] = {
    Code.EMPTY: EMPTY,
    Code.ONLY_BEYOND: ONLY_BEYOND,
    Code.INTERACTION: UNKNOWN_TOGETHER,
    Code.NO_ERROR: UNKNOWN_ERROR,
    Code.ERRORS_UNKNOWN: ERRORS_UNKNOWN,
    Code.BEYOND_LIMITS: LEAVES_LIMITS,
    Code.TOO_FAR: TOO_FAR,
    Code.FEW_ROWS: FEW_ROWS,
}
# Fields of the texts: those of `Reason`, and name, unit and range (low, high) of the load or
# output.
WITH_NUMBERS: Mapping[int, str] = {
    Code.BEYOND_RANGE: "{amount} is outside the load range, {low:.6g}..{high:.6g} {unit}",
    Code.UNKNOWN_LOAD: "no row shows the influence of {name}; solve or import one",
    Code.AXIS_NO_ROWS: "{axis}no rows to answer {amounts}; solve or import such rows",
    Code.MOMENT_ALONE: "{axis}{amount} alone lies outside the rows, and the loads of this wrench "
    "are added up from there",
    Code.BEYOND_SPAN: "{name} = {value:.6g} {unit} is beyond the rows that show errors, {low:.6g} "
    "to {high:.6g} {unit}; solve or import rows there",
    Code.OVER_TOLERANCE: "{axis}the interpolation error of {name}, {value:.2g} {unit}, is over "
    "the tolerance, {limit:.2g} {unit}",
    Code.NOT_IN_SCENE: "{amount} cannot occur in the scene: {low:.6g}..{high:.6g} {unit}",
}
_RANGES: Mapping[int, str] = {
    Code.BEYOND_RANGE: "space/range",
    Code.BEYOND_SPAN: "g{}/kriging/span_loads",
    Code.NOT_IN_SCENE: "scene/range",
}


def unmeasured_text(missing: int, packed: Packed) -> str:
    """Return the text on outputs that no row has, by the bits of a mask; empty for none."""
    names = [output["name"] for output in packed.meta["space"]["outputs"]]
    read = packed.meta.get("scene", {}).get("outputs", names)
    unmeasured = [name for bit, name in enumerate(names) if missing >> bit & 1 and name in read]
    return f"not measured in any row: {', '.join(unmeasured)}" if unmeasured else ""
