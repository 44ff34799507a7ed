"""Tables as rigs and simulators really write them: grids, slivers, repeats, wild scales."""

from __future__ import annotations

import numpy as np
import pytest

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
