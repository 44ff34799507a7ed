"""Weights of rows for whole fields."""

import numpy as np
import pytest

from wrenchbook.surrogate.field_weights import FieldWeights, nearest_rows
from wrenchbook.surrogate.kriging import Kriging
from wrenchbook.surrogate.table.rows import LoadRange, Rows

RANGE = LoadRange(np.array([-100.0, -50, 0, -5, -5, -2]), np.array([100.0, 50, 400, 5, 5, 2]))


def wrenches(count, seed=1):
    return np.random.default_rng(seed).uniform(RANGE.low, RANGE.high, (count, 6))


def bent(asked):
    """A response of six outputs, (n, 6), and its slopes, (n, 6, 6)."""
    x = asked / RANGE.scale
    mix = np.arange(36.0).reshape(6, 6) / 36 - 0.4
    slopes = mix + np.eye(6)
    inner = x @ slopes.T
    value = inner + 0.05 * inner**2
    return value, (1 + 0.1 * inner)[:, :, None] * slopes / RANGE.scale


def applied(result, values, slopes):
    """Return the weighted sum of values (k, d) and slopes (k, d, 6)."""
    weights, _ = result
    return weights[:, 0] @ values + np.einsum("kl,kdl->d", weights[:, 1:], slopes)


def test_they_give_the_answer_of_the_tables_kriging():
    asked = wrenches(30)
    value, slopes = bent(asked)
    rows = Rows.of(asked, 1e-3 * value, compliance=1e-3 * slopes)
    kriging = Kriging.build(rows, RANGE)
    weights = FieldWeights.of(asked, RANGE, kriging.hyperparameters)
    for wrench in wrenches(5, seed=2):
        reported = applied(weights.at(wrench), 1e-3 * value, 1e-3 * slopes)
        (expected,), _ = kriging.answer_many(wrench[None])
        np.testing.assert_allclose(reported, expected, atol=1e-6 * np.abs(expected).max())


def test_what_is_linear_in_the_wrench_comes_out_exactly():
    asked, matrix = wrenches(12), np.random.default_rng(5).standard_normal((9, 6))
    weights = FieldWeights.of(asked, RANGE)
    slopes = np.broadcast_to(matrix, (12, 9, 6))
    for wrench in wrenches(4, seed=3):
        reported = applied(weights.at(wrench), 2.0 + asked @ matrix.T, slopes)
        np.testing.assert_allclose(reported, 2.0 + matrix @ wrench, rtol=1e-4)


def test_at_a_row_the_row_answers():
    asked = wrenches(12)
    value, slopes = bent(asked)
    weights = FieldWeights.of(asked, RANGE)
    result = weights.at(asked[3])
    np.testing.assert_allclose(applied(result, value, slopes), value[3], atol=1e-7)
    assert result[1] < 1e-4 < weights.at(wrenches(1, seed=9)[0])[1]


def test_rows_left_out_err_as_a_table_without_them_does():
    asked = wrenches(8)
    value, slopes = bent(asked)
    weights = FieldWeights.of(asked, RANGE)
    columns = np.concatenate((value[:, None], slopes.transpose(0, 2, 1)), axis=1)
    errors, sigmas = weights.left_out(columns)
    for row in range(8):
        others = np.delete(np.arange(8), row)
        result = FieldWeights.of(asked[others], RANGE).at(asked[row])
        missed = value[row] - applied(result, value[others], slopes[others])
        np.testing.assert_allclose(errors[row], missed, atol=1e-6 * np.abs(value).max())
        assert sigmas[row] == pytest.approx(result[1], rel=1e-3)


def test_rows_left_out_have_deviations_without_any_field():
    weights = FieldWeights.of(wrenches(8), RANGE)
    errors, sigmas = weights.left_out(np.empty((8, 7, 0)))
    assert errors.shape == (8, 0)
    assert np.array_equal(sigmas, weights.left_out(np.zeros((8, 7, 1)))[1])


def test_one_row_is_led_by_its_slopes():
    asked = wrenches(1)
    value, slopes = bent(asked)
    step = 0.05 * RANGE.scale
    reported = applied(FieldWeights.of(asked, RANGE).at(asked[0] + step), value, slopes)
    np.testing.assert_allclose(reported, value[0] + slopes[0] @ step, rtol=1e-3)


def test_a_load_that_cannot_occur_takes_no_part():
    flat = LoadRange(np.append(RANGE.low[:5], 0.0), np.append(RANGE.high[:5], 0.0))
    asked = wrenches(6) * [1, 1, 1, 1, 1, 0]
    result, _ = FieldWeights.of(asked, flat).at(asked[0])
    assert (result[:, 6] == 0.0).all()
    assert np.isfinite(result).all()


def test_the_nearest_rows_are_told_in_shares_of_the_range():
    asked = np.zeros((3, 6))
    asked[0, 2], asked[1, 5], asked[2, 0] = 100.0, 1.5, 90.0
    assert nearest_rows(asked, np.zeros(6), RANGE, 2) == [0, 1]
