"""A shift between the clocks of two logs is named with its size; clocks that agree have none."""

import numpy as np
import pytest

from tests.slow import slow
from tests.surrogate.findings.rigs import Rig
from wrenchbook.surrogate.findings.clock import Logs, clock_findings, estimate_lag

# In `make test` one seed of those whose shift must be found, and five clean ones.
TEN = pytest.mark.parametrize("seeds", [range(5200, 5201), slow(range(5200, 5210))])
FIFTY = pytest.mark.parametrize("seeds", [range(5300, 5305), slow(range(5305, 5350))])
RATE = 40.0  # Hz, of the displacements


def logs_of(rig, lag, error=None):
    """Return the logs of a rig whose displacements' times are `lag` seconds too early."""
    rows = rig.measured(error)
    when = np.arange(len(rows)) / RATE
    time = np.arange(0.0, when[-1], 0.01) + rig.rng.uniform(0, 0.01)
    wrench = np.stack([np.interp(time, when, load) for load in rows.wrench.T], axis=1)
    return Logs(time, wrench, when - lag, rows.displacement)


def rigs(seeds):
    return [Rig(seed, ("sweeps", "motion")) for seed in seeds]


@TEN
@pytest.mark.parametrize("lag", [0.05, 0.1, 0.35, 0.5, -0.2])
def test_a_clock_shift_is_named_with_its_size_in_nine_of_ten_measurements(lag, seeds):
    results = [estimate_lag(logs_of(rig, lag)) for rig in rigs(seeds)]
    named = [result.applied_is_wrong and abs(result.seconds - lag) < 0.01 for result in results]
    assert sum(named) >= 0.9 * len(seeds)


@FIFTY
def test_fifty_pairs_of_logs_with_one_clock_have_no_finding(seeds):
    named = [bool(clock_findings(estimate_lag(logs_of(rig, 0.0)), 0.0)) for rig in rigs(seeds)]
    assert not any(named)


@TEN
@pytest.mark.parametrize("error", ["hysteresis of 2 %", "hysteresis of 8 %"])
def test_hysteresis_is_no_clock_shift(error, seeds):
    assert not any(estimate_lag(logs_of(rig, 0.0, error)).applied_is_wrong for rig in rigs(seeds))


def test_the_lag_that_is_applied_already_is_no_finding():
    logs = logs_of(Rig(5201, ("motion",)), 0.35)
    lag = estimate_lag(logs, 0.35)
    assert abs(lag.seconds - 0.35) < 0.01
    assert clock_findings(lag, 0.35) == []


def test_a_lag_that_is_far_from_the_applied_one_is_found():
    rig = Rig(5202, ("motion",), rows=(600, 1000))  # 15 s at least: a quarter of it is searched
    assert abs(estimate_lag(logs_of(rig, 0.35), -1.5).seconds - 0.35) < 0.01


def test_logs_that_do_not_belong_together_have_no_lag():
    one, other = rigs([5203, 5204])
    loads, moved = logs_of(one, 0.0), logs_of(other, 0.0)
    noise = np.random.default_rng(1).normal(size=moved.displacement.shape)
    assert estimate_lag(moved._replace(displacement=noise)) is None
    assert estimate_lag(loads._replace(displacement_time=loads.displacement_time + 1e6)) is None


def test_loads_that_rest_have_no_lag():
    logs = logs_of(Rig(5205, ("motion",)), 0.0)
    assert estimate_lag(logs._replace(wrench=np.zeros_like(logs.wrench))) is None


def slow_logs(seed, shift, rate=0.0, duration=40.0):
    """Return logs of loads of 0.1 to 0.4 Hz and of displacements that read `shift` s too late.

    The displacements' clock runs too fast by `rate`.
    """
    rng = np.random.default_rng(seed)
    time, when = np.arange(0, duration, 0.01), np.arange(0.5, duration - 0.5, 0.05)
    frequency, phase = rng.uniform(0.1, 0.4, (6, 3)), rng.uniform(0, 6, (6, 3))
    size, compliance = rng.uniform(0.2, 1, (6, 3)), rng.normal(size=(6, 6))

    def loads(at):
        turns = 2 * np.pi * frequency * at[:, None, None] + phase
        return (size * np.sin(turns)).sum(axis=2)

    moved = loads(when) @ compliance
    moved += 1e-3 * rng.normal(size=moved.shape) * moved.std(axis=0)
    return Logs(time, loads(time), (when - when.mean()) * (1 + rate) + when.mean() + shift, moved)


@pytest.mark.parametrize("shift", [0.0, 0.05, 0.35, 1.0, -0.35])
def test_the_lag_of_slow_loads_is_within_its_error(shift):
    lags = [estimate_lag(slow_logs(seed, shift)) for seed in range(8100, 8106)]
    assert all(abs(lag.seconds + shift) < lag.error < 0.01 for lag in lags)


def test_the_lag_of_one_slow_load_without_noise_is_within_its_error():
    time, when = np.arange(0, 20, 0.01), np.arange(0.3, 19.7, 0.05)
    wrench, moved = np.zeros((len(time), 6)), np.zeros((len(when), 6))
    for loads, at in ((wrench, time), (moved, when)):
        loads[:, 2] = 800 * np.sin(0.22 * np.pi * at) + 150 * np.sin(0.74 * np.pi * at + 1)
    for shift in (0.02, 0.35, 2.0):
        lag = estimate_lag(Logs(time, wrench, when + shift, 1e-6 * moved))
        assert abs(lag.seconds + shift) < lag.error < 1e-3


def test_a_search_that_ends_at_its_bound_gives_no_lag():
    """Loads that only grow: a later time is as good as a larger load, at every lag."""
    time = np.arange(0, 20, 0.05)
    wrench = np.zeros((len(time), 6))
    wrench[:, 2] = np.exp(time / 5)
    moved = 1e-6 * wrench
    assert estimate_lag(Logs(time, wrench, time + 0.35, moved)) is None


@pytest.mark.parametrize("rate", [0.005, -0.005])
def test_clocks_of_different_rates_are_named_with_the_factor(rate):
    for seed in range(8200, 8203):
        lag = estimate_lag(slow_logs(seed, 0.2, rate, 60.0))
        (finding,) = clock_findings(lag, lag.seconds)
        assert abs((1 + finding.numbers["rate"]) * (1 + rate) - 1) < 3e-4
        assert "multiply the times of the displacements by" in finding.message


def test_clocks_of_one_rate_have_no_finding_of_a_rate():
    lags = [estimate_lag(slow_logs(seed, 0.2, 0.0, 60.0)) for seed in range(8300, 8306)]
    assert not any(lag.rate for lag in lags)


@pytest.mark.parametrize(("frequency", "shift"), [(0.22, 2.0), (0.22, -1.0), (1.3, 2.0)])
def test_loads_that_repeat_have_several_lags_and_no_lag_auto(frequency, shift):
    time, when = np.arange(0, 20, 0.01), np.arange(0.3, 19.7, 0.05)
    wrench, moved = np.zeros((len(time), 6)), np.zeros((len(when), 6))
    for loads, at in ((wrench, time), (moved, when)):
        loads[:, 2] = 800 * np.sin(2 * np.pi * frequency * at)
    lag = estimate_lag(Logs(time, wrench, when + shift, 1e-6 * moved))
    assert lag.others
    assert min(abs(item + shift) for item in (lag.seconds, *lag.others)) < 1e-3
    (finding,) = clock_findings(lag, 0.0)
    assert "the loads repeat" in finding.message
    assert "lag=auto" not in finding.message


def test_a_finding_names_all_lags_where_loads_repeat_and_recommends_none():
    time, when = np.arange(0, 20, 0.01), np.arange(0.3, 19.7, 0.05)
    wrench = np.outer(800 * np.sin(2.6 * np.pi * time), np.eye(6)[2])
    moved = np.outer(800e-6 * np.sin(2.6 * np.pi * when), np.eye(6)[2])
    lag = estimate_lag(Logs(time, wrench, when + 0.2, moved))
    (finding,) = clock_findings(lag, 0.0)
    assert finding.numbers == {"lags": sorted((lag.seconds, *lag.others))}
    assert "lag=" not in finding.message


def test_noise_of_the_loads_is_no_difference_of_clock_rates():
    """Interpolation averages the noise of two loads, but not where displacements fall on one."""
    for seed in range(8400, 8412):
        logs = slow_logs(seed, 0.2, 0.0, 20.0)
        noise = np.random.default_rng(seed).normal(size=logs.wrench.shape)
        noisy = logs._replace(wrench=logs.wrench + 0.01 * noise * logs.wrench.std(axis=0))
        assert not estimate_lag(noisy).rate
