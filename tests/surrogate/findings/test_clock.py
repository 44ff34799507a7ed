"""A shift between the clocks of two logs is named with its size; clocks that agree have none."""

import numpy as np
import pytest

from tests.surrogate.findings.rigs import Rig
from wrenchbook.surrogate.findings.clock import Logs, clock_findings, estimate_lag

SEEDS = range(5200, 5210)
CLEAN = range(5300, 5350)
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


@pytest.mark.parametrize("lag", [0.05, 0.1, 0.35, 0.5, -0.2])
def test_a_clock_shift_is_named_with_its_size_in_nine_of_ten_measurements(lag):
    found = [estimate_lag(logs_of(rig, lag)) for rig in rigs(SEEDS)]
    assert sum(one.named and abs(one.seconds - lag) < 0.01 for one in found) >= 9


def test_fifty_pairs_of_logs_with_one_clock_have_no_finding():
    named = [bool(clock_findings(estimate_lag(logs_of(rig, 0.0)), 0.0)) for rig in rigs(CLEAN)]
    assert not any(named)


@pytest.mark.parametrize("error", ["hysteresis of 2 %", "hysteresis of 8 %"])
def test_hysteresis_is_no_clock_shift(error):
    assert not any(estimate_lag(logs_of(rig, 0.0, error)).named for rig in rigs(SEEDS))


def test_the_lag_that_is_applied_already_is_no_finding():
    logs = logs_of(Rig(5201, ("motion",)), 0.35)
    lag = estimate_lag(logs, 0.35)
    assert abs(lag.seconds - 0.35) < 0.01
    assert clock_findings(lag, 0.35) == []


def test_a_lag_that_is_far_from_the_applied_one_is_found():
    rig = Rig(5202, ("motion",))
    assert abs(estimate_lag(logs_of(rig, 0.35), -1.5).seconds - 0.35) < 0.01


def test_logs_that_do_not_belong_together_have_no_lag():
    one, other = rigs([5203, 5204])
    loads, moved = logs_of(one, 0.0), logs_of(other, 0.0)
    noise = np.random.default_rng(1).normal(size=moved.displacement.shape)
    assert estimate_lag(moved._replace(displacement=noise)) is None
    assert estimate_lag(loads._replace(when=loads.when + 1e6)) is None


def test_loads_that_rest_have_no_lag():
    logs = logs_of(Rig(5205, ("motion",)), 0.0)
    assert estimate_lag(logs._replace(wrench=np.zeros_like(logs.wrench))) is None
