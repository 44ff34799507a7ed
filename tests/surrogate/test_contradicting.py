"""Measured rows beside solves: of one output alone, or at odds with the solves."""

from __future__ import annotations

import numpy as np
import pytest

from tests.surrogate.calibrating import Shipped, shipped
from tests.surrogate.law import build
from wrenchbook.surrogate.build import Table
from wrenchbook.surrogate.kriging.calibration import Errors, factors_of
from wrenchbook.surrogate.table.rows import Rows

NOT_UZ = [0, 1, 3, 4, 5]


@pytest.fixture(scope="module")
def plate() -> Shipped:
    """38 solves of the thin plate with tangents, and 220 wrenches to ask."""
    return shipped("plate_thin", 24, 14)


def middle(plate: Shipped) -> np.ndarray:
    """Places of the two asked wrenches that are nearest to the middle of the range, (2,)."""
    scaled = (plate.asked - (plate.load_range.low + plate.load_range.high) / 2) / (
        plate.load_range.scale
    )
    return np.argsort(np.abs(scaled).max(axis=1))[:2]


def measured(plate: Shipped, factor: float = 1.0, more: float = 0.0, **columns: object) -> Rows:
    """Two measured rows in the middle, u_z so many times the truth and so much more, m."""
    places = middle(plate)
    moved = plate.true[places].copy()
    moved[:, 2] = moved[:, 2] * factor + more
    return Rows.of(plate.asked[places], moved, source=["measured"] * 2, **columns)


def uz_alone(rows: Rows) -> Rows:
    """The same rows without the outputs other than u_z."""
    moved = rows.displacement.copy()
    moved[:, NOT_UZ] = np.nan
    return Rows.of(rows.wrench, moved, source=rows.source.tolist())


def others(plate: Shipped) -> np.ndarray:
    """Which asked wrenches are not measured."""
    return np.setdiff1d(np.arange(len(plate.asked)), middle(plate))


def inside(plate: Shipped, table: Table) -> np.ndarray:
    """Part of the solver's displacements inside the bars that the kriging gives, (6,)."""
    chosen = others(plate)
    reported = table.batch(plate.asked[chosen], None, "kriging")
    known = ~np.isnan(reported.error)
    assert known.mean() > 0.85  # elsewhere wrenches are further from the rows than any row is
    missed = np.abs(reported.displacement - plate.true[chosen]) > reported.error
    return 1 - (missed & known).sum(axis=0) / known.sum(axis=0)


def covered(plate: Shipped, table: Table) -> float:
    """Part of the wrenches that are not measured that a table covers."""
    return float((table.batch(plate.asked[others(plate)]).coverage == 0).mean())


def test_rows_that_measured_one_output_leave_the_kriging_the_default(plate: Shipped) -> None:
    table = build(plate.rows + uz_alone(measured(plate)), plate.load_range)
    reported = table.coverage_summary()
    assert reported["method"] == "kriging"
    # As much as the solves alone: what lies further from the rows than any row has no error bar.
    solves = build(plate.rows, plate.load_range)
    assert covered(plate, table) > 0.97 * covered(plate, solves) > 0.85
    assert inside(plate, table).min() >= 0.95


def test_errors_left_out_are_finite_where_rows_lack_outputs(plate: Shipped) -> None:
    for rows in (measured(plate), measured(plate, 1.2), measured(plate, more=2e-3)):
        table = build(plate.rows + uz_alone(rows), plate.load_range)
        solves, every = (group.choice.errors for group in table.groups)
        assert set(solves) == {"kriging"}
        assert set(every) == {"kriging"}
        assert np.isfinite([*solves.values(), *every.values()]).all()


def test_outputs_that_no_row_holds_make_no_bar_narrower() -> None:
    errors = np.random.default_rng(1).standard_t(3, (40, 6))
    only = errors * np.array([0, 0, 1, 0, 0, 0])

    def factors(of: np.ndarray) -> np.ndarray:
        ones = np.ones(len(of))
        return factors_of(Errors(of, np.abs(of), ones), 7, 6)

    assert factors(only)[2] == pytest.approx(factors(errors[:, [2] * 6])[2])
    assert factors(only)[2] > 0.5 * factors(errors)[2]
