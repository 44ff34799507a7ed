"""Off the hull: steps by slopes and by the compliance, and bars by what the kriging knows."""

import numpy as np
import pytest

from tests.surrogate.law import Law, build
from tests.surrogate.responses import HIGH, RANGE, full_wrenches, smooth
from wrenchbook.surrogate.axes.axes import OFF_HULL
from wrenchbook.surrogate.packed.writer import packed_of
from wrenchbook.surrogate.table.rows import Rows


def _one_axis():
    """A table of F_z, M_x and M_y: what other loads do is not known."""
    places = np.zeros((27, 6))
    places[:, [2, 3, 4]] = np.array(list(np.ndindex(3, 3, 3))) - 1.0
    rows = np.concatenate((places, full_wrenches(24, 5) * np.array([0, 0, 1, 1, 1, 0])))
    return build(Rows.of(rows * HIGH, smooth(rows)), RANGE)


@pytest.mark.parametrize("method", ["griddata", "additive"])
def test_steps_by_loads_that_no_row_has_make_the_error_bar_unknown(method: str) -> None:
    table, asked = _one_axis(), 1.1 * full_wrenches(40, 6) * HIGH
    found = table.batch(asked, None, method)
    assert (table.axes.evaluate(asked).state >= OFF_HULL).all()
    assert np.isnan(found.error).all()
    assert all(table.answer(wrench, None, method).error is None for wrench in asked)


def proportional(wrenches: list[list[float]]) -> Law:
    """Rows of a response in proportion, with tangents."""
    loads = np.array(wrenches, dtype=float)
    compliance = np.diag([1e-6] * 6)
    slopes = np.tile(compliance, (len(loads), 1, 1))
    return build(Rows.of(loads, loads @ compliance, compliance=slopes), RANGE)


@pytest.mark.parametrize("method", ["griddata", "additive"])
@pytest.mark.parametrize("rows", [[[0, 0, 500, 0, 0, 0]], [[0, 0, z, 0, 0, 0] for z in (-9, 0, 9)]])
def test_steps_off_what_the_rows_span_are_counted_once(rows, method) -> None:
    """By the tangent of the row and by the compliance, 700 N after 500 N moved it by 900 um."""
    table = proportional(rows)
    asked = [0.0, 0.0, 700.0, 300.0, 0.0, 0.0]
    expected = 1e-6 * np.array(asked)
    for moved in (
        table.answer(asked, None, method).displacement,
        packed_of(table).answer(asked, None, method).outputs,
    ):
        np.testing.assert_allclose(moved, expected, rtol=1e-12, atol=1e-18)


@pytest.mark.parametrize("method", ["griddata", "additive"])
@pytest.mark.parametrize("asked", [[0, 0, 700.0, 0, 0, 0], [0, 0, 4.0, 3.0, 0, 0]])
def test_the_derivative_off_what_the_rows_span_is_that_of_the_answer(asked, method) -> None:
    """It was 0 by the only row's own load, and twice as much by a moment of two axes."""
    for rows in ([[0, 0, 500, 0, 0, 0]], [[0, 0, z, 0, 0, 0] for z in (-9, 0, 9)]):
        table = packed_of(proportional(rows))
        found = table.derivative(asked, None, method)[:, [2, 3]]
        np.testing.assert_allclose(found, np.diag([1e-6] * 6)[:, [2, 3]], rtol=1e-12, atol=1e-18)


def test_the_derivative_by_a_load_that_no_row_tells_is_unknown() -> None:
    """It was 0 in a covered answer."""
    loads = np.linspace(-1, 1, 9)[:, None] * np.array([0, 0, 1000.0, 0, 0, 0])
    table = packed_of(build(Rows.of(loads, 1e-6 * loads), RANGE))
    found = table.derivative([0, 0, 150.0, 0, 0, 0])
    assert found[2, 2] == pytest.approx(1e-6, rel=1e-5)  # the kriging's, of its nugget
    assert np.isnan(found[2, [3, 4]]).all()
