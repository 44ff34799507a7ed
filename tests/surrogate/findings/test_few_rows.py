"""Findings are silent on clean tests of few rows: a part exactly linear, one axis at a time."""

import numpy as np
import pytest

from tests.slow import slow
from wrenchbook.surrogate.findings.find import find
from wrenchbook.surrogate.table.rows import LoadRange, Rows

COMPLIANCE = np.diag([1e-6] * 3 + [1e-5] * 3)
HIGH = np.array([900.0] * 3 + [90.0] * 3)
RANGE = LoadRange(-HIGH, HIGH)
LEVELS = {
    "two": [1, -1],
    "three": [1, -1, 0.5],
    "four": [1, -1, 0.5, -0.5],
    "five": [1, -1, 0.5, -0.5, 0.25],
    "six": [1, 0.6, 0.2, -0.2, -0.6, -1],
    "seven": [1, -1, 0.6, -0.6, 0.2, -0.2, 0],
}
NOISES = [0.0, 1e-4, 3e-3, 0.03]  # of each output's range


def levels(values, axes=6):
    """Return wrenches of all levels of each axis, one axis after the other."""
    return np.kron(np.eye(6)[:axes], np.reshape(values, (-1, 1))) * HIGH


def causes(wrench, noise=0.0, seed=0):
    moved = wrench @ COMPLIANCE
    errors = np.random.default_rng(seed).normal(size=moved.shape)
    moved += noise * np.ptp(moved, axis=0) * errors
    return {finding.cause for finding in find(Rows.of(wrench, moved), RANGE)}


@pytest.mark.parametrize("noise", NOISES)
@pytest.mark.parametrize("count", LEVELS)
def test_a_few_levels_of_each_axis_have_no_finding(count, noise):
    """Three levels of noise 0 had a clearance, six and seven had six channels of noise."""
    assert causes(levels(LEVELS[count]), noise) == set()


@pytest.mark.parametrize("noise", NOISES)
def test_three_levels_of_the_forces_alone_have_no_finding(noise):
    """Nine rows had a clearance and an asymmetry."""
    assert causes(levels(LEVELS["three"], axes=3), noise) == set()


@pytest.mark.parametrize("noise", [1e-4, 3e-3, 0.01])
@pytest.mark.parametrize("seeds", [range(2), slow(range(2, 8))])
def test_sixteen_rows_of_one_axis_each_have_no_finding(noise, seeds):
    """Four of ten tests had an asymmetry, and four a clearance."""
    for seed in seeds:
        rng = np.random.default_rng(seed)
        wrench = np.eye(6)[np.arange(16) % 6] * rng.uniform(-1, 1, (16, 1)) * HIGH
        assert causes(wrench, noise, seed) == set()


def test_levels_that_scatter_by_the_control_of_the_load_have_no_finding():
    for seed in range(4):
        wrench = levels(LEVELS["three"])
        wrench *= 1 + 1e-3 * np.random.default_rng(seed).normal(size=wrench.shape)
        assert causes(wrench, 1e-4, seed) == set()


def test_an_axis_of_few_rows_among_many_is_no_channel_of_noise():
    """The ends of its readings, which are the whole response, were clipped as wrong rows."""
    many = np.outer(900 * np.sin(np.arange(190) / 9), np.eye(6)[0])
    few = np.outer(np.linspace(-90, 90, 10), np.eye(6)[5])
    assert "noise" not in causes(np.concatenate((many, few)), 1e-3)


def test_dense_readings_that_differ_by_little_more_than_rounding_have_no_finding():
    """All steps between sorted readings were rounding, and their median was that of none."""
    wrench = np.random.default_rng(1).uniform(-1.0, 1.0, (500, 6)) * HIGH
    rows = Rows.of(wrench, 1e-3 + 1e-14 * wrench / HIGH)
    no_reference = {"zero"}  # of the constant part
    assert {finding.cause for finding in find(rows, RANGE)} <= no_reference
