"""The kernel's answers of rows that bring second derivatives, of 7 and 12 inputs too.

Those of six inputs are in `kinds.KINDS`, which all tests of the kernel take.
"""

import numpy as np
import pytest

from tests.surrogate.kernel.kinds import SAME, SIGMA, asked_of, packed_of, table_of
from tests.surrogate.test_space import SPACES, range_of, solved_with_second, spread_wrenches
from wrenchbook.surrogate.build import build
from wrenchbook.surrogate.packed.writer import packed_of as pack


@pytest.fixture(scope="module", params=SPACES.values(), ids=list(SPACES))
def made(request):
    """A table, its packed form and wrenches."""
    load_range = range_of(request.param)
    table = build(solved_with_second(request.param, spread_wrenches(load_range, 12)), load_range)
    asked = np.random.default_rng(3).uniform(-1, 1, (100, len(request.param.inputs)))
    return table, pack(table), asked


def test_values_of_several_interfaces_and_further_inputs_are_those_of_numpy(made):
    table, packed, asked = made
    kriging = table.groups[0].kriging
    lost = kriging.rounding * kriging.scaling.spread
    near = SAME * np.abs(table.rows.displacement).max(axis=0) + lost
    expected, _ = kriging.answer_many(asked)
    assert (np.abs(packed.batch(asked, None, "kriging").outputs - expected) <= near).all()


def test_error_bars_of_several_interfaces_and_further_inputs_are_those_of_numpy(made):
    table, packed, asked = made
    _, expected = table.groups[0].kriging.answer_many(asked)
    found = packed.batch(asked, None, "kriging").errors
    assert np.isfinite(expected).any()
    np.testing.assert_allclose(found, expected, rtol=SIGMA)


def assert_differences(packed, asked, scale):
    """Compare derivatives with differences of values over 1e-5 of half the load range."""
    steps = 1e-5 * np.diag(scale)
    for wrench in asked:
        ends = (packed.batch(wrench + sign * steps, None, "kriging").outputs for sign in (1, -1))
        by_differences = np.subtract(*ends).T / 2e-5
        found = packed.derivatives(wrench[None], None, "kriging")[0] * scale
        size = np.abs(found).max(axis=1, keepdims=True)
        np.testing.assert_allclose(found / size, by_differences / size, atol=1e-6)


def test_derivatives_of_several_interfaces_and_further_inputs_are_differences_of_values(made):
    _, packed, asked = made
    assert_differences(packed, asked[:5], np.ones(asked.shape[1]))


@pytest.mark.parametrize(
    "kind",
    [
        *("second derivatives", "second derivatives of some"),
    ],
)
def test_derivatives_are_differences_of_values(kind):
    table = table_of(kind)
    assert_differences(packed_of(kind), asked_of(table, 10, span=0.9), table.load_range.scale)
