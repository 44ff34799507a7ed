import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import griddata

from surrogate.axes import AXES
from surrogate.rows import LoadRange, Rows
from surrogate.surrogate import Surrogate
from tests.surrogate.responses import HIGH, RANGE, clean_wrenches, full_wrenches, smooth, table


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
    return answer


def test_an_answer_equals_griddata_composed_by_hand() -> None:
    rows = table(smooth, clean_wrenches(200, 1))
    wrenches = full_wrenches(300, 2) * HIGH
    theirs = composed(rows, wrenches)  # no row at zero load: r(0) is zero
    answers = Surrogate.build(rows, RANGE).batch(wrenches)
    np.testing.assert_allclose(answers.displacement, theirs, rtol=0, atol=1e-12 * 1e-3)
    assert (answers.coverage == 0).all()


@settings(max_examples=25, deadline=None)
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
            terms = np.array([table_of[(axis.name, *p)] for p in x[:, list(axis.inputs)].tolist()])
            out[:, [axis.outputs[0], 3, 4, 5]] += terms[:, [axis.outputs[0], 3, 4, 5]]
        return out

    asked = steps[rng.integers(0, 4, (50, 6))]
    answers = Surrogate.build(table(response, scaled), RANGE).batch(asked * HIGH)
    np.testing.assert_allclose(answers.displacement, response(asked), rtol=0, atol=1e-9)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_affine_responses_are_exact_wherever_the_table_reaches(seed: int) -> None:
    rng = np.random.default_rng(seed)
    slope = rng.normal(size=(6, 6)) * ~np.array(
        [[o < 3 and w in AXES[o].others for w in range(6)] for o in range(6)]
    )
    scaled = np.concatenate((clean_wrenches(30, seed), np.zeros((1, 6))))
    offset = rng.normal(size=6)
    rows = table(lambda x: x @ slope.T + offset, scaled)
    asked = full_wrenches(40, seed + 1)
    answers = Surrogate.build(rows, RANGE).batch(asked * HIGH)
    np.testing.assert_allclose(answers.displacement, asked @ slope.T + offset, atol=1e-9)


def test_changing_the_units_changes_no_answer() -> None:
    scaled, asked = clean_wrenches(60, 3), full_wrenches(100, 4)
    plain = Surrogate.build(table(smooth, scaled), RANGE).batch(asked * HIGH)
    # pound-force and inch, millimetre and milliradian
    force, moment, length = 4.4482216152605, 0.1129848290276167, 1e3
    loads = np.repeat([1 / force, 1 / moment], 3)
    rows = Rows.of(scaled * HIGH * loads, smooth(scaled) * length)
    load_range = LoadRange(RANGE.low * loads, RANGE.high * loads)
    other = Surrogate.build(rows, load_range).batch(asked * HIGH * loads)
    np.testing.assert_allclose(other.displacement / length, plain.displacement, rtol=1e-9)
    np.testing.assert_allclose(other.error / length, plain.error, rtol=1e-9)


def test_no_load_answers_the_row_at_no_load_or_nothing_moved() -> None:
    scaled = clean_wrenches(20, 5)
    empty = Surrogate.build(table(smooth, scaled), RANGE).answer([0.0] * 6)
    assert empty.displacement == (0.0,) * 6
    assert empty.coverage == "covered"
    rows = table(lambda x: smooth(x) + 1e-3, np.concatenate((scaled, np.zeros((1, 6)))))
    assert Surrogate.build(rows, RANGE).answer([0.0] * 6).displacement == (1e-3,) * 6


def test_a_one_force_table_answers_that_force_and_no_other() -> None:
    force = np.linspace(-5000, 5000, 21)
    wrench = np.zeros((21, 6))
    wrench[:, 2] = force
    moved = np.outer(np.tanh(force / 3000), np.arange(1, 7)) * 1e-3
    surrogate = Surrogate.build(Rows.of(wrench, moved), RANGE)
    answer = surrogate.answer([0, 0, 1234.0, 0, 0, 0])
    assert answer.coverage == "covered"
    assert answer.displacement is not None
    for output in (2, 3, 4, 5):
        expected = np.interp(1234.0, force, moved[:, output])
        assert abs(answer.displacement[output] - expected) < 1e-15
    assert surrogate.answer([0, 0, 1234.0, 5.0, 0, 0]).coverage == "outside"


def test_a_scattered_two_load_table_reads_one_moment_alone_from_the_axis_that_has_it() -> None:
    rng = np.random.default_rng(6)
    scaled = np.zeros((80, 6))
    scaled[:, [2, 3]] = rng.uniform(-1, 1, (80, 2))  # F_z and M_x: no row of axis y at all
    surrogate = Surrogate.build(table(smooth, scaled), RANGE)
    x = np.array([0, 0, 0.3, -0.4, 0, 0])
    answer = surrogate.answer((x * HIGH).tolist())
    assert answer.coverage == "covered"
    assert answer.displacement is not None
    own = griddata(scaled[:, [2, 3]], smooth(scaled), x[None, [2, 3]])[0]
    np.testing.assert_allclose(answer.displacement[2:], own[2:], rtol=0, atol=1e-15)
