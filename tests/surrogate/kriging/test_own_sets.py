"""Outputs get length scales of their own where the likelihood pays for them."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from tests.surrogate.energies import PARTS, part_with_friction
from tests.surrogate.kriging.responses import RESPONSES, UNEVEN, noisy_rows, solved
from tests.surrogate.responses import HIGH, RANGE, clean_wrenches, full_wrenches, smooth
from wrenchbook.surrogate.kriging import Kriging
from wrenchbook.surrogate.kriging.correlation import derivatives, joins, places_of
from wrenchbook.surrogate.kriging.estimate import spread_rows
from wrenchbook.surrogate.kriging.factor import shares_of
from wrenchbook.surrogate.kriging.likelihood import negative_log_likelihood
from wrenchbook.surrogate.kriging.own_sets import promised_gains
from wrenchbook.surrogate.kriging.settings import DEFAULTS
from wrenchbook.surrogate.table.rows import LoadRange

ASKED = full_wrenches(500, 771)
COMMON = replace(DEFAULTS, own_gain=np.inf)


@cache
def built(name: str, count: int, *, own: bool = True) -> Kriging:
    rows = solved(UNEVEN[name][0], full_wrenches(count, 31))
    return Kriging.build(rows, RANGE, settings=DEFAULTS if own else COMMON)


def errors(name: str, count: int, *, own: bool = True) -> np.ndarray:
    """Return each output's RMS error over its range, shape (6,)."""
    true = UNEVEN[name][0](ASKED)
    missed = built(name, count, own=own).answer_many(ASKED * HIGH)[0] - true
    return np.sqrt((missed**2).mean(axis=0)) / np.ptp(true, axis=0)


def own_outputs(kriging: Kriging) -> set[int]:
    shares = [share.factor for share in kriging.inside.shares]
    own = [one for one in shares if one.hyperparameters is not kriging.hyperparameters]
    return {int(output) for one in own for output in one.outputs}


@pytest.mark.parametrize(
    ("name", "count"),
    [
        *(("friction", 15), ("friction", 60), ("mirrored", 15), ("mirrored", 30)),
        *(("stiff_beside_soft", 30), ("stiff_beside_soft", 60)),
    ],
)
def test_an_output_of_another_kind_has_its_own_set_and_half_the_error(name, count):
    _, outputs = UNEVEN[name]
    assert own_outputs(built(name, count)) >= set(outputs)
    found, before = errors(name, count), errors(name, count, own=False)
    assert (found[outputs] < before[outputs] / 2).all()


@pytest.mark.parametrize("count", [15, 30, 60])
@pytest.mark.parametrize("name", UNEVEN)
def test_no_output_gets_worse_by_its_own_set(name, count):
    worse = errors(name, count) / errors(name, count, own=False)
    assert worse.max() < 1.05


@pytest.mark.parametrize("name", UNEVEN)
def test_bars_of_such_outputs_hold(name):
    displacement, bars = built(name, 30).answer_many(ASKED * HIGH)
    known = np.isfinite(bars).all(axis=1)
    inside = (np.abs(displacement - UNEVEN[name][0](ASKED)) <= bars)[known]
    assert known.mean() > 0.7
    assert inside.mean(axis=0).min() >= 0.9


@pytest.mark.parametrize("count", [9, 20])
@pytest.mark.parametrize("name", ["stiffening", "saturating", "waving"])
def test_an_output_has_its_own_set_beside_second_derivatives_too(name, count):
    """By the set of all outputs u_x errs by 15 to 3,000 % of its range, more with 20 solves."""
    made, rng = part_with_friction(PARTS[name], 4), np.random.default_rng(count)
    rows = made.rows(rng.uniform(-1, 1, (count, 6)))
    asked = made.rows(np.random.default_rng(99).uniform(-1, 1, (300, 6)), second=False)
    load_range = LoadRange(1.1 * RANGE.low, 1.1 * RANGE.high)
    found, common = (Kriging.build(rows, load_range, one) for one in (DEFAULTS, COMMON))
    assert 0 in own_outputs(found)
    (displacement, bars), (other, _) = (one.answer_many(asked.wrench) for one in (found, common))
    missed, before = (np.abs(one - asked.displacement) for one in (displacement, other))
    assert np.median(missed[:, 0]) < np.median(before[:, 0]) / 10
    assert np.median(missed[:, 0]) < 0.01 * np.ptp(asked.displacement[:, 0])
    known = np.isfinite(bars).all(axis=1)
    assert count == 9 or known.mean() > 0.8
    assert not known.any() or (missed <= bars)[known].mean(axis=0).min() >= 0.9


def test_derivatives_by_own_sets_are_differences_of_values():
    kriging, step = built("friction", 30), 1e-4 * HIGH
    asked = 0.9 * ASKED[:5] * HIGH
    ends = [kriging.answer_many(asked + way)[0] for way in (*np.diag(step), *np.diag(-step))]
    by_differences = (np.array(ends[:6]) - ends[6:]) / (2 * step[:, None, None])
    found = kriging.derivatives(asked).transpose(2, 0, 1) * HIGH[:, None, None]
    size = np.abs(found).max()
    np.testing.assert_allclose(
        found, by_differences * HIGH[:, None, None], rtol=0, atol=1e-4 * size
    )


def test_fewer_rows_than_fifteen_have_one_set():
    assert not own_outputs(built("friction", 14))


def levels(count: int, values: int) -> np.ndarray:
    """Return wrenches on so many levels of each load, scaled, shape (count, 6)."""
    ends = np.linspace(-1, 1, values)
    return ends[np.random.default_rng(3).integers(0, values, (count, 6))]


@pytest.mark.parametrize(
    "scaled", [clean_wrenches(8, 1), clean_wrenches(20, 1), levels(20, 5), levels(40, 3)]
)
@pytest.mark.parametrize("name", ["hardening", "strongly_coupled"])
def test_rows_of_single_axes_or_few_levels_have_one_set(name, scaled):
    """A row left out has copies there: errors by own sets were up to 250 times as large."""
    assert not own_outputs(Kriging.build(solved(RESPONSES[name], scaled), RANGE))


def test_noisy_rows_have_one_set():
    rows = noisy_rows(UNEVEN["friction"][0], full_wrenches(120, 5), 6, told=True)
    assert not own_outputs(Kriging.build(rows, RANGE))


def test_a_pending_solve_narrows_each_set_by_its_own_distances():
    kriging, pending = built("friction", 30), ASKED[:1] * HIGH
    ratio = kriging.sigma_with(pending, ASKED[1:40] * HIGH) / kriging.sigma_with(
        pending[:0], ASKED[1:40] * HIGH
    )
    assert (ratio <= 1).all()
    assert not np.allclose(ratio[:, 0], ratio[:, 3], rtol=1e-3)
    at_it = kriging.sigma_with(pending, pending) / kriging.sigma_with(pending[:0], pending)
    assert at_it[0, 0] < 1e-2


def test_the_promise_is_that_of_the_slope_and_curvature_of_the_likelihood():
    """For a small step it is the quadratic that the likelihood falls by."""
    kriging = Kriging.build(solved(smooth, full_wrenches(30, 31)), RANGE, COMMON)
    equations, held = kriging.inside.equations, kriging.hyperparameters
    chosen = equations.take(spread_rows(equations, DEFAULTS.likelihood_equations))
    (share,) = shares_of(chosen, np.ones(6))
    promised = promised_gains(chosen, share, held, DEFAULTS)
    assert (promised >= 0).all()
    for output in range(6):
        alone = [share._replace(outputs=np.array([output]))]
        slope = negative_log_likelihood(held.logarithms, chosen, alone)[1]
        assert promised[output] > 1e-4 * slope @ slope / len(chosen)


def test_an_output_whose_errors_are_below_a_ten_thousandth_keeps_the_common_set():
    """Of `stiff_beside_soft` the rotations are nearly straight."""
    assert own_outputs(built("stiff_beside_soft", 60)) <= {0, 1, 2, 5}


def test_variances_at_rest_are_those_of_the_covariance():
    held, count = built("friction", 15).hyperparameters, places_of(6, 2)
    joined, sign = joins(6, count, count)
    at_rest = np.diag(derivatives(np.zeros((1, 6)), held, 4)[0][joined] * sign)
    np.testing.assert_allclose(held.prior(count)[:7], at_rest[:7], rtol=1e-12)
