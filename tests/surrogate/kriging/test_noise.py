"""The noise of measured rows by restricted likelihood, and what it makes of error bars."""

from __future__ import annotations

import numpy as np
import pytest

from tests.surrogate.kriging.responses import RESPONSES, noisy_rows, solved
from tests.surrogate.kriging.test_likelihood import PLACE, ROUGH, SMOOTH, WRENCHES, differences
from tests.surrogate.responses import HIGH, RANGE, full_wrenches
from wrenchbook.surrogate.kriging import Kriging, noise
from wrenchbook.surrogate.kriging.correlation import Hyperparameters, covariance, mean_terms
from wrenchbook.surrogate.kriging.equations import (
    Equations,
    Scaling,
    equations_of,
    indices_within,
    scaling_of,
)
from wrenchbook.surrogate.kriging.factor import SingularCovarianceError
from wrenchbook.surrogate.kriging.settings import KrigingSettings
from wrenchbook.surrogate.table.merging import merge
from wrenchbook.surrogate.table.rows import Rows

REPEATED = np.concatenate((WRENCHES, WRENCHES[:5]))
TABLES = {
    "unknown": noisy_rows(SMOOTH, WRENCHES, 1, told=False),
    "repeated": noisy_rows(SMOOTH, REPEATED, 1, told=False),
    "stated": noisy_rows(SMOOTH, WRENCHES, 1, told=True),
    "beside solves": noisy_rows(SMOOTH, WRENCHES, 1, told=False)
    + solved(SMOOTH, full_wrenches(4, 3)),
}


def prepared(rows: Rows) -> tuple[Equations, Scaling]:
    inside, _, readings = merge(rows.take(indices_within(rows, RANGE)), RANGE).usable()
    scaling = scaling_of(inside, RANGE)
    return equations_of(inside, scaling, readings), scaling


def measured(
    name: str, x: np.ndarray, deviation: float, seed: int, stated: float = np.nan
) -> tuple[Rows, np.ndarray]:
    """Return rows with noise of each output's range, and the ranges, (6,), m and rad."""
    size = np.ptp(RESPONSES[name](full_wrenches(2000, 1)), axis=0)
    moved = RESPONSES[name](x)
    moved = moved + deviation * size * np.random.default_rng(seed).normal(size=moved.shape)
    half_width = np.tile(1.96 * stated * deviation * size, (len(x), 1))
    return Rows.of(x * HIGH, moved, uncertainty=half_width), size


@pytest.mark.parametrize("name", TABLES)
def test_the_gradient_equals_differences(name: str) -> None:
    groups = noise.noisy_rows(*prepared(TABLES[name]), ROUGH)
    _, gradient = noise.negative_log_posterior(PLACE, groups, ROUGH)
    result = differences(lambda x: noise.negative_log_posterior(x, groups, ROUGH)[0], PLACE)
    # Beside solves the mean's wide prior leaves a billionth of the likelihood's digits.
    assert gradient == pytest.approx(
        result, rel=1e-3 if name == "beside solves" else 1e-5, abs=1e-5
    )


def test_the_spectrum_gives_the_restricted_likelihood_of_every_noise() -> None:
    """By its formula: log det V + log det F' V^-1 F + (n - p) log of the generalised residual."""
    equations, scaling = prepared(TABLES["unknown"])
    settings = KrigingSettings(noise_prior=(0.0, 1e9))
    (rows,) = noise.noisy_rows(equations, scaling, settings)
    kernel, known = Hyperparameters.of_logarithms(PLACE), equations.known
    result = noise.posterior(rows, noise.spectrum(rows, kernel, settings), settings).values
    matrix = covariance(equations.x, known, equations.x, known, kernel)
    matrix += settings.nugget * kernel.prior(1)[0] * np.eye(len(matrix))
    terms, data = mean_terms(equations.x, known), equations.data[known]
    ratios = np.exp(np.arange(*settings.ratio_bounds, settings.ratio_step))
    expected = []
    for ratio in ratios:
        inverse = np.linalg.inv(matrix + ratio * np.eye(len(matrix)))
        precision = terms.T @ inverse @ terms
        left = inverse - inverse @ terms @ np.linalg.solve(precision, terms.T @ inverse)
        square = np.einsum("eq,ef,fq->q", data, left, data) / (len(data) - terms.shape[1])
        determinants = np.linalg.slogdet(precision)[1] - np.linalg.slogdet(inverse)[1]
        freedom = len(data) - terms.shape[1]
        expected.append(0.5 * (freedom * np.log(square) + determinants))
    difference = result - np.array(expected)
    some = ratios > 1e-4  # below it the inverse loses what is compared
    np.testing.assert_allclose(difference[some], difference[-1:] + 0 * difference[some], atol=1e-6)


@pytest.mark.parametrize("name", ["smooth", "hardening", "clearance"])
def test_the_noise_is_found_of_each_output(name: str) -> None:
    """One that bends by a load where the others are straight was taken for noise: 1.55 x."""
    rows, size = measured(name, full_wrenches(200, 5), 0.01, 5)
    result = Kriging.build(rows, RANGE).observation_noise / (1.96 * 0.01 * size)
    assert (result > 0.75).all()
    assert (result < 1.3).all()


@pytest.mark.parametrize("stated", [0.1, 1.0, 10.0])
def test_the_factor_on_stated_errors_is_found(stated: float) -> None:
    rows, size = measured("smooth", full_wrenches(200, 6), 0.01, 6, stated)
    kriging = Kriging.build(rows, RANGE)
    result = np.sqrt(kriging.equations.noise).mean(axis=0) * kriging.scaling.spread / (0.01 * size)
    assert (result > 0.75).all()
    assert (result < 1.3).all()


@pytest.mark.parametrize("deviation", [0.001, 0.01])
def test_bars_of_one_load_that_is_swept_hold_and_are_no_rounding_at_a_row(deviation: float) -> None:
    """They were 7e-16 m at a row, and 58 % of errors outside."""
    x, asked = np.zeros((41, 6)), np.zeros((200, 6))
    x[:, 2], asked[:, 2] = np.linspace(-1, 1, 41), np.linspace(-0.99, 0.99, 200)
    rows, size = measured("hardening", x, deviation, 2)
    kriging = Kriging.build(rows, RANGE)
    moved, bar = kriging.answer_many(asked * HIGH)
    known = np.isfinite(bar).all(axis=1)
    assert known.mean() > 0.9
    assert (np.abs(moved - RESPONSES["hardening"](asked)) > bar)[known].mean(axis=0).max() < 0.1
    at_rows = kriging.answer_many(rows.wrench)[1]
    between = np.median(bar[known], axis=0)
    assert (np.nanmedian(at_rows, axis=0) > 0.5 * between).all()
    assert (at_rows < 2 * 1.96 * deviation * size)[np.isfinite(at_rows).all(axis=1)].all()


@pytest.mark.parametrize("count", [4, 5, 6, 7])
def test_rows_that_determine_the_mean_alone_have_no_error(count: int) -> None:
    wrenches = full_wrenches(count, 3)
    rows = Rows.of(wrenches * HIGH, solved(RESPONSES["nearly_linear"], wrenches).displacement)
    _, bar = Kriging.build(rows, RANGE).answer_many(full_wrenches(100, 5) * HIGH)
    assert np.isnan(bar).all()


def test_a_rig_that_shows_nothing_at_all_has_an_error_bar_that_is_not_0() -> None:
    rows = Rows.of(full_wrenches(30, 3) * HIGH, np.zeros((30, 6)))
    assert (Kriging.build(rows, RANGE).floor > 0).all()


def test_many_exact_readings_choose_among_kernels_of_which_most_cannot_be() -> None:
    wrenches = full_wrenches(401, 3)
    rows = Rows.of(wrenches * HIGH, solved(RESPONSES["smooth"], wrenches).displacement)
    kriging = Kriging.build(rows, RANGE)
    assert np.isfinite(kriging.answer_many(rows.wrench)[1]).any()
    assert np.nanmax(kriging.observation_noise / np.ptp(rows.displacement, axis=0)) < 1e-3


def test_a_shifted_kernel_of_a_singular_covariance_is_left_out(monkeypatch) -> None:
    """The table had no kriging at all, although the likeliest kernel was sound."""
    spectrum, calls = noise.spectrum, []

    def first_is_singular(*arguments):
        calls.append(arguments)
        if len(calls) == 1:
            raise SingularCovarianceError("rows contradict each other")
        return spectrum(*arguments)

    searched = noise._likely_logarithms

    def search(*arguments):
        result = searched(*arguments)
        monkeypatch.setattr(noise, "spectrum", first_is_singular)
        return result

    monkeypatch.setattr(noise, "_likely_logarithms", search)
    equations, scaling = prepared(TABLES["beside solves"])
    result = noise.estimate_noise(equations, scaling, full_wrenches(50, 4), ROUGH)
    assert len(calls) == len(ROUGH.length_shifts)
    assert (result.noise > 0).all()


@pytest.mark.parametrize("count", [1, 5])
def test_a_few_readings_among_many_solves_have_a_noise(count: int) -> None:
    readings, _ = measured("smooth", full_wrenches(count, 8), 0.01, 2)
    equations, scaling = prepared(solved(SMOOTH, full_wrenches(100, 3)) + readings)
    settings = KrigingSettings()
    result = noise.estimate_noise(equations, scaling, full_wrenches(50, 4), settings)
    assert np.isfinite(result.noise).all()
    assert np.isfinite(result.variance).all()
    assert (result.variance > 0).all()
