"""One wrench has the same bits alone, at any place of a batch, by any number of threads.

The kernel has one routine for all of them, `wb_reply_of`; random tables of every kind show it.
"""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace

import numpy as np
import pytest

from tests.surrogate.energies import PARTS, part
from tests.surrogate.kriging.responses import RESPONSES, noisy_rows, solved, spread_wrenches
from tests.surrogate.responses import HIGH, RANGE, full_wrenches
from tests.surrogate.test_space import SPACES, range_of, solved_with_second
from tests.surrogate.test_space import solved as solved_in
from wrenchbook.surrogate.answer import METHODS, NAMES, UnknownMethodError
from wrenchbook.surrogate.build import Table, build
from wrenchbook.surrogate.kernel.binding import PackedTable
from wrenchbook.surrogate.kriging import likelihood
from wrenchbook.surrogate.packed.writer import pack
from wrenchbook.surrogate.scene.cut import cut
from wrenchbook.surrogate.scene.plan import need_of
from wrenchbook.surrogate.solver_error import SolverError
from wrenchbook.surrogate.table.axes import OffAxis
from wrenchbook.surrogate.table.rows import LoadRange, Rows, Tolerance
from wrenchbook.surrogate.table.spread import spread_wrenches as spread_in

Random = np.random.Generator
OFF_AXIS: tuple[OffAxis, ...] = ("correct", "ignore", "exclude")
MESH = SolverError({"mesh": np.full((6, 6), 1e-9).tolist(), "loads": HIGH.tolist()})


def response(random: Random) -> Callable[[np.ndarray], np.ndarray]:
    return RESPONSES[str(random.choice(sorted(RESPONSES)))]


def single_axis(random: Random) -> Table:
    """Rows of one axis each, from too few to many, some with a few of all loads."""
    x = spread_wrenches(int(random.integers(1, 14)), int(random.integers(0, 8)), _seed(random))
    return build(Rows.of(x * HIGH, response(random)(x)), RANGE, off_axis=_off_axis(random))


def additive(random: Random) -> Table:
    x = spread_wrenches(int(random.integers(4, 12)), int(random.integers(20, 30)), _seed(random))
    return build(Rows.of(x * HIGH, response(random)(x)), RANGE, off_axis=_off_axis(random))


def from_values(random: Random) -> Table:
    x = full_wrenches(int(random.integers(20, 35)), _seed(random))
    return build(Rows.of(x * HIGH, response(random)(x)), RANGE)


def from_slopes(random: Random) -> Table:
    rows = solved(response(random), full_wrenches(int(random.integers(1, 16)), _seed(random)))
    tolerance = random.choice([None, Tolerance(1e-4, 1e-3)])
    return build(rows, RANGE, tolerance=tolerance, solver_error=random.choice([None, MESH]))


def from_second_derivatives(random: Random) -> Table:
    made = part(PARTS[str(random.choice(sorted(PARTS)))], _seed(random))
    rows = made.rows(random.uniform(-1, 1, (int(random.integers(6, 14)), 6)))
    rows.curvature[int(random.integers(0, len(rows) + 1)) :] = np.nan
    return build(rows, LoadRange(-1.1 * HIGH, 1.1 * HIGH))


def linear(random: Random) -> Table:
    loads = np.eye(6)[: int(random.integers(2, 7))] * HIGH
    rows = Rows.of(loads, 1e-6 * loads @ random.normal(size=(6, 6)), source=["fea"] * len(loads))
    return build(rows, RANGE, linear=True, solver_error=random.choice([None, MESH]))


def measured(random: Random) -> Table:
    """Noisy rows, with or without stated uncertainties."""
    x = spread_wrenches(int(random.integers(6, 12)), int(random.integers(0, 25)), _seed(random))
    return build(noisy_rows(response(random), x, 3, bool(random.integers(2))), RANGE)


def partial(random: Random) -> Table:
    """Outputs that some rows, or all, do not have: several groups."""
    x = spread_wrenches(int(random.integers(6, 12)), int(random.integers(0, 25)), _seed(random))
    moved = response(random)(x)
    moved[random.random(len(x)) < 0.3, int(random.integers(6))] = np.nan
    moved[:, int(random.integers(6))] = np.nan
    return build(Rows.of(x * HIGH, moved), RANGE)


def several_inputs(random: Random) -> Table:
    """Two interfaces, or a temperature."""
    space = SPACES[str(random.choice(sorted(SPACES)))]
    make = solved_with_second if random.integers(2) else solved_in
    wrenches = spread_in(range_of(space), int(random.integers(4, 14)))
    return build(make(space, wrenches), range_of(space))


def scene(random: Random) -> PackedTable:
    """A table cut to some loads and outputs."""
    whole = packed(random.choice([additive, from_slopes, linear, partial])(random))
    loads = random.random(6) < 0.5
    low, high = np.sort(random.uniform(-1, 1, (2, 6)), axis=0) * HIGH * loads
    outputs = np.flatnonzero(random.random(6) < 0.7).tolist() or [0]
    return PackedTable.from_bytes(
        b"".join(cut(whole, need_of(RANGE, np.column_stack((low, high)), outputs)))
    )


KINDS = {
    one.__name__: one
    for one in (
        *(single_axis, additive, from_values, from_slopes, from_second_derivatives),
        *(linear, measured, partial, several_inputs, scene),
    )
}


def _seed(random: Random) -> int:
    return int(random.integers(2**32))


def _off_axis(random: Random) -> OffAxis:
    return OFF_AXIS[int(random.integers(3))]


def packed(table: Table) -> PackedTable:
    return PackedTable.from_bytes(b"".join(pack(table)))


def asked_of(table: PackedTable, random: Random) -> np.ndarray:
    """Wrenches within 1.2 of the range, some loads zero; of rows and beside them."""
    low, high = table.arrays["space/range"]
    asked = (low + high) / 2 + random.uniform(-0.6, 0.6, (25, table.inputs)) * (high - low)
    asked[10:] *= random.random(asked[10:].shape) < 0.5
    asked[-1] = 0.0
    rows = table.arrays.get("g0/rows/wrench", asked[:0])[:4]
    return np.concatenate((asked, rows, rows + 5e-7 * (high - low)))


def singles(table: PackedTable, asked: np.ndarray, method: str | None) -> list[np.ndarray]:
    """Outputs and errors (k, m), coverage (k,) and slopes (k, m, n), a call for each wrench."""
    unknown = (np.nan,) * table.outputs
    replies = [table.answer(wrench, None, method) for wrench in asked.tolist()]
    return [
        np.array([one.outputs or unknown for one in replies], dtype=float),
        np.array([one.error or unknown for one in replies], dtype=float),
        np.array([NAMES.index(one.coverage) for one in replies], dtype=np.uint8),
        np.array([table.derivative(wrench, None, method) for wrench in asked]),
    ]


@pytest.mark.parametrize("number", range(200))
def test_one_wrench_has_the_same_bits_alone_and_in_any_batch(
    number: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    random = np.random.default_rng(number)

    def anywhere(*_: object, bounds: list[tuple[float, float]], **__: object) -> SimpleNamespace:
        low, high = np.array(bounds).T
        return SimpleNamespace(
            fun=0.0, x=low + (0.2 + 0.6 * random.random(len(low))) * (high - low)
        )

    monkeypatch.setattr(likelihood, "minimize", anywhere)  # no search: bits need none
    made = list(KINDS.values())[number % len(KINDS)](random)
    table = made if isinstance(made, PackedTable) else packed(made)
    asked = asked_of(table, random)
    for method in (None, *METHODS):
        try:
            table.answer(asked[0].tolist(), None, method)
        except UnknownMethodError:
            continue
        alone = singles(table, asked, method)
        for size, threads in ((1, 1), (7, 1), (len(asked), 1), (4099, 1), (4099, 2), (4099, 3)):
            if method and size > 2048:  # wrenches of a block, which one thread answers
                continue
            places = np.resize(np.arange(len(asked)), size)
            batch = table.batch(asked[places], None, method, threads)
            for column, expected in zip(batch, alone, strict=False):
                np.testing.assert_array_equal(column, expected[places])
            if size < 2048 or threads == 2:
                slopes = table.derivatives(asked[places[:2051]], None, method, threads)
                np.testing.assert_array_equal(slopes, alone[3][places[:2051]])
