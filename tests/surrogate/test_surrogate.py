import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from tests.surrogate.law import build
from tests.surrogate.responses import (
    HIGH,
    RANGE,
    clean_wrenches,
    full_wrenches,
    smooth,
    table,
)
from wrenchbook.surrogate.answer import METHODS
from wrenchbook.surrogate.table.compliance import fit_compliance
from wrenchbook.surrogate.table.rows import LoadRange, Rows, Tolerance

COMPLIANCE = np.diag([1e-8, 2e-8, 3e-8, 1e-7, 2e-7, 3e-7])


@settings(max_examples=6)
@given(st.integers(0, 2**32 - 1))
@example(1)  # whose corners look like a loop to a polynomial
def test_a_clean_row_returns_itself(seed: int) -> None:
    def own(x: np.ndarray) -> np.ndarray:  # nothing moves across axes
        return smooth(x)

    rows = table(own, np.concatenate((clean_wrenches(12, seed), np.zeros((1, 6)))))
    surrogate = build(rows, RANGE)
    for row in (3, 22, 34):
        axis = row // 12
        result = surrogate.explain(rows.wrench[row].tolist())[axis]["outputs"]
        outputs = [axis, 3, 4, 5]
        expected = rows.displacement[row, outputs]
        np.testing.assert_allclose(list(result.values()), expected, rtol=0, atol=1e-12)


def test_linear_components_answer_by_their_stored_compliance_in_the_whole_range() -> None:
    wrench = np.array([[10.0, 0, 0, 0, 0, 0]])
    rows = Rows.of(wrench, wrench @ COMPLIANCE, compliance=COMPLIANCE[None], source=["fea"])
    surrogate = build(rows, RANGE, linear=True)
    asked = [900.0, -900.0, 4000.0, 400.0, 300.0, -100.0]
    answer = surrogate.answer(asked)
    assert (answer.coverage, answer.method) == ("covered", "linear")
    assert answer.error is not None  # of rounding size, and never nothing
    assert all(0 < bar < 1e-9 for bar in answer.error)
    np.testing.assert_allclose(answer.displacement, COMPLIANCE @ asked, rtol=1e-14)
    beyond = surrogate.answer([1001.0, 0, 0, 0, 0, 0])
    assert beyond.coverage == "outside"
    assert beyond.reason == "fx = 1001 N is outside the load range, -1000..1000 N"
    assert surrogate.answer(asked, method="griddata").coverage == "outside"


def test_six_independent_rows_of_a_linear_component_tell_its_compliance() -> None:
    wrench = np.diag(HIGH)
    surrogate = build(Rows.of(wrench, wrench @ COMPLIANCE), RANGE, linear=True)
    answer = surrogate.answer([10.0, 20, 30, 4, 5, 6], Tolerance(1.0, 1.0))
    assert (answer.coverage, answer.method) == ("covered", "linear")
    np.testing.assert_allclose(answer.displacement, COMPLIANCE @ [10, 20, 30, 4, 5, 6], rtol=1e-12)
    assert min(answer.error or ()) > 0  # measured once each, of unknown accuracy
    few = build(Rows.of(wrench[:5], wrench[:5] @ COMPLIANCE), RANGE, linear=True)
    assert few.default == "additive"


def test_the_bar_of_a_fitted_compliance_holds_its_residual() -> None:
    rng = np.random.default_rng(1)
    wrench = full_wrenches(200, 1) * HIGH
    noise = 1e-6 * rng.normal(size=(200, 6))
    surrogate = build(Rows.of(wrench, wrench @ COMPLIANCE + noise), RANGE, linear=True)
    answer = surrogate.answer([10.0, 20, 30, 4, 5, 6])
    assert answer.method == "linear"
    assert 1.5e-6 < min(answer.error or ()) < 3e-6


@pytest.mark.parametrize("count", [7, 8, 12, 36])
def test_the_bar_of_a_fitted_compliance_holds_at_full_loads_with_few_readings(count) -> None:
    rng = np.random.default_rng(20260)
    held = []
    for _ in range(200):
        wrench = rng.uniform(-1.0, 1.0, (count, 6)) * HIGH
        moved = wrench @ COMPLIANCE + 1e-6 * rng.normal(size=(count, 6))
        fit = fit_compliance(Rows.of(wrench, moved, source=["rig"] * count), RANGE, linear=True)
        full = rng.choice([-1.0, 1.0], (50, 6)) * HIGH
        held.append(np.abs(full @ (fit.matrix.T - COMPLIANCE)) <= fit.error)
    assert np.mean(held) >= 0.95


def test_the_linear_method_can_be_asked_of_any_table_and_says_what_no_row_tells() -> None:
    rows = table(smooth, clean_wrenches(20, 1)[:20])
    answer = build(rows, RANGE).answer([0, 5.0, 0, 0, 0, 0], method="linear")
    assert answer.coverage == "outside"
    assert answer.reason == "no row shows the influence of fy; solve or import one"
    assert answer.error is None


def test_an_unknown_method_is_refused_with_the_ones_there_are() -> None:
    surrogate = build(table(smooth, clean_wrenches(20, 1)), RANGE)
    with pytest.raises(ValueError, match=", ".join(METHODS)):
        surrogate.answer([1.0] * 6, None, "spline")
    with pytest.raises(ValueError, match="unknown method 'spline'"):
        surrogate.batch(np.ones((1, 6)), method="spline")


@pytest.mark.parametrize("repeat", [1, 2, 5])
def test_duplicates_grids_lines_and_single_rows_all_build(repeat: int) -> None:
    steps = np.linspace(-1, 1, 3)
    grid = np.zeros((27, 6))
    grid[:, [0, 4, 5]] = np.array(np.meshgrid(steps, steps, steps)).reshape(3, -1).T
    for scaled in (grid, grid[grid[:, 4] == 0], grid[9:10], np.zeros((1, 6)), np.eye(6)):
        rows = table(smooth, np.repeat(scaled, repeat, axis=0))
        surrogate = build(rows, RANGE)
        batch = surrogate.batch(full_wrenches(20, 1) * HIGH)
        assert np.isfinite(batch.displacement).all()
        inner = surrogate.answer((scaled[len(scaled) // 2] * HIGH).tolist())
        np.testing.assert_allclose(
            inner.displacement, rows.displacement[len(rows) // 2], rtol=0, atol=1e-15
        )


def test_inputs_over_twelve_orders_of_magnitude_answer_finite_numbers() -> None:
    rng = np.random.default_rng(1)
    scaled = clean_wrenches(80, 1)
    scaled *= 10 ** rng.uniform(-12, 0, scaled.shape)
    surrogate = build(table(smooth, scaled), RANGE)
    asked = full_wrenches(100, 2) * 10 ** rng.uniform(-12, 0, (100, 6))
    batch = surrogate.batch(asked * HIGH)
    assert np.isfinite(batch.displacement).all()
    # Most rows lie about zero: none is as far from the others as wrenches of the range are.
    unknown = np.isnan(batch.error).any(axis=1)
    assert not np.isinf(batch.error).any()
    assert (batch.coverage[unknown] != 0).all()


def test_a_linear_answer_is_explained_by_what_each_axis_contributes():
    matrix = np.diag(np.arange(1.0, 7.0)) * 1e-6
    matrix[1, 5] = matrix[5, 1] = 3e-7
    rows = Rows.of(np.zeros((1, 6)), np.zeros((1, 6)), compliance=matrix[None])
    table = build(rows, LoadRange(np.full(6, -9.0), np.full(6, 9.0)), linear=True)
    wrench = [1.0, 2.0, 3.0, 0.0, 0.0, 4.0]
    axes = table.explain(wrench)
    reported = table.answer(wrench).displacement
    assert [axis["outputs"][f"u{axis['axis']}"] for axis in axes] == pytest.approx(reported[:3])
    assert {axis["coverage"] for axis in axes} == {"covered"}
    assert all(axis["rows"] for axis in axes)
