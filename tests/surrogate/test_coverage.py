import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.surrogate.calibrating import with_slopes
from tests.surrogate.law import build
from tests.surrogate.responses import HIGH, RANGE, clean_wrenches, full_wrenches, smooth, table
from wrenchbook.surrogate.kernel.reasons import UNKNOWN_ERROR
from wrenchbook.surrogate.table.rows import LoadRange, Rows, Tolerance

# Twenty full wrenches: rows of one axis alone show nothing of what axes do together.
ROWS = with_slopes(smooth, np.concatenate((clean_wrenches(60, 1), full_wrenches(20, 1))))
FULL = build(ROWS, RANGE)


def test_inside_the_rows_is_covered_without_a_word() -> None:
    wrench = [100.0, -200.0, 300.0, 40.0, 50.0, -60.0]
    answer = FULL.answer(wrench, Tolerance(1e-3, 1e-2), method="griddata")
    assert (answer.coverage, answer.reason, answer.method) == ("covered", "", "griddata")


def test_beyond_the_rows_is_outside_and_says_which_load_of_which_axis() -> None:
    answer = FULL.answer([1200.0, 0, 0, 0, 0, 0], method="griddata")
    assert answer.coverage == "outside"
    assert answer.method == "griddata"
    assert answer.reason == "axis x: fx = 1200 N lies outside the rows, which span -1000..1000 N"
    assert answer.displacement is not None
    assert answer.error is None  # no row tells it out there


def test_in_the_span_but_beyond_the_hull_says_so() -> None:
    scaled = np.zeros((40, 6))
    scaled[:, [0, 4, 5]] = np.random.default_rng(1).dirichlet(np.ones(4), 40)[:, :3]
    surrogate = build(table(smooth, scaled), RANGE)
    answer = surrogate.answer([500.0, 0, 0, 0, 300.0, 120.0], method="griddata")
    assert answer.coverage == "outside"
    assert "axis x: fx = 500 N, my = 300 N·m, mz = 120 N·m together lie outside" in answer.reason


def test_a_load_that_no_row_varies_is_outside_and_says_what_the_rows_hold() -> None:
    wrench = np.zeros((9, 6))
    wrench[:, 0] = np.linspace(-1000, 1000, 9)
    surrogate = build(Rows.of(wrench, wrench * 1e-8), RANGE)
    assert surrogate.answer([10.0, 0, 0, 0, 3.0, 0], method="griddata").reason.startswith(
        "axis x: my = 3 N·m: the rows with fx, my, mz alone all hold my = 0 N·m"
    )
    assert (
        "axis y: fy = 5 N: the rows with fy, mz, mx alone all hold fy = 0 N"
        in surrogate.answer([0, 5.0, 0, 0, 0, 0], method="griddata").reason
    )
    by_default = surrogate.answer([10.0, 0, 0, 0, 3.0, 0])
    assert by_default.coverage == "outside"
    assert by_default.reason == "no row shows the influence of my; solve or import one"


def test_an_empty_table_knows_nothing_and_says_so() -> None:
    surrogate = build(Rows.empty(), RANGE)
    answer = surrogate.answer([1.0, 0, 0, 0, 0, 0])
    assert answer == (None, None, "outside", "the table has no rows", "estimate", ())
    assert surrogate.batch(np.ones((2, 6))).coverage.tolist() == [2, 2]
    assert surrogate.explain([1.0] * 6) == []


def test_too_few_rows_are_thin() -> None:
    wrench = np.zeros((3, 6))
    wrench[:, 2] = [-5000, 0, 5000]
    answer = build(Rows.of(wrench, wrench * 1e-8), RANGE).answer([0, 0, 7.0, 0, 0, 0])
    assert (answer.coverage, answer.reason) == ("thin", UNKNOWN_ERROR)
    assert answer.displacement is not None
    assert answer.displacement[2] == pytest.approx(7e-8)


def test_rows_far_apart_are_thin() -> None:
    wrench = np.zeros((8, 6))
    wrench[:, 2] = [-5000, -4900, -4800, -4700, -4600, -4500, -4400, 5000]
    moved = np.tanh(wrench / 2000) * 1e-3
    answer = build(Rows.of(wrench, moved), RANGE).answer([0, 0, 7.0, 0, 0, 0])
    assert (answer.coverage, answer.error) == ("thin", None)


def test_an_error_bar_over_the_tolerance_is_thin_and_names_the_output() -> None:
    wrench = [100.0, -200.0, 300.0, 40.0, 50.0, -60.0]
    error = FULL.answer(wrench).error
    assert error is not None
    strict = FULL.answer(wrench, Tolerance(1.0, max(error[3:]) * 0.99))
    assert strict.coverage == "thin"
    assert strict.method == FULL.default == "kriging"
    assert "rad, is over the tolerance" in strict.reason
    assert FULL.answer(wrench, Tolerance(1.0, max(error[3:]) * 1.01)).coverage == "covered"


def test_the_surrogates_own_tolerance_holds_unless_another_is_asked_for() -> None:
    surrogate = build(ROWS, RANGE, tolerance=Tolerance(1e-12, 1e-12))
    wrench = [100.0, -200.0, 300.0, 40.0, 50.0, -60.0]
    assert surrogate.answer(wrench).coverage == "thin"
    assert surrogate.answer(wrench, Tolerance(1, 1)).coverage == "covered"


def test_a_row_of_just_this_wrench_is_covered_where_the_table_is_not() -> None:
    wrench = np.array([[100.0, 20, 30, 4, 5, 6]])
    doubt = np.full((1, 6), 1e-9)
    rows = Rows.of(wrench, wrench * 1e-8, uncertainty=doubt)
    surrogate = build(rows, RANGE)
    answer = surrogate.answer(rows.wrench[0].tolist())
    assert answer.coverage == "covered"
    assert answer.method == "row"
    assert answer.displacement == tuple(rows.displacement[0].tolist())
    assert answer.error == tuple(rows.uncertainty[0].tolist())
    assert surrogate.batch(wrench).coverage.tolist() == [0]
    assert surrogate.answer([100.0, 20, 30, 4, 5, 7]).coverage == "outside"


def test_points_on_the_hull_are_inside() -> None:
    steps = np.linspace(-1, 1, 4)
    scaled = np.zeros((64, 6))
    scaled[:, [2, 3, 4]] = np.array(np.meshgrid(steps, steps, steps)).reshape(3, -1).T
    high = HIGH * [1, 1, 0.3, 0.7, 1.1, 1]
    load_range = LoadRange(-high, high)
    rows = Rows.of(scaled * high, smooth(scaled))
    surrogate = build(rows, load_range, tolerance=Tolerance(1, 1))
    rng = np.random.default_rng(2)
    asked = np.zeros((500, 6))
    asked[:, 2] = rng.choice([-1, 1], 500)  # the moments alone lie inside
    asked[:, 4] = rng.uniform(-1, 1, 500)
    only = asked.copy()
    only[:, 4] = 0.0
    assert (surrogate.batch(only * high, None, "griddata").coverage < 2).all()
    states = {
        surrogate.explain(w, None, "griddata")[2]["coverage"] for w in (asked * high).tolist()
    }
    assert states == {"covered"}


@settings(max_examples=60)
@given(
    st.lists(st.floats(-3, 3, allow_subnormal=False), min_size=6, max_size=6),
    st.integers(0, 3),
)
def test_outside_is_never_covered_and_no_nan_ever_leaves(x: list[float], axis: int) -> None:
    wrench = np.array(x) * HIGH
    answer = FULL.answer(wrench.tolist())
    if (np.abs(x) > 1 + 1e-6).any():
        assert answer.coverage == "outside"
        assert answer.reason
    assert answer.displacement is not None
    assert np.isfinite(answer.displacement).all()
    assert answer.error is not None or answer.coverage != "covered"
    assert answer.error is None or np.isfinite(answer.error).all()


def test_detail_names_inputs_outputs_and_the_rows_used() -> None:
    detail = FULL.explain([100.0, 0, 300.0, 0, 50.0, 0])
    assert [axis["axis"] for axis in detail] == ["x", "y", "z"]
    assert detail[0]["inputs"] == {"fx": 100.0, "my": 50.0, "mz": 0.0}
    assert set(detail[2]["outputs"]) == {"uz", "rx", "ry", "rz"}
    assert len(detail[0]["rows"]) == 4
    assert set(detail[0]["rows"]) <= set(range(1, 61))
    assert set(detail[2]["rows"]) <= set(range(121, 181))
    assert detail[1]["rows"] == []
    assert {axis["coverage"] for axis in detail} == {"covered"}


def test_the_summary_is_plain_values() -> None:
    import json

    summary = json.loads(json.dumps(FULL.coverage_summary(), allow_nan=False))
    assert summary["rows"] == len(ROWS)
    assert [axis["dimensions"] for axis in summary["axes"]] == [3, 3, 3]
    assert summary["axes"][0]["spans"]["fx"] == pytest.approx([-1000, 1000], rel=1e-15)
    assert summary["axes"][0]["part_of_range"] == pytest.approx(1.0)
    assert json.dumps(build(Rows.empty(), RANGE).coverage_summary(), allow_nan=False)
