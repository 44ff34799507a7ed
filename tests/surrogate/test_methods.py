"""The methods besides griddata: what they are exact for, where they are better, what they say."""

import numpy as np
import pytest
from surrogate.spline import Spline

from surrogate.answer import COMPOSED
from surrogate.build import build
from surrogate.interpolation.delaunay import Triangulation
from surrogate.interpolation.slope_recovery import bend_of
from surrogate.table.rows import LoadRange, Rows
from tests.surrogate.calibrating import calibration, noisy, shipped, with_slopes
from tests.surrogate.responses import (
    HIGH,
    RANGE,
    clean_wrenches,
    full_wrenches,
    smooth,
)

PLATE = shipped("plate_thin", 80)
PLATE_TABLE = build(PLATE.rows, PLATE.load_range)


def test_half_the_vertices_first_order_expansions_reproduce_a_quadratic() -> None:
    rng = np.random.default_rng(1)
    points, bowl = rng.uniform(-1, 1, (40, 3)), rng.normal(size=(3, 3))
    bowl += bowl.T
    values = np.einsum("ni,ij,nj->n", points, bowl, points)[:, None]
    slopes = 2 * (points @ bowl)[:, None]
    shape = Triangulation(points)
    x = rng.dirichlet(np.ones(40), 100) @ points
    found = shape.locate(x)
    shares = shape.barycentric(found, x)
    plain = np.einsum("ki,kiq->kq", shares, values[shape.simplices[found]])
    bend = bend_of(shape, values, slopes, found, shares)
    true = np.einsum("ni,ij,nj->n", x, bowl, x)[:, None]
    assert np.abs(plain - true).max() > 0.05
    np.testing.assert_allclose(plain + bend, true, atol=1e-12)


def test_the_tangent_method_is_of_third_order() -> None:
    errors = []
    for per_axis in (250, 2000):  # half the distance between rows
        scaled = np.concatenate((clean_wrenches(per_axis, 3), np.zeros((1, 6))))
        rows = with_slopes(smooth, scaled)
        asked = full_wrenches(400, 4) * 0.7
        found = build(rows, RANGE).batch(asked * HIGH, None, "tangent")
        errors.append(np.median(np.abs(found.displacement - smooth(asked)), axis=0))
    assert (errors[0] / errors[1] > 5.5).all()  # 8 for third order, 4 for second


@pytest.mark.parametrize("order", [3, 5])
def test_a_spline_goes_through_its_values_and_slopes(order: int) -> None:
    rng = np.random.default_rng(2)
    points, values = rng.uniform(-1, 1, (30, 3)), rng.normal(size=(30, 2))
    slopes = rng.normal(size=(30, 2, 3))
    slopes[::3] = np.nan
    spline = Spline(points, values, slopes, order)
    np.testing.assert_allclose(spline.at(points), values, atol=1e-8)
    step = 1e-6 * np.array([0.0, 1.0, 0.0])
    slope = (spline.at(points + step) - spline.at(points - step)) / 2e-6
    known = np.isfinite(slopes[:, 0, 0])
    np.testing.assert_allclose(slope[known], slopes[known, :, 1], atol=1e-4)


def test_a_spline_knows_what_it_would_say_without_a_row() -> None:
    rng = np.random.default_rng(3)
    points, values = rng.uniform(-1, 1, (25, 3)), rng.normal(size=(25, 1))
    slopes = rng.normal(size=(25, 1, 3))
    whole = Spline(points, values, slopes, 5)
    for row in (0, 7, 24):
        rest = np.arange(25) != row
        without = Spline(points[rest], values[rest], slopes[rest], 5)
        left = values[row] - without.at(points[row : row + 1])[0]
        np.testing.assert_allclose(whole.left_out[row], left, rtol=1e-5)


@pytest.mark.parametrize("method", COMPOSED)
def test_a_batch_gives_the_numbers_of_single_answers(method: str) -> None:
    asked = PLATE.asked[:12]
    batch = PLATE_TABLE.batch(asked, None, method)
    for place, wrench in enumerate(asked.tolist()):
        one = PLATE_TABLE.answer(wrench, None, method)
        assert (one.coverage, one.method) == ("covered", method)
        np.testing.assert_allclose(batch.displacement[place], one.displacement, rtol=1e-9)
        np.testing.assert_allclose(batch.error[place], one.error, rtol=1e-9)


@pytest.mark.parametrize("method", COMPOSED)
def test_what_griddata_does_not_cover_no_method_covers(method: str) -> None:
    answer = PLATE_TABLE.answer([1200.0, 0, 0, 0, 0, 0], None, method)
    assert answer.coverage == "outside"
    assert answer.method == "estimate"


def test_full_wrenches_of_the_thin_plate_are_answered_far_better_with_the_correction() -> None:
    rms = {
        method: calibration(PLATE_TABLE, PLATE.asked, PLATE.true, method).rms
        for method in ("griddata", "rbf", "corrected", "auto")
    }
    assert (rms["corrected"] < 0.25 * rms["griddata"]).all()
    assert (rms["corrected"][:2] < 0.25 * rms["rbf"][:2]).all()  # u_x, u_y: load products
    assert rms["auto"].max() < 0.01


@pytest.mark.parametrize("method", ["tangent", "rbf", "corrected", "auto"])
def test_the_bars_of_the_methods_hold_on_the_thin_plate(method: str) -> None:
    assert calibration(PLATE_TABLE, PLATE.asked, PLATE.true, method).inside.min() >= 0.9


def test_auto_says_which_method_it_takes_and_why() -> None:
    choices = {choice.output: choice for choice in PLATE_TABLE.methods.choices}
    assert choices["ux"].method == "corrected"
    assert "by griddata on 80 full-wrench rows" in choices["ux"].why
    assert PLATE_TABLE.default == "griddata"


def test_auto_stays_with_griddata_where_nothing_is_clearly_better() -> None:
    choices = build(noisy(100, 1), RANGE).methods.choices
    assert {choice.method for choice in choices} == {"griddata"}
    assert "no method is clearly better" in choices[0].why


def test_full_wrenches_that_clean_rows_know_better_do_not_join_the_axes() -> None:
    """Their own nonlinear part would be counted by all three axes."""
    excluded = build(PLATE.rows, PLATE.load_range, off_axis="exclude")
    one, other = (s.batch(PLATE.asked) for s in (PLATE_TABLE, excluded))
    np.testing.assert_array_equal(one.displacement, other.displacement)


def test_full_wrenches_join_the_axes_where_the_response_is_linear() -> None:
    slope = np.diag([1e-8, 2e-8, 3e-8, 1e-7, 2e-7, 3e-7])
    scaled = np.concatenate((clean_wrenches(20, 1), full_wrenches(40, 2)))
    rows = Rows.of(scaled * HIGH, scaled * HIGH @ slope)
    surrogate = build(rows, LoadRange(-HIGH, HIGH))
    assert surrogate.composition.tables[0] is not None
    assert len(surrogate.composition.tables[0].rows.points) == 60


def test_points_in_a_plane_are_splined_in_their_plane() -> None:
    rng = np.random.default_rng(6)
    points = rng.uniform(-1, 1, (40, 2)) @ np.array([[1.0, 0.0, 0.5], [0.0, 1.0, -0.3]])
    values = (points @ np.array([1.0, -2.0, 3.0]))[:, None] + 0.5
    spline = Spline(points, values, np.full((40, 1, 3), np.nan), 3)
    np.testing.assert_allclose(
        spline.at(points[:10] * 0.4)[:, 0], (values[:10, 0] - 0.5) * 0.4 + 0.5
    )
