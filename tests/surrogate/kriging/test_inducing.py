"""Measured rows beyond one factor, through inducing wrenches."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.surrogate.responses import HIGH, RANGE, coupled
from wrenchbook.surrogate.build import build
from wrenchbook.surrogate.kriging import Kriging, inducing
from wrenchbook.surrogate.kriging.correlation import Hyperparameters, covariance, mean_terms
from wrenchbook.surrogate.kriging.equations import Equations, indices_within, scaling_of, values_of
from wrenchbook.surrogate.kriging.factor import KrigingFactor, OutputGroup, factorise
from wrenchbook.surrogate.kriging.inducing import Inducing, induced, values_between
from wrenchbook.surrogate.kriging.noise import Estimate
from wrenchbook.surrogate.kriging.settings import DEFAULTS
from wrenchbook.surrogate.packed.writer import packed_of
from wrenchbook.surrogate.table.merging import merge
from wrenchbook.surrogate.table.rows import Rows

KERNEL = Hyperparameters.of_logarithms(np.array([-1.0, -1.2, -0.8, -1.5, -1.0, -1.3, -2.0]))
ALWAYS = replace(DEFAULTS, dense_equations=0)
ASKED = np.random.default_rng(1).uniform(-0.95, 0.95, (200, 6))
VALUE = np.ones((len(ASKED), 1), dtype=bool)


def measured(count: int, noise: float, seed: int = 3) -> Rows:
    """Return rows of a rig, with noise of each output's range."""
    rng = np.random.default_rng(seed)
    x = rng.uniform(-1, 1, (count, 6))
    exact = coupled(x)
    moved = exact + noise * np.ptp(exact, axis=0) * rng.standard_normal(exact.shape)
    return Rows.of(x * HIGH, moved, source=["rig"] * count)


def equations_of(rows: Rows) -> Equations:
    """Return the values' equations of rows, repeated wrenches merged, sorted."""
    merged = merge(rows, RANGE).usable()
    order = np.lexsort(merged[0].wrench.T)
    used = merged[0].take(order)
    return values_of(used, scaling_of(used, RANGE), merged[2].take(order))


def estimate(equations: Equations, ratio: float) -> Estimate:
    """Return one kernel, and noise as so much of the process."""
    variance = np.full(6, 0.1)
    noise = ratio * variance / equations.typical_noise
    return Estimate((KERNEL,) * 6, variance, noise, *np.ones((2, 6)))


def through(equations: Equations, ratio: float) -> Inducing:
    """Return the inducing wrenches of rows whose noise is guessed as so much of the process."""
    result = induced(equations, estimate(equations, ratio), ALWAYS)
    assert result is not None
    return result


def answered(factor: KrigingFactor) -> tuple[np.ndarray, np.ndarray]:
    """Return the values (n, k) and variances (n, k), spreads, at the wrenches asked for."""
    at, known = factor.equations.x, np.zeros((len(factor.equations), 1), dtype=bool)
    across = covariance(ASKED, VALUE, at, ~known, KERNEL)
    terms = mean_terms(ASKED, VALUE)
    explained = factor.explained(across, terms)
    variance = factor.variance_of(*explained, factor.mean_covariance)
    values = across @ factor.weights + terms @ factor.coefficients
    return values, variance[:, None] * factor.variance


def test_with_every_row_an_inducing_wrench_it_is_the_kriging_of_all_rows(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(inducing, "spread_points", lambda x, *_: (np.arange(len(x)), True))
    equations = equations_of(measured(150, 0.01))
    result = through(equations, 1e-2)
    assert len(result.equations) == 150
    noise = result.noise
    for factor in result.factors:
        outputs = factor.output_group.outputs
        ratio = float((noise[outputs] / factor.variance).mean())
        group = OutputGroup(outputs, np.arange(150), np.full(150, ratio))
        exact = factorise(equations, KERNEL, group)
        exact = replace(exact, variance=factor.variance)
        for ours, theirs in zip(answered(factor), answered(exact), strict=True):
            np.testing.assert_allclose(ours, theirs, rtol=1e-4, atol=1e-5)


def test_the_noise_is_that_of_all_rows() -> None:
    rows = measured(3000, 0.01)
    equations = equations_of(rows)
    true = 0.01 * np.ptp(coupled(rows.wrench / HIGH), axis=0) / np.std(rows.displacement, axis=0)
    result = through(equations, 1e-3)
    np.testing.assert_allclose(np.sqrt(result.noise), true, rtol=0.06)


@pytest.mark.parametrize("noise", [0.003, 0.02])
def test_errors_are_within_the_posterior(noise: float) -> None:
    rows = measured(3000, noise)
    equations = equations_of(rows)
    used = rows.take(indices_within(rows, RANGE))
    scaling = scaling_of(used, RANGE)
    truth = (coupled(ASKED) - scaling.offset) / scaling.spread
    for factor in through(equations, 1e-2).factors:
        values, variance = answered(factor)
        errors = np.abs(values - truth[:, factor.output_group.outputs])
        bars = 1.96 * np.sqrt(variance)
        assert ((errors > bars).mean(axis=0) <= 0.1).all()


def test_more_rows_tell_more() -> None:
    widths = []
    for count in (500, 2000, 8000):
        variances = np.empty((len(ASKED), 6))
        for factor in through(equations_of(measured(count, 0.01)), 1e-2).factors:
            variances[:, factor.output_group.outputs] = answered(factor)[1]
        widths.append(np.median(variances, axis=0))
    assert (widths[1] < widths[0]).all()
    assert (widths[2] < widths[1]).all()


@given(st.integers(0, 2**31))
@settings(max_examples=5, deadline=None)
def test_the_order_of_the_rows_does_not_matter(seed: int) -> None:
    rows = measured(600, 0.01)
    mixed = rows.take(np.random.default_rng(seed).permutation(len(rows)))
    first, second = (through(equations_of(some), 1e-2) for some in (rows, mixed))
    for ours, theirs in zip(first.factors, second.factors, strict=True):
        np.testing.assert_array_equal(ours.equations.x, theirs.equations.x)
        np.testing.assert_allclose(answered(ours)[0], answered(theirs)[0], atol=1e-9)


def test_readings_at_one_wrench_count_as_the_rows_they_are() -> None:
    """As many readings of unknown noise at each wrench say as much as their mean, and how noisy."""
    rows = measured(500, 0.01)
    rng = np.random.default_rng(5)
    size = 0.01 * np.ptp(rows.displacement, axis=0)
    four = Rows.of(
        np.repeat(rows.wrench, 4, axis=0),
        np.repeat(coupled(rows.wrench / HIGH), 4, axis=0) + size * rng.standard_normal((2000, 6)),
        source=["rig"] * 2000,
    )
    equations = equations_of(four)
    assert (equations.observations == 4).all()
    result = through(equations, 1e-2)
    one = through(equations_of(rows), 1e-2)
    np.testing.assert_allclose(result.noise, one.noise, rtol=0.35)
    for ours, theirs in zip(result.factors, one.factors, strict=True):
        ratio = np.median(answered(ours)[1][:, 0]) / np.median(answered(theirs)[1][:, 0])
        assert 0.2 < ratio < 0.6


def test_a_response_that_wrenches_leave_more_of_than_noise_stays_with_one_factor() -> None:
    equations = equations_of(measured(500, 0.0))
    assert induced(equations, estimate(equations, 1e-9), DEFAULTS) is None


def test_values_between_are_the_covariance() -> None:
    x = np.random.default_rng(2).uniform(-1, 1, (50, 6))
    x[7] = ASKED[3]
    np.testing.assert_allclose(
        values_between(x, ASKED, KERNEL),
        covariance(x, np.ones((50, 1), dtype=bool), ASKED, VALUE, KERNEL),
        rtol=1e-13,
        atol=1e-13,
    )


def test_a_kriging_of_many_rows_says_how_many_it_is_of() -> None:
    kriging = Kriging.build(measured(900, 0.02), RANGE)
    assert (
        kriging.detail == f"kriging of 900 rows through {len(kriging.equations)} inducing wrenches"
    )
    values, errors = kriging.answer_many(ASKED * HIGH)
    assert np.isfinite(errors).mean() > 0.9
    bars, size = np.nanmedian(errors, axis=0), np.median(np.abs(values - coupled(ASKED)), axis=0)
    assert np.median(bars / size) <= 5
    outside = (np.abs(values - coupled(ASKED)) > errors)[np.isfinite(errors).all(axis=1)]
    assert (outside.mean(axis=0) <= 0.1).all()


def test_an_output_that_does_not_vary_leaves_the_bars_of_the_others() -> None:
    rows = measured(600, 0.003)
    still = rows.displacement * np.array([1.0, 1.0, 1.0, 0.0, 1.0, 0.0])
    alone = Kriging.build(rows, RANGE).answer_many(ASKED * HIGH)[1]
    beside = Kriging.build(replace(rows, displacement=still), RANGE).answer_many(ASKED * HIGH)[1]
    ratios = np.nanmedian(beside[:, [0, 1, 2, 4]] / alone[:, [0, 1, 2, 4]], axis=0)
    assert ((ratios > 0.7) & (ratios < 1.4)).all()


def test_bars_hold_and_are_of_the_errors_size_where_some_rows_lack_an_output() -> None:
    rows = measured(600, 0.003)
    moved = rows.displacement.copy()
    moved[np.random.default_rng(5).uniform(size=moved.shape) < 0.03] = np.nan
    one = np.zeros(moved.shape, dtype=bool)
    one[5, 2] = True
    for lacking in (one, np.isnan(moved)):
        table = build(
            replace(rows, displacement=np.where(lacking, np.nan, rows.displacement)), RANGE
        )
        result = packed_of(table).batch(ASKED * HIGH, method="kriging")
        error = np.abs(result.outputs - coupled(ASKED))
        assert (error <= result.errors).mean(axis=0).min() >= 0.9
        assert (np.nanmedian(result.errors, axis=0) <= 10 * np.median(error, axis=0)).all()


def test_rows_that_tell_some_wrenches_and_others_not_at_all_have_a_factor(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Rounding left what the rows tell indefinite, and the table could not be built."""
    summed = inducing.sums_of

    def of_any_condition(*arguments: object) -> inducing.Sums:
        sums = summed(*arguments)  # pyright: ignore[reportArgumentType]
        basis = np.linalg.qr(np.random.default_rng(3).normal(size=sums.A.shape))[0]
        return sums._replace(A=(basis * np.logspace(-16, 14, len(basis))) @ basis.T)

    monkeypatch.setattr(inducing, "sums_of", of_any_condition)
    factor = Kriging.build(measured(600, 0.003), RANGE).neighbourhoods[0].factor
    assert np.isfinite(factor.T).all()
