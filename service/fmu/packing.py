"""A surrogate as the flat arrays that an FMU answers from.

The binding to the room `surrogate` is at its packed arrays (`kriging.compiled`) and at the public
attributes beside them. What is computed from them is written once more, in C; a test holds both to
the same numbers. Tables that the axes answer are refused until the packed table is what an FMU
holds: the C code here has the law of their error bars that version 0.2 had.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from service.fmu.stream import MOST_BYTES, Stream
from surrogate.answer import METHODS as ALL_METHODS
from surrogate.answer import UnknownMethodError
from surrogate.build import AnyTable
from surrogate.kriging import Kriging
from surrogate.kriging.compiled_tables import Tables, tables_of
from surrogate.kriging.dense import Dense
from surrogate.methods.reference import KrigingReference
from surrogate.missing_outputs import MissingOutputs
from surrogate.surrogate import Surrogate
from surrogate.table.compliance import ComplianceFit
from surrogate.table.rows import CLEAN

METHODS = ("griddata", "tangent", "kriging", "linear", "nearest")  # their numbers in c/wb_table.h
NO_REFERENCE, BY_KRIGING = -1, 2
AXES = ("griddata", "additive", "tangent")
NO_ERROR = np.zeros((6, 6)), np.zeros(6), np.zeros(6), np.zeros((6, 6)), np.zeros(1)


class NotExportableError(ValueError):
    """A table that no FMU can hold; the text says why and what to do."""


class Group(NamedTuple):
    """Outputs that one surrogate answers, by one method."""

    outputs: tuple[int, ...]
    surrogate: Surrogate
    method: str


def pack_table(table: AnyTable, method: str | None = None) -> bytes:
    """Return a table's arrays, answering by `method` or the table's default.

    Raises
    ------
    NotExportableError
        If the table has no rows within its load range, its kriging is one of nearest rows, or the
        arrays are more than 256 MB.
    """
    groups = groups_of(table, method)
    stream = Stream()
    stream.ints(len(groups))
    for group in groups:
        _pack_group(stream, group)
        if stream.size > MOST_BYTES:
            break
    error = table.solver_error
    stream.floats(*(NO_ERROR if error is None else error.packed))
    limit = table.tolerance
    own = (np.nan, np.nan) if limit is None else (limit.translation, limit.rotation)
    stream.floats(np.array([float(table.bars_are_whole), *own]))
    if stream.size > MOST_BYTES:
        raise NotExportableError(
            f"the table takes over {MOST_BYTES / 1e6:,.0f} MB, which is the most that an FMU may "
            "hold: ask for --method griddata, or export a table with fewer rows"
        )
    return stream.content


def groups_of(table: AnyTable, method: str | None = None) -> list[Group]:
    """Return which surrogate answers which outputs, and how.

    Raises
    ------
    UnknownMethodError
        If the method is none of `METHODS`.
    NotExportableError
        If one has no rows within the load range, or the axes tell its answers or error bars.
    """
    if method is not None and method not in ALL_METHODS:
        raise UnknownMethodError(method)
    several = isinstance(table, MissingOutputs)
    parts = table.groups if several else ((tuple(range(6)), table),)
    if not parts or not len(table.rows):
        raise NotExportableError("the table has no rows: fill or import it first, then export it")
    groups = []
    for outputs, part in parts:
        if not len(part.used):
            raise NotExportableError(
                "all rows of the table are outside its load range: nothing answers within it"
            )
        chosen = method or part.default
        if chosen == "kriging" and part.kriging is None:
            chosen = "tangent"  # what answers in its place: `Surrogate`
        group = Group(outputs, part, chosen)
        if chosen in AXES or (not _is_exact(group) and part.default != "kriging"):
            raise NotExportableError(
                "no FMU holds yet what the axes answer this table by, or tell its error bars by "
                f"({part.choice.reason})"
            )
        groups.append(group)
    return groups


def _pack_group(stream: Stream, group: Group) -> None:
    part, mode = group.surrogate, _reference_mode(group)
    stream.ints(
        np.isin(np.arange(6), group.outputs),
        METHODS.index(group.method),
        mode,
        part.doubt.knows_interaction,
        part.doubt.rest_unknown,
        part.doubt.size_known,
        _is_exact(group),
    )
    _pack_limits(stream, group)
    _pack_rows(stream, part)
    stream.ints(0)  # no composition
    kriging = _kriging_of(group, mode)
    stream.ints(kriging is not None)
    if kriging is not None:
        _pack_kriging(stream, kriging)
    stream.ints(group.method == "linear")
    if group.method == "linear":
        _pack_fit(stream, part.fit)
    near = part.used if group.method == "nearest" else part.used.take(np.empty(0, dtype=int))
    stream.ints(len(near))
    stream.floats(near.wrench / part.load_range.scale, near.displacement)


def _is_exact(group: Group) -> bool:
    part = group.surrogate
    return group.method == "linear" and part.linear and part.fit.complete


def _reference_mode(group: Group) -> int:
    """Return what the bars are held against; a kriging and an exact compliance tell their own."""
    if group.method == "kriging" or _is_exact(group):
        return NO_REFERENCE
    return BY_KRIGING


def _kriging_of(group: Group, mode: int) -> Kriging | None:
    """Return the kriging that answers or is the reference."""
    if group.method == "kriging":
        return group.surrogate.kriging
    if mode == NO_REFERENCE:
        return None
    reference = group.surrogate.reference
    assert isinstance(reference, KrigingReference)
    return reference.kriging


def _pack_limits(stream: Stream, group: Group) -> None:
    part = group.surrogate
    scale = part.load_range.scale
    # The ends that `LoadRange.exceeded` holds a load against.
    low = np.minimum(part.load_range.low, 0.0) - 1e-9 * scale
    high = np.maximum(part.load_range.high, 0.0) + 1e-9 * scale
    allowed = np.array(part.allowed.of(group.method, None))
    stream.floats(low, high, CLEAN * scale, allowed, scale)


def _pack_rows(stream: Stream, part: Surrogate) -> None:
    """Pack what rows say at and beside their own wrenches, in the order that they are found by."""
    exact = part.exact
    owner = exact.owner[exact.index.order]
    stream.ints(len(owner))
    stream.floats(exact.index.keys, exact.index.rates, exact.steepest)
    stream.ints(exact.index.order)
    stream.floats(exact.wrenches[exact.index.order], exact.told.displacement[owner])
    stream.floats(np.nan_to_num(exact.told.uncertainty[owner]))
    tangents = exact.told.compliance[owner]
    has_one = np.isfinite(tangents).any(axis=(1, 2))
    stream.ints(np.where(has_one, np.cumsum(has_one) - 1, -1), int(has_one.sum()))
    stream.floats(tangents[has_one])


def _pack_fit(stream: Stream, fit: ComplianceFit) -> None:
    stream.floats(fit.matrix, fit.bar)
    stream.ints(fit.known)


def _pack_kriging(stream: Stream, kriging: Kriging) -> None:
    """Pack a dense kriging: what all its outputs share, then each factor's neighbourhoods.

    Raises
    ------
    NotExportableError
        If it answers by the nearest rows.
    """
    inside = kriging.inside
    if not isinstance(inside, Dense):
        raise NotExportableError(
            f"{kriging.detail}: an FMU holds one factor over all rows only; export with "
            "--method griddata"
        )
    told = [_tables(kriging, replace(inside, shares=(share,))) for share in inside.shares]
    first = told[0]
    stream.ints(first.x.shape[1])
    stream.floats(first.x, first.terms, first.weights, first.coefficients, first.scales)
    stream.floats(first.floor, first.tangent)
    stream.ints(len(told))
    for share, tables in zip(inside.shares, told, strict=True):
        _pack_share(stream, np.isin(np.arange(6), share.factor.outputs), tables)


def _tables(kriging: Kriging, inside: Dense) -> Tables:
    floor = kriging.settings.bar_floor
    found = tables_of(inside, kriging.scaling, kriging.conformal, kriging.tangent, floor)
    assert found is not None  # of one factor
    return found


def _pack_share(stream: Stream, outputs: np.ndarray, tables: Tables) -> None:
    size = tables.places.shape[1]
    places = np.triu_indices(size)  # the lower triangle, column after column
    stream.ints(size, outputs, tables.places)
    stream.floats(tables.columns[:, *places], tables.unsettled, tables.least)
    stream.floats(tables.mean_covariance)
