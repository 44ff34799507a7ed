"""Kinds of tables, their packed forms, and wrenches to ask them."""

from __future__ import annotations

from functools import cache
from functools import partial as partial_of
from pathlib import Path

import numpy as np

from tests.service.live import FULL, clean_wrenches, full_wrenches, moved, tangents
from tests.surrogate.energies import PARTS, part
from tests.surrogate.law import Law, build
from tests.surrogate.responses import HIGH
from tests.surrogate.softening import softening_table
from tests.surrogate.test_space import SPACES, range_of, solved_with_second
from wrenchbook.surrogate.build import Table
from wrenchbook.surrogate.kernel.binding import PackedTable
from wrenchbook.surrogate.packed.writer import pack
from wrenchbook.surrogate.solver_error import SolverError
from wrenchbook.surrogate.table.axes import OffAxis
from wrenchbook.surrogate.table.rows import LoadRange, Rows, Tolerance
from wrenchbook.surrogate.table.space import Space
from wrenchbook.surrogate.table.spread import spread_wrenches

RANGE = LoadRange(-FULL, FULL)
SOLVED = Path(__file__).parents[1] / "tables"


def solved(name: str, clean: int, full: int, **more: object) -> Table:
    """A table of real solves of a shipped component, with tangents."""
    with np.load(SOLVED / f"{name}.npz") as file:
        result = dict(file)
    chosen = np.r_[:clean, result["clean"] : result["clean"] + full]
    columns = {"compliance": result["compliance"][chosen], "source": ["fea"] * len(chosen)}
    rows = Rows.of(result["wrench"][chosen], result["displacement"][chosen], **columns)
    return build(rows, LoadRange(result["low"], result["high"]), **more)


def measured(wrenches: np.ndarray, **columns: object) -> Table:
    """A table of the made-up response of `moved`."""
    return build(Rows.of(wrenches, moved(wrenches), **columns), RANGE)


def clean(per_axis: int, seed: int = 3) -> np.ndarray:
    """Random wrenches of one axis each, (3 per_axis, 6), N and N·m."""
    rng, wrenches = np.random.default_rng(seed), np.zeros((3, per_axis, 6))
    for axis in range(3):
        loads = [axis, 3 + (axis + 1) % 3, 3 + (axis + 2) % 3]
        wrenches[axis][:, loads] = rng.uniform(-1, 1, (per_axis, 3)) * FULL[loads]
    return wrenches.reshape(-1, 6)


def grid(loads: tuple[int, ...], count: int) -> np.ndarray:
    """A regular grid over some loads, the others zero."""
    places = np.array(list(np.ndindex(*(count,) * len(loads)))) * 2 / (count - 1) - 1
    wrenches = np.zeros((len(places), 6))
    wrenches[:, loads] = places
    return wrenches * FULL


def linear(count: int) -> Table:
    """A linear component of which so many unit solves are known."""
    compliance = np.random.default_rng(3).normal(size=(6, 6)) * 1e-6
    loads = np.eye(6)[:count] * FULL
    reported = {
        "mesh": (1e-8 * np.eye(6)).tolist(),
        "linearity": [1e-6] * 6,
        "loads": FULL.tolist(),
    }
    rows = Rows.of(loads, loads @ compliance.T, source=["fea"] * count)
    return build(rows, RANGE, linear=True, solver_error=SolverError(reported))


def partial() -> Table:
    """A rig that measured r_y never, and u_z in some rows only."""
    wrenches = np.concatenate((clean(30), full_wrenches(24)))
    reported = moved(wrenches)
    reported[:, 4], reported[30:, 2] = np.nan, np.nan
    return build(Rows.of(wrenches, reported), RANGE)


def uncertain() -> Table:
    """Rows of several noise levels, which have a factor each."""
    wrenches = np.concatenate((clean_wrenches(), full_wrenches(30)))
    doubt = np.abs(np.random.default_rng(5).normal(size=(len(wrenches), 6)))
    doubt *= 1e-6 * np.array([1, 1, 1, 1, 1, 100])
    return measured(wrenches, uncertainty=doubt)


def huge() -> Table:
    """A response whose estimates beyond the range leave what tables may hold."""
    wrenches = clean(40)
    return build(Rows.of(wrenches, 3e3 * moved(wrenches)), RANGE)


def tangent_rows(count: int) -> Table:
    """Full wrenches of the made-up response, with tangents."""
    wrenches = full_wrenches(count)
    return measured(wrenches, compliance=tangents(wrenches))


def bent(second: int) -> Table:
    """Solves of a made-up part, of which so many bring second derivatives."""
    rows = part(PARTS["stiffening"], 1).rows(np.random.default_rng(2).uniform(-1, 1, (20, 6)))
    rows.curvature[second:] = np.nan
    return build(rows, LoadRange(-1.1 * HIGH, 1.1 * HIGH))


def off_axis(way: OffAxis) -> Table:
    """Rows of one axis that bear a little of others, and rows of all loads."""
    wrenches = np.concatenate((clean(12) + 1e-3 * full_wrenches(36), full_wrenches(10)))
    return build(Rows.of(wrenches, moved(wrenches)), RANGE, off_axis=way)


def repeated() -> Table:
    """Rows of one wrench, and near each other, of several sources."""
    wrenches = np.concatenate((clean(12), full_wrenches(6), full_wrenches(6)))
    wrenches[-3:] += 1e-8 * FULL
    sources = ["fea"] * (len(wrenches) - 6) + ["rig"] * 6
    return measured(wrenches, source=sources)


KINDS = {
    "solved": lambda: solved("plate_thin", 18, 20),
    "solved with a tolerance": lambda: solved(
        "plate_thin", 24, 20, tolerance=Tolerance(1e-5, 1e-4)
    ),
    "clean": lambda: measured(clean(60)),
    "clean and full": lambda: measured(np.concatenate((clean(40), full_wrenches(30)))),
    **{
        f"clean and full, off-axis loads {way}": partial_of(off_axis, way)
        for way in ("ignore", "exclude")
    },
    "full": lambda: measured(full_wrenches(60)),
    "few with tangents": lambda: tangent_rows(6),
    "second derivatives": lambda: bent(20),
    "second derivatives of some": lambda: bent(8),
    "thin": lambda: measured(clean(5)),
    "planar": lambda: measured(grid((2, 3), 5)),
    "one force": lambda: measured(grid((2,), 7)),
    "one axis": lambda: measured(grid((2, 3, 4), 3)),
    "oblique line": lambda: measured(np.outer(np.arange(-4, 5), [0, 0, 10, 0.5, 0, 0])),
    "no row near zero": lambda: measured(grid((2, 3), 2)[:3] + 5.0),
    "one row": lambda: measured(np.array([[0.0, 0, 5, 0, 0, 0]])),
    "one row at rest": lambda: measured(np.zeros((1, 6))),
    "rows beyond the range": lambda: measured(np.concatenate((clean(30), 3 * full_wrenches(5)))),
    "only beyond the range": lambda: measured(3 * FULL * np.eye(6)),
    "empty": lambda: build(Rows.empty(), RANGE),
    "partial": partial,
    "uncertain": uncertain,
    "repeated": repeated,
    "huge": huge,
    "linear": lambda: linear(6),
    "linear, two loads unknown": lambda: linear(4),
    "softening": softening_table,
}


def of_space(space: Space) -> Table:
    """Solves of several interfaces or further inputs, which bring second derivatives."""
    load_range = range_of(space)
    return build(solved_with_second(space, spread_wrenches(load_range, 12)), load_range)


OF_SPACES = {name: partial_of(of_space, space) for name, space in SPACES.items()}
QUICK = (
    "solved",
    "clean and full",
    "second derivatives of some",
    "partial",
    "linear, two loads unknown",
    "one row",
    "two interfaces",
)
"""A table of each law; a test of all kinds asks these in `make test`."""


@cache
def table_of(kind: str, locked: tuple[int, ...] = ()) -> Table:
    """The table of a kind, built once."""
    table = (KINDS | OF_SPACES)[kind]().table
    table.locked = locked
    for group in table.groups:
        group.locked = locked
    return Law(table)


@cache
def packed_of(kind: str, locked: tuple[int, ...] = ()) -> PackedTable:
    """Its packed form."""
    return PackedTable.from_bytes(b"".join(pack(table_of(kind, locked), component=kind)))


def asked_of(table: Table, count: int, seed: int = 1, span: float = 1.1) -> np.ndarray:
    """Random wrenches, (count, n), within so much of the load range."""
    loads = table.load_range
    x = np.random.default_rng(seed).uniform(-span, span, (count, len(loads.low)))
    return (loads.low + loads.high) / 2 + x * loads.scale


def special_of(table: Table, count: int, seed: int = 2) -> np.ndarray:
    """Wrenches of few loads, of one, of none, of rows and near rows."""
    rng = np.random.default_rng(seed)
    asked = asked_of(table, count, seed) * (rng.random((count, len(table.load_range.low))) < 0.4)
    asked[0] = 0.0
    rows = table.rows.wrench[: count // 4]
    near = rows + rng.uniform(-1, 1, rows.shape) * table.load_range.scale * 9e-7
    return np.concatenate((asked, rows, near))


def size_of(table: Table) -> np.ndarray:
    """What each output is compared relative to, (m,), m and rad: its largest row."""
    size = np.nanmax(np.abs(table.rows.displacement), axis=0, initial=0.0)
    size = np.fmax(size, 1e-3 * np.repeat(size.reshape(-1, 3).max(axis=1), 3))
    return np.where(size > 0, size, 1.0)


def rounding_of(table: Table) -> np.ndarray:
    """What sums of a kriging may lose to rounding, (m,), m and rad: no error bar is below it."""
    result = np.zeros(table.rows.displacement.shape[1])
    for group in table.groups:
        if group.kriging is not None:
            lost = group.kriging.rounding * group.kriging.scaling.spread
            result[list(group.outputs)] += lost[list(group.outputs)]
    return result


SAME = 1e-12  # of an output's range
SIGMA = 1e-9  # of an error
