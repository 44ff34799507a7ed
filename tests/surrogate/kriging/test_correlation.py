"""The covariance of slopes and second derivatives is the derivative of that of values."""

import numpy as np
import pytest

from wrenchbook.surrogate.kriging.correlation import (
    Hyperparameters,
    block,
    covariance,
    derivative_count,
    derivatives,
    indices,
    joins,
    matern,
)
from wrenchbook.surrogate.table.space import DEFAULT

LOGARITHMS = np.array([-0.5, 0.3, -1.0, 0.2, -0.3, 0.6, -0.4])
HELD = Hyperparameters.of_logarithms(LOGARITHMS)
SMOOTH = Hyperparameters.of_logarithms(
    np.append(LOGARITHMS, [0.2, 0.5, -0.3]), DEFAULT.kriging_groups, 4
)
RNG = np.random.default_rng(3)
X, V = RNG.uniform(-1, 1, (4, 6)), RNG.uniform(-1, 1, (5, 6))
STEP = 1e-5


@pytest.mark.parametrize("smoothness", [3, 4])
@pytest.mark.parametrize("order", range(5))
def test_each_derivative_of_matern_is_that_of_the_one_before(order: int, smoothness: int) -> None:
    q = np.linspace(0.05, 6, 40)
    ends = (matern(q + way, 5, smoothness)[order] for way in (STEP, -STEP))
    difference = np.subtract(*ends) / (2 * STEP)
    result = matern(q, 5, smoothness)[order + 1]
    np.testing.assert_allclose(result, difference, rtol=1e-5)


def test_matern_7_2_is_its_closed_form() -> None:
    q = np.linspace(0.0, 6, 40)
    a = np.sqrt(7 * q)
    closed = (1 + a + 0.4 * a**2 + a**3 / 15) * np.exp(-a)
    np.testing.assert_allclose(matern(q)[0], closed, rtol=1e-14)


def test_the_value_is_one_where_places_coincide() -> None:
    value, first, second, third = matern(np.zeros(1))
    result = [value[0], first[0], second[0], third[0]]
    np.testing.assert_allclose(result, [1.0, -0.7, 49 / 60, -343 / 120], rtol=1e-15)


@pytest.mark.parametrize("held", [HELD, SMOOTH])
def test_readings_by_either_place_equal_differences(held: Hyperparameters) -> None:
    """Each slope is the derivative of values, each second derivative that of slopes."""
    whole = block(X, V, held, 28, 28)
    place = {index: number for number, index in enumerate(indices(6, 2))}
    for load, way in enumerate(STEP * np.eye(6)):
        by_x = (block(X + way, V, held, 7, 28) - block(X - way, V, held, 7, 28)) / (2 * STEP)
        by_v = (block(X, V + way, held, 28, 7) - block(X, V - way, held, 28, 7)) / (2 * STEP)
        for index in indices(6, 1):
            to = place[tuple(sorted((*index, load)))]
            np.testing.assert_allclose(whole[:, to], by_x[:, place[index]], atol=1e-7)
            np.testing.assert_allclose(whole[..., to], by_v[..., place[index]], atol=1e-7)


@pytest.mark.parametrize("held", [HELD, SMOOTH])
def test_the_prior_is_the_variance_of_a_rows_readings(held: Hyperparameters) -> None:
    own = block(X[:1], X[:1], held, 28, 28)[0, :, 0]
    np.testing.assert_allclose(np.diag(own), held.prior(28), rtol=1e-12)
    assert np.linalg.eigvalsh(own).min() > 0


def test_rows_with_and_without_derivatives_stand_row_by_row() -> None:
    known_x = np.ones((4, 28), dtype=bool)
    known_x[[0, 2], 7:] = False
    known_x[2, 1:] = False
    known_v = np.ones((5, 28), dtype=bool)
    known_v[1, 1:] = False
    known_v[3:, 4] = False
    whole = block(X, V, HELD, 28, 28).reshape(112, 140)
    picked = whole[np.ix_(known_x.ravel(), known_v.ravel())]
    np.testing.assert_allclose(covariance(X, known_x, V, known_v, HELD), picked, atol=1e-12)


def test_an_axis_without_shared_loads_adds_a_constant() -> None:
    """With no full kernel, moving along F_x changes what axis x adds, and nothing else."""
    held = Hyperparameters(HELD.inverse_squares, np.zeros(1))
    moved = X + np.eye(6)[0]
    apart = block(moved, V, held, 1, 1) - block(X, V, held, 1, 1)
    only_x = Hyperparameters(HELD.inverse_squares * [1, 0, 0, 0, 1, 1], np.zeros(1))
    expected = block(moved, V, only_x, 1, 1) - block(X, V, only_x, 1, 1)
    # axes y and z read M_x, M_y, M_z too: they do not change with F_x
    np.testing.assert_allclose(apart, expected, atol=1e-14)


def test_variances_of_the_prior_are_those_of_the_covariance() -> None:
    count = derivative_count(6, 2)
    joined, sign = joins(6, count, count)
    coincident = np.diag(derivatives(np.zeros((1, 6)), HELD, 4)[0][joined] * sign)
    np.testing.assert_allclose(HELD.prior(count)[:7], coincident[:7], rtol=1e-12)
