"""Off the hull: steps by slopes and by the compliance, and bars by what the kriging knows."""

import numpy as np
import pytest

from tests.surrogate.law import Law, build
from tests.surrogate.responses import HIGH, RANGE, clean_wrenches, full_wrenches, smooth
from wrenchbook.surrogate.packed.writer import packed_of
from wrenchbook.surrogate.table.rows import RowError, Rows, Tolerance, joined


def _one_axis():
    """A table of F_z, M_x and M_y: what other loads do is not known."""
    places = np.zeros((27, 6))
    places[:, [2, 3, 4]] = np.array(list(np.ndindex(3, 3, 3))) - 1.0
    rows = np.concatenate((places, full_wrenches(24, 5) * np.array([0, 0, 1, 1, 1, 0])))
    return build(Rows.of(rows * HIGH, smooth(rows)), RANGE)


@pytest.mark.parametrize("method", ["griddata", "additive"])
def test_steps_by_loads_that_no_row_has_make_the_error_bar_unknown(method: str) -> None:
    table, asked = _one_axis(), 1.1 * full_wrenches(40, 6) * HIGH
    result = table.batch(asked, None, method)
    assert np.isnan(result.error).all()
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
        result = table.derivative(asked, None, method)[:, [2, 3]]
        np.testing.assert_allclose(result, np.diag([1e-6] * 6)[:, [2, 3]], rtol=1e-12, atol=1e-18)


def test_the_derivative_by_a_load_that_no_row_tells_is_unknown() -> None:
    """It was 0 in a covered answer."""
    loads = np.linspace(-1, 1, 9)[:, None] * np.array([0, 0, 1000.0, 0, 0, 0])
    table = packed_of(build(Rows.of(loads, 1e-6 * loads), RANGE))
    result = table.derivative([0, 0, 150.0, 0, 0, 0])
    assert result[2, 2] == pytest.approx(1e-6, rel=1e-5)  # the kriging's, of its nugget
    assert np.isnan(result[2, [3, 4]]).all()


SCALED = clean_wrenches(40, 1)
ASKED = full_wrenches(50, 2) * 0.8


def rows_with(measured: np.ndarray) -> Rows:
    moved = np.where(measured, smooth(SCALED), np.nan)
    return Rows.of(SCALED * HIGH, moved, source=["measured"] * len(SCALED))


def test_an_output_nobody_measured_is_none_and_the_reason_says_so() -> None:
    measured = np.zeros((len(SCALED), 6), dtype=bool)
    measured[:, 2] = True
    surrogate = build(rows_with(measured), RANGE)
    whole = build(Rows.of(SCALED * HIGH, smooth(SCALED)), RANGE)
    answer = surrogate.answer((ASKED[0] * HIGH).tolist(), method="griddata")
    assert answer.displacement is not None
    expected = whole.answer((ASKED[0] * HIGH).tolist(), method="griddata").displacement
    assert expected is not None
    assert answer.displacement[2] == pytest.approx(expected[2], rel=1e-12)
    others = [value for k, value in enumerate(answer.displacement) if k != 2]
    assert others == [None] * 5
    assert answer.error is None  # no row loads several axes
    assert answer.coverage == "thin"
    assert answer.missing == ("ux", "uy", "rx", "ry", "rz")
    only_z = surrogate.answer([0.0, 0.0, 2000.0, 50.0, 50.0, 0.0], Tolerance(1.0, 1.0))
    assert only_z.coverage == "covered"
    assert only_z.error is not None
    assert [value for k, value in enumerate(only_z.error) if k != 2] == [None] * 5
    assert only_z.missing == answer.missing
    assert only_z.reason == "not measured in any row: ux, uy, rx, ry, rz"
    assert surrogate.coverage_summary()["unmeasured"] == ["ux", "uy", "rx", "ry", "rz"]


def test_each_output_uses_all_rows_that_hold_it_and_no_other() -> None:
    measured = np.ones((len(SCALED), 6), dtype=bool)
    measured[::3, 3:] = False
    surrogate = build(rows_with(measured), RANGE)
    whole = build(Rows.of(SCALED * HIGH, smooth(SCALED)), RANGE)
    fewer = build(rows_with(measured).take(measured[:, 3]), RANGE)
    for method in ("griddata", "additive"):
        batch, of_whole, of_fewer = (
            each.batch(ASKED * HIGH, method=method).displacement
            for each in (surrogate, whole, fewer)
        )
        np.testing.assert_array_equal(batch[:, :3], of_whole[:, :3])
        np.testing.assert_array_equal(batch[:, 3:], of_fewer[:, 3:])
    assert surrogate.coverage_summary()["rows_per_output"] == {
        **dict.fromkeys(("ux", "uy", "uz"), 120),
        **dict.fromkeys(("rx", "ry", "rz"), 80),
    }


def test_a_row_without_any_output_is_refused() -> None:
    with pytest.raises(RowError, match="row 1: no displacement is finite"):
        Rows.of(np.zeros(6), np.full(6, np.nan))
    with pytest.raises(RowError, match="uy must be finite"):
        Rows.of(np.zeros(6), [0, np.inf, 0, 0, 0, 0])


def test_whole_fields_are_told_by_the_kriging_of_whole_rows_though_others_lack_outputs() -> None:
    few = full_wrenches(24, 3)
    whole = Rows.of(few * HIGH, smooth(few), source=["fea"] * len(few))
    wrong = np.full((2, 6), np.nan)
    wrong[:, 2] = 1.2 * smooth(ASKED[:2])[:, 2]
    measured = Rows.of(ASKED[:2] * HIGH, wrong, source=["measured"] * 2)
    result = build(joined([whole, measured]), RANGE)
    assert result.rows.partial
    fullest, _ = result.groups
    assert len(fullest.rows) == len(whole)
    assert fullest.kriging is not None
