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
    coupled,
    full_wrenches,
    smooth,
    table,
)
from wrenchbook.surrogate.axes.triangulation import Triangulation
from wrenchbook.surrogate.build import Group
from wrenchbook.surrogate.table.rows import LoadRange, Rows, Tolerance

GRID = np.array(np.meshgrid(*[np.linspace(-1, 1, 5)] * 3)).reshape(3, -1).T


def grid_table(points: np.ndarray = GRID) -> Rows:
    wrenches = np.zeros((3, len(points), 6))
    for axis, block in enumerate(wrenches):
        block[:, [axis, 3 + (axis + 1) % 3, 3 + (axis + 2) % 3]] = points
    return table(smooth, wrenches.reshape(-1, 6))


def same_as_one_by_one(surrogate: Group, asked: np.ndarray) -> None:
    batch = surrogate.batch(asked)
    for place, wrench in enumerate(asked.tolist()):
        answer = surrogate.answer(wrench)
        assert answer.coverage == ("covered", "thin", "outside")[batch.coverage[place]]
        blank = (np.nan,) * 6
        np.testing.assert_allclose(
            batch.displacement[place], answer.displacement or blank, rtol=1e-9, atol=1e-15
        )
        bars = np.array(answer.error or blank, dtype=float)
        np.testing.assert_allclose(batch.error[place], bars, rtol=1e-7, atol=1e-12)


def test_a_grid_is_triangulated_without_flat_simplices() -> None:
    shape = Triangulation(GRID)
    assert not shape.degenerate.any()
    assert shape.volumes.sum() == pytest.approx(8.0)
    assert (shape.locate(GRID) >= 0).all()


def test_an_affine_response_on_a_grid_is_exact() -> None:
    shape = Triangulation(GRID)
    x = np.random.default_rng(1).uniform(-1, 1, (2000, 3))
    x[::2] = np.round(x[::2] * 2) / 2  # half of them on the grid's own planes and corners
    found = shape.locate(x)
    told = np.einsum(
        "kd,kd->k", shape.barycentric(found, x), (GRID @ [1, -2, 3])[shape.simplices[found]]
    )
    np.testing.assert_allclose(told, x @ [1, -2, 3], atol=1e-12)


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


@pytest.mark.parametrize(
    "rows",
    [
        table(smooth, clean_wrenches(25, 1)),
        table(coupled, np.concatenate((clean_wrenches(25, 1), full_wrenches(30, 2)))),
        table(smooth, clean_wrenches(3, 1)),
        table(smooth, clean_wrenches(60, 1)[:60] * [1, 0, 0, 0, 1, 0]),
        table(smooth, np.eye(6)[[4]]),
        table(smooth, full_wrenches(4, 1)),
        grid_table().take(np.arange(125)),
        Rows.empty(),
    ],
    ids=["axes", "full", "few", "plane", "single", "four full", "grid", "none"],
)
@pytest.mark.parametrize("method", [None, "linear", "additive"])
def test_a_batch_says_what_single_answers_say_outside_too(rows: Rows, method: str | None) -> None:
    surrogate = build(rows, RANGE, linear=method == "linear")
    rng = np.random.default_rng(5)
    asked = full_wrenches(60, 5) * 1.3
    asked[rng.uniform(size=asked.shape) < 0.4] = 0
    same_as_one_by_one(surrogate, np.concatenate((asked * HIGH, rows.wrench[:5])))


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


def test_points_on_the_hull_are_inside() -> None:
    rng = np.random.default_rng(8)
    surrogate = build(table(smooth, clean_wrenches(60, 1)), RANGE)
    face = rng.uniform(-1, 1, (200, 6))
    face[np.arange(200), rng.integers(0, 6, 200)] = 1.0
    assert (surrogate.batch(face * HIGH).coverage != 2).all()
