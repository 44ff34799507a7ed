"""The covariance of slopes is the derivative of that of values."""

import numpy as np
import pytest

from wrenchbook.surrogate.kriging.correlation import Hyperparameters, block, covariance, matern

HELD = Hyperparameters.of_logarithms(np.array([-0.5, 0.3, -1.0, 0.2, -0.3, 0.6, -0.4]))
RNG = np.random.default_rng(3)
X, V = RNG.uniform(-1, 1, (4, 6)), RNG.uniform(-1, 1, (5, 6))
STEP = 1e-5


@pytest.mark.parametrize("order", [0, 1, 2])
def test_each_derivative_of_matern_is_that_of_the_one_before(order: int) -> None:
    q = np.linspace(0.05, 6, 40)
    difference = (matern(q + STEP)[order] - matern(q - STEP)[order]) / (2 * STEP)
    np.testing.assert_allclose(matern(q)[order + 1], difference, rtol=1e-6)


def test_the_value_is_one_where_places_coincide() -> None:
    value, first, second, third = matern(np.zeros(1))
    assert [value[0], first[0], second[0], third[0]] == [1.0, -0.7, 49 / 60, -343 / 120]


@pytest.mark.parametrize("load", range(6))
def test_slopes_by_either_place_equal_differences(load: int) -> None:
    way = STEP * np.eye(6)[load]
    whole = block(X, V, HELD, slopes_x=True, slopes_v=True)
    by_x = block(X + way, V, HELD, False, True) - block(X - way, V, HELD, False, True)
    by_v = block(X, V + way, HELD, True, False) - block(X, V - way, HELD, True, False)
    np.testing.assert_allclose(whole[:, 1 + load], by_x[:, 0] / (2 * STEP), atol=2e-9)
    np.testing.assert_allclose(whole[..., 1 + load], by_v[..., 0] / (2 * STEP), atol=2e-9)


def test_the_prior_is_the_covariance_of_a_row_with_itself() -> None:
    own = block(X[:1], X[:1], HELD, slopes_x=True, slopes_v=True)[0, :, 0]
    np.testing.assert_allclose(own, np.diag(HELD.prior), atol=1e-15)


def test_rows_with_and_without_slopes_stand_row_by_row() -> None:
    known_x = np.ones((4, 7), dtype=bool)
    known_x[[0, 2], 1:] = False
    known_v = np.ones((5, 7), dtype=bool)
    known_v[1, 1:] = False
    known_v[3:, 4] = False
    whole = block(X, V, HELD, slopes_x=True, slopes_v=True).reshape(28, 35)
    picked = whole[np.ix_(known_x.ravel(), known_v.ravel())]
    np.testing.assert_allclose(covariance(X, known_x, V, known_v, HELD), picked, atol=1e-15)


def test_an_axis_without_shared_loads_adds_a_constant() -> None:
    """With no full kernel, moving along F_x changes what axis x adds, and nothing else."""
    held = Hyperparameters(HELD.inverse_squares, 0.0)
    moved = X + np.eye(6)[0]
    apart = block(moved, V, held, False, False) - block(X, V, held, False, False)
    only_x = Hyperparameters(HELD.inverse_squares * [1, 0, 0, 0, 1, 1], 0.0)
    expected = block(moved, V, only_x, False, False) - block(X, V, only_x, False, False)
    # axes y and z read M_x, M_y, M_z too: they do not change with F_x
    np.testing.assert_allclose(apart, expected, atol=1e-14)
