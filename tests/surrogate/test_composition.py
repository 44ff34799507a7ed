import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import griddata

from tests.surrogate.law import build
from tests.surrogate.responses import (
    HIGH,
    RANGE,
    axes_of,
    clean_wrenches,
    full_wrenches,
    smooth,
    table,
)
from wrenchbook.surrogate.table.axes import AXES
from wrenchbook.surrogate.table.rows import LoadRange, Rows, Tolerance


def rest(rows: Rows) -> np.ndarray:
    """Return what scipy's griddata interpolates at zero load, the mean of the axes."""
    told = []
    for axis in AXES:
        inputs = list(axis.inputs)
        clean = ~rows.wrench[:, axis.others].any(axis=1)
        points = rows.wrench[clean][:, inputs] / HIGH[inputs]
        told.append(griddata(points, rows.displacement[clean], np.zeros((1, 3)))[0])
    return np.mean(told, axis=0)


def composed(rows: Rows, wrenches: np.ndarray) -> np.ndarray:
    """Compose with scipy's griddata, as the definition reads."""

    def read(axis: int, x: np.ndarray) -> np.ndarray:
        inputs = list(AXES[axis].inputs)
        off = [load for load in range(6) if load not in inputs]
        clean = ~rows.wrench[:, off].any(axis=1)
        points = rows.wrench[clean][:, inputs] / HIGH[inputs]
        return griddata(points, rows.displacement[clean], x[:, inputs] / HIGH[inputs])

    answer = np.zeros_like(wrenches)
    for axis in range(3):
        own = read(axis, wrenches)
        alone = np.zeros_like(wrenches)
        alone[:, AXES[axis].inputs[1]] = wrenches[:, AXES[axis].inputs[1]]
        answer[:, axis] = own[:, axis]
        answer[:, 3:] += own[:, 3:] - read(axis, alone)[:, 3:]
    answer[:, 3:] += rest(rows)[3:]
    return answer


def test_an_answer_equals_griddata_composed_by_hand() -> None:
    rows = table(smooth, clean_wrenches(60, 1))
    wrenches = full_wrenches(300, 2) * HIGH
    theirs = composed(rows, wrenches)
    answers = build(rows, RANGE).batch(wrenches, method="griddata")
    np.testing.assert_allclose(answers.displacement, theirs, rtol=0, atol=1e-12 * 1e-3)
    assert (answers.coverage == 1).all()  # no full wrench tells what it leaves out


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1))
def test_composition_is_exact_for_sums_of_functions_of_the_triples_at_their_rows(seed: int) -> None:
    """Rows on a grid of each triple: every combination of three of them is answered exactly."""
    rng = np.random.default_rng(seed)
    steps = np.array([-1.0, 0.0, rng.uniform(0.2, 0.8), 1.0])
    grid = np.array(np.meshgrid(steps, steps, steps)).reshape(3, -1).T
    scaled = np.zeros((3, 64, 6))
    for axis, block in zip(AXES, scaled, strict=True):
        block[:, list(axis.inputs)] = grid
    scaled = np.unique(scaled.reshape(-1, 6), axis=0)
    table_of = {
        (axis.name, *point): rng.normal(size=6) for axis in AXES for point in map(tuple, grid)
    }

    def response(x: np.ndarray) -> np.ndarray:
        out = np.zeros((len(x), 6))
        for axis in AXES:
            terms = 1e-3 * np.array(
                [table_of[(axis.name, *p)] for p in x[:, list(axis.inputs)].tolist()]
            )
            out[:, [axis.outputs[0], 3, 4, 5]] += terms[:, [axis.outputs[0], 3, 4, 5]]
        return out

    asked = steps[rng.integers(0, 4, (50, 6))]
    answers = axes_of(table(response, scaled)).by_method(asked * HIGH)
    np.testing.assert_allclose(answers.displacement, response(asked), rtol=0, atol=1e-12)


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1))
def test_affine_responses_are_exact_wherever_the_table_reaches(seed: int) -> None:
    rng = np.random.default_rng(seed)
    slope = (
        1e-3
        * rng.normal(size=(6, 6))
        * ~np.array([[o < 3 and w in AXES[o].others for w in range(6)] for o in range(6)])
    )
    scaled = np.concatenate((clean_wrenches(30, seed), np.zeros((1, 6))))
    offset = 1e-3 * rng.normal(size=6)
    rows = table(lambda x: x @ slope.T + offset, scaled)
    asked = full_wrenches(40, seed + 1)
    answers = axes_of(rows).by_method(asked * HIGH)
    np.testing.assert_allclose(answers.displacement, asked @ slope.T + offset, atol=1e-12)


def test_no_load_answers_the_row_at_no_load_or_what_the_axes_interpolate_there() -> None:
    scaled = clean_wrenches(20, 5)
    rows = table(smooth, scaled)
    empty = build(rows, RANGE).answer([0.0] * 6, Tolerance(1.0, 1.0), "griddata")
    np.testing.assert_allclose(np.array(empty.displacement), rest(rows), rtol=0, atol=1e-15)
    assert empty.error is not None
    assert min(empty.error) > 0
    assert empty.coverage == "covered"
    rows = table(lambda x: smooth(x) + 1e-3, np.concatenate((scaled, np.zeros((1, 6)))))
    assert build(rows, RANGE).answer([0.0] * 6, method="griddata").displacement == tuple(
        rows.displacement[-1].tolist()
    )


@settings(max_examples=5)
@given(st.integers(0, 2**32 - 1))
def test_an_offset_without_a_row_at_zero_load_is_not_lost(seed: int) -> None:
    """Every rotation was off by r(0), and zero load answered 0 with a bar of 0."""
    rng = np.random.default_rng(seed)
    slope = (
        1e-2
        * rng.normal(size=(6, 6))
        * ~np.array([[o < 3 and w in AXES[o].others for w in range(6)] for o in range(6)])
    )
    offset = 1e-2 * rng.normal(size=6)

    def response(x: np.ndarray) -> np.ndarray:
        return x @ slope.T + offset

    scaled = np.concatenate((clean_wrenches(12, seed), full_wrenches(24, seed)))
    surrogate = build(table(response, scaled), RANGE, tolerance=Tolerance(10.0, 10.0))
    asked = np.concatenate((full_wrenches(40, seed + 1), np.zeros((1, 6)), np.eye(6) / 2))
    asked[::3, :3] = 0.0
    asked[1::4, 3] = 0.0
    answers = surrogate.batch(asked * HIGH)
    assert (answers.coverage < 2).all()
    error, variation = (
        np.abs(answers.displacement - response(asked)),
        np.ptp(response(asked), axis=0),
    )
    assert (error <= 1e-5 * variation).all()
    known = np.isfinite(answers.error)  # rows do not tell how far each wrench may be off
    assert known.mean() > 0.9
    assert (error <= answers.error)[known].mean() >= 0.95  # a bar holds so many
    assert (answers.error <= 1e-5 * variation)[known].all()
    for wrench, expected in zip(asked * HIGH, response(asked), strict=True):
        single = surrogate.answer(wrench.tolist())
        assert (np.abs(np.array(single.displacement) - expected) <= 1e-5 * variation).all()


def test_what_axes_of_other_loads_leave_out_is_in_the_error_bar() -> None:
    wrench = np.zeros((9, 6))
    wrench[:, 2] = np.linspace(1000, 5000, 9)
    surrogate = build(Rows.of(wrench, wrench[:, 2:3] * np.full(6, 1e-8)), RANGE)
    loaded = surrogate.answer([0.0, 0, 2100, 0, 0, 0], method="griddata")
    assert loaded.displacement is not None
    assert loaded.error is not None
    assert loaded.error[0] >= 2e-5
    assert loaded.displacement[3] == pytest.approx(2100 * 1e-8)


@settings(max_examples=10)
@given(st.integers(0, 2**32 - 1))
def test_the_composition_law_holds_with_an_offset_and_no_row_at_zero_load(seed: int) -> None:
    """Rows on each triple's grid without its middle: the law, from the same tables, is exact."""
    rng = np.random.default_rng(seed)
    # The eight corners lie on one sphere: which way their faces are parted would be arbitrary.
    scaled = clean_wrenches(60, seed) * rng.uniform(0.9, 1.0, (180, 6))
    rows = table(lambda x: smooth(x) + rng.normal(size=6) * 1e-3, scaled)
    asked = full_wrenches(30, seed) * 0.8
    asked[::2, 4] = 0.0
    asked[::3, 3] = 0.0
    axes = axes_of(rows)

    def told(kept: list[int]) -> np.ndarray:
        kept_loads = np.where(np.isin(np.arange(6), kept), asked, 0.0)
        return axes.by_method(kept_loads * HIGH, "additive")[0]

    zero = told([])
    parts = sum(_axis_read(rows, asked, axis) for axis in range(3))
    alone = sum(_axis_read(rows, asked, axis, alone=True) for axis in range(3))
    law = parts - alone + zero
    np.testing.assert_allclose(told([0, 1, 2, 3, 4, 5]), law, rtol=0, atol=1e-14)


def _axis_read(rows: Rows, asked: np.ndarray, axis: int, *, alone: bool = False) -> np.ndarray:
    """Return r_i, or r of its first moment alone, which without that moment is r(0)."""
    inputs, others = list(AXES[axis].inputs), AXES[axis].others
    clean = ~rows.wrench[:, others].any(axis=1)
    points = rows.wrench[clean][:, inputs] / HIGH[inputs]
    x = asked[:, inputs] * ([0.0, 1.0, 0.0] if alone else 1.0)
    read = griddata(points, rows.displacement[clean], x)
    return np.where(x.any(axis=1)[:, None], read, rest(rows))


def test_a_one_force_table_answers_that_force_and_no_other() -> None:
    force = np.linspace(-5000, 5000, 21)
    wrench = np.zeros((21, 6))
    wrench[:, 2] = force
    moved = np.outer(np.tanh(force / 3000), np.arange(1, 7)) * 1e-3
    surrogate = build(Rows.of(wrench, moved), RANGE, tolerance=Tolerance(1.0, 1.0))
    answer = surrogate.answer([0, 0, 1234.0, 0, 0, 0], method="griddata")
    assert answer.coverage == "covered"
    assert answer.displacement is not None
    for output in (2, 3, 4, 5):
        expected = np.interp(1234.0, force, moved[:, output])
        assert abs(answer.displacement[output] - expected) < 1e-15
    other = [0, 0, 1234.0, 5.0, 0, 0]
    assert surrogate.answer(other, method="griddata").coverage == "outside"
    assert surrogate.answer(other).coverage == "outside"


def test_a_scattered_two_load_table_reads_one_moment_alone_from_the_axis_that_has_it() -> None:
    rng = np.random.default_rng(6)
    scaled = np.zeros((80, 6))
    scaled[:, [2, 3]] = rng.uniform(-1, 1, (80, 2))  # F_z and M_x: no row of axis y at all
    surrogate = build(table(smooth, scaled), RANGE, tolerance=Tolerance(1.0, 1.0))
    x = np.array([0, 0, 0.3, -0.4, 0, 0])
    answer = surrogate.answer((x * HIGH).tolist(), method="griddata")
    assert answer.coverage == "covered"
    assert answer.displacement is not None
    own = griddata(scaled[:, [2, 3]], smooth(scaled), x[None, [2, 3]])[0]
    np.testing.assert_allclose(answer.displacement[2:], own[2:], rtol=0, atol=1e-15)


def test_a_batch_changes_no_answer_of_a_planar_table_off_its_plane():
    """A wrench within the plane but off the hull got the bar of one that leaves the plane."""
    places = np.array(list(np.ndindex(5, 5))) / 2 - 1
    wrenches = np.zeros((25, 6))
    wrenches[:, [2, 3]] = places * [100.0, 10.0]
    full = np.array([100.0] * 3 + [10.0] * 3)
    moved = 1e-4 * np.tanh(wrenches / full) + 2e-5 * np.roll(wrenches / full, 1, axis=1)
    table = build(Rows.of(wrenches, moved), LoadRange(-full, full))
    off_hull, off_plane = [0, 0, 110.0, 2.0, 0, 0], [0, 0, 50.0, 2.0, 3.0, 0]
    alone = table.batch([off_hull], method="griddata")
    both = table.batch([off_hull, off_plane], method="griddata")
    np.testing.assert_array_equal(both.error[0], alone.error[0])
