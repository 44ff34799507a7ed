import numpy as np
import pytest
from hypothesis import given
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
from wrenchbook.surrogate.axes.triangulation import Triangulation
from wrenchbook.surrogate.table.rows import LoadRange, Rows, Tolerance


def interpolate(points: np.ndarray, values: np.ndarray, x: np.ndarray) -> np.ndarray:
    shape = Triangulation(points)
    result = shape.locate(x)
    weights = shape.barycentric(np.maximum(result, 0), x)
    answer = np.einsum("ki,ki->k", weights, values[shape.simplices[np.maximum(result, 0)]])
    return np.where(result < 0, np.nan, answer)


def test_it_equals_griddata_in_three_dimensions() -> None:
    rng = np.random.default_rng(1)
    points, values = rng.uniform(-1, 1, (500, 3)), rng.normal(size=500)
    x = rng.uniform(-1, 1, (3000, 3))
    theirs = griddata(points, values, x, rescale=False)
    np.testing.assert_allclose(interpolate(points, values, x), theirs, rtol=0, atol=1e-12)
    assert 0.5 < np.isfinite(theirs).mean() < 1


@pytest.mark.parametrize("flat", [0, 1, 2])
def test_a_planar_table_equals_griddata_in_its_plane(flat: int) -> None:
    rng = np.random.default_rng(2)
    plane = rng.uniform(-1, 1, (200, 2))
    values, x = rng.normal(size=200), rng.uniform(-0.8, 0.8, (500, 2))
    ours = interpolate(np.insert(plane, flat, 0.3, axis=1), values, np.insert(x, flat, 0.3, axis=1))
    np.testing.assert_allclose(ours, griddata(plane, values, x), rtol=0, atol=1e-12)


def test_a_one_force_table_is_linear_interpolation() -> None:
    rng = np.random.default_rng(3)
    along, values = rng.uniform(-1, 1, 40), rng.normal(size=40)
    x = np.linspace(along.min(), along.max(), 99)
    line = np.array([0.6, 0.0, 0.8])
    ours = interpolate(along[:, None] * line, values, x[:, None] * line)
    order = np.argsort(along)
    np.testing.assert_allclose(ours, np.interp(x, along[order], values[order]), rtol=0, atol=1e-12)


def test_a_slanted_plane_is_two_dimensional_and_empty_beside_itself() -> None:
    rng = np.random.default_rng(4)
    points = rng.uniform(-1, 1, (60, 3))
    points[:, 2] = 0.4 * points[:, 0] - 0.7 * points[:, 1]
    shape = Triangulation(points)
    middle = points.mean(axis=0)
    assert shape.dimension == 2
    assert shape.locate(np.array([middle, middle + np.array([0, 0, 1e-3])])).tolist()[1] == -1
    assert shape.locate(middle[None])[0] >= 0


def test_a_single_point_answers_itself_only() -> None:
    shape = Triangulation([[0.1, 0.2, 0.3]])
    assert shape.dimension == 0
    assert shape.locate([[0.1, 0.2, 0.3], [0.1, 0.2, 0.4]]).tolist() == [0, -1]


def test_points_on_the_hull_of_a_grid_are_inside() -> None:
    steps = np.linspace(-1, 1, 5) * 0.7
    grid = np.array(np.meshgrid(steps, steps, steps)).reshape(3, -1).T
    rng = np.random.default_rng(5)
    faces = rng.uniform(-0.7, 0.7, (3000, 3))
    faces[np.arange(3000), rng.integers(0, 3, 3000)] = rng.choice([-0.7, 0.7], 3000)
    shape = Triangulation(grid)
    assert (shape.locate(faces) >= 0).all()
    assert (shape.locate(grid) >= 0).all()
    assert (shape.locate(faces * 1.001) < 0).all()


def test_a_grid_with_its_cospherical_cells_reproduces_an_affine_function() -> None:
    steps = np.linspace(-1, 1, 4)
    grid = np.array(np.meshgrid(steps, steps, steps)).reshape(3, -1).T
    x = np.random.default_rng(6).uniform(-1, 1, (500, 3))
    slope = np.array([1.0, -2.0, 0.5])
    np.testing.assert_allclose(interpolate(grid, grid @ slope + 3, x), x @ slope + 3, atol=1e-12)


def test_inputs_over_twelve_orders_of_magnitude_do_not_break_it() -> None:
    rng = np.random.default_rng(7)
    points = rng.choice([-1.0, 1.0], (300, 3)) * 10 ** rng.uniform(-12, 0, (300, 3))
    shape = Triangulation(points)
    result = shape.locate(points * 0.999)
    assert (result >= 0).mean() > 0.99
    weights = shape.barycentric(np.maximum(result, 0), points * 0.999)
    assert np.isfinite(weights).all()


def test_almost_flat_points_fall_back_to_fewer_dimensions() -> None:
    rng = np.random.default_rng(8)
    points = rng.uniform(-1, 1, (30, 3))
    points[:, 2] *= 1e-13
    assert Triangulation(points).dimension == 2
    points[:, 1] *= 1e-13
    assert Triangulation(points).dimension == 1


@given(st.integers(0, 2**32 - 1), st.integers(1, 3), st.floats(1e-3, 1e3))
def test_affine_functions_are_exact_in_all_dimensions_and_at_any_scaling(
    seed: int, dimension: int, scaling: float
) -> None:
    rng = np.random.default_rng(seed)
    directions = np.linalg.qr(rng.normal(size=(3, 3)))[0][:dimension]
    points = scaling * rng.uniform(-1, 1, (20, dimension)) @ directions
    x = rng.dirichlet(np.ones(20), 10) @ points
    slope = rng.normal(size=3)
    ours = interpolate(points, points @ slope + 1, x)
    # An extremely thin simplex has large barycentric maps; rounding grows with them.
    np.testing.assert_allclose(ours, x @ slope + 1, atol=1e-9 * max(1.0, scaling))


GRID = np.array(np.meshgrid(*[np.linspace(-1, 1, 5)] * 3)).reshape(3, -1).T


def grid_table(points: np.ndarray = GRID) -> Rows:
    wrenches = np.zeros((3, len(points), 6))
    for axis, block in enumerate(wrenches):
        block[:, [axis, 3 + (axis + 1) % 3, 3 + (axis + 2) % 3]] = points
    return table(smooth, wrenches.reshape(-1, 6))


def test_a_grid_is_triangulated_without_flat_simplices() -> None:
    shape = Triangulation(GRID)
    assert not shape.degenerate.any()
    assert shape.volumes.sum() == pytest.approx(8.0)
    assert (shape.locate(GRID) >= 0).all()


def test_answers_on_a_grids_planes_do_not_jump() -> None:
    axes = axes_of(grid_table())
    plane = full_wrenches(300, 4) * 0.9
    plane[:, 0] = 0.5  # a plane of the grid
    near = plane.copy()
    near[:, 0] += 1e-9
    on, beside = (axes.by_method(x * HIGH) for x in (plane, near))
    assert (on.coverage == beside.coverage).all()
    assert (on.coverage < 2).all()
    np.testing.assert_allclose(on.displacement, beside.displacement, atol=1e-11)


def test_slivers_on_the_hull_do_not_blow_up_the_bar() -> None:
    rng = np.random.default_rng(2)
    wrenches = clean_wrenches(60, 3)
    wrenches[8:60, [0, 4, 5]] = rng.uniform(-1, 1, (52, 3))
    wrenches[8:30, 0] = 1 - rng.uniform(0, 1e-7, 22)  # almost on the hull's face
    surrogate = build(table(smooth, wrenches), RANGE, tolerance=Tolerance(1.0, 1.0))
    asked = np.zeros((500, 6))
    asked[:, [0, 4, 5]] = rng.uniform(-1, 1, (500, 3))
    asked[:, 0] = 1 - rng.uniform(0, 2e-7, 500)
    batch = surrogate.batch(asked * HIGH)
    truth = smooth(asked)
    assert np.isfinite(batch.error[batch.coverage == 0]).all()
    assert batch.error[batch.coverage == 0, 0].max() < 10 * np.ptp(truth[:, 0])
    wrong = np.abs(batch.displacement - truth)[:, 0] > batch.error[:, 0]
    assert wrong[batch.coverage == 0].mean() < 0.1


@pytest.mark.exact(
    "of corners on one sphere several triangulations are Delaunay's: rounding chooses"
)
@pytest.mark.parametrize("factor", [1e-12, 1e-6, 1.0, 1e6])
def test_inputs_of_any_size_give_the_same_answers(factor: float) -> None:
    scaled = clean_wrenches(20, 6)
    sizes = factor * np.array([1.0, 1e3, 1e6, 1e-6, 1.0, 1e6])
    rows = Rows.of(scaled * sizes, smooth(scaled))
    surrogate = build(rows, LoadRange(-sizes, sizes))
    plain = build(table(smooth, scaled), RANGE)
    asked = full_wrenches(100, 7) * 0.8
    np.testing.assert_allclose(
        surrogate.batch(asked * sizes).displacement,
        plain.batch(asked * HIGH).displacement,
        rtol=1e-6,
        atol=1e-12,
    )


@given(st.integers(0, 2**32 - 1))
def test_the_points_of_a_grid_that_rounding_moved_are_inside(seed: int) -> None:
    rng = np.random.default_rng(seed)
    ends = [np.linspace(-1, 1, rng.integers(2, 5)) for _ in range(3)]
    grid = np.array(np.meshgrid(*ends)).reshape(3, -1).T
    grid = np.nextafter(grid, rng.choice([-2.0, 0.0, 2.0], grid.shape))
    assert (Triangulation(grid).locate(grid) >= 0).all()


@pytest.mark.parametrize("rounded", [1e-12, 1e-10, 1e-8])
def test_points_of_a_rounded_grid_are_compared_with_few_simplices(
    rounded: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Beside flat simplices with all: rows of six loads beside such a grid took some minutes."""
    rng = np.random.default_rng(9)
    levels = np.linspace(-1, 1, 12)
    grid = np.array(np.meshgrid(levels, levels, levels)).reshape(3, -1).T
    shape = Triangulation(grid + rounded * rng.normal(size=grid.shape))
    assert shape.degenerate.any()
    on_planes, anywhere = levels[rng.integers(1, 11, (300, 3))], rng.uniform(-1.2, 1.2, (300, 3))
    asked = np.concatenate((on_planes, np.where(np.arange(3) == 1, on_planes, anywhere), anywhere))
    compared, barycentric = [], Triangulation.barycentric

    def counted(self: Triangulation, simplices: np.ndarray, x: np.ndarray) -> np.ndarray:
        compared.append(len(simplices))
        return barycentric(self, simplices, x)

    monkeypatch.setattr(Triangulation, "barycentric", counted)
    result = shape.locate(asked)
    assert sum(compared) < 50 * len(asked)
    every = np.flatnonzero(~shape.degenerate)
    for simplex, point in zip(result.tolist(), asked, strict=True):
        weights = shape.barycentric(every, np.broadcast_to(point, (len(every), 3))).min(axis=1)
        assert (simplex >= 0) == (weights.max() >= -1e-9)
        assert simplex < 0 or weights[every == simplex] >= -1e-9  # and it is not flat
