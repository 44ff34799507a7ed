"""The likelihood's gradient is analytic, and hyperparameters come of maximising it."""

from collections.abc import Callable

import numpy as np
import pytest

from tests.surrogate.energies import part, stiffening
from tests.surrogate.kriging.responses import RESPONSES, noisy_rows, solved, spread_wrenches
from tests.surrogate.responses import RANGE, table
from wrenchbook.surrogate.kriging.correlation import Hyperparameters
from wrenchbook.surrogate.kriging.equations import (
    Equations,
    equations_of,
    indices_within,
    scaling_of,
)
from wrenchbook.surrogate.kriging.factor import OutputGroup, output_groups
from wrenchbook.surrogate.kriging.gradient import minimised
from wrenchbook.surrogate.kriging.likelihood import maximise, negative_log_likelihood, spread_rows
from wrenchbook.surrogate.kriging.settings import KrigingSettings
from wrenchbook.surrogate.table.merging import merge
from wrenchbook.surrogate.table.rows import Rows

PLACE = np.array([-0.5, 0.2, 0.1, -0.3, 0.4, 0.0, -0.7])
SMOOTH = RESPONSES["smooth"]
# A larger nugget, so that differences of the likelihood are not lost in rounding.
ROUGH = KrigingSettings(nugget=1e-6)


def _equations(rows: Rows) -> Equations:
    inside, _, readings = merge(rows.take(indices_within(rows, RANGE)), RANGE).usable()
    return equations_of(inside, scaling_of(inside, RANGE), readings)


def _partial(rows: Rows) -> Rows:
    displacement = rows.displacement.copy()
    displacement[::3, 2] = np.nan
    return Rows.of(rows.wrench, displacement, compliance=rows.compliance)


WRENCHES = spread_wrenches(3, 6, 1)
TABLES = {
    "solved": solved(SMOOTH, WRENCHES),
    "measured": noisy_rows(SMOOTH, WRENCHES, 1, told=True),
    "partial": _partial(solved(SMOOTH, WRENCHES)),
}


def differences(function: Callable[[np.ndarray], float], place: np.ndarray) -> list[float]:
    """Return the slopes by each number, by central differences of fourth order."""
    step, results = 1e-4, []
    for way in step * np.eye(len(place)):
        ahead, behind, ahead2, behind2 = (function(place + far * way) for far in (1, -1, 2, -2))
        results.append((8 * (ahead - behind) - (ahead2 - behind2)) / (12 * step))
    return results


def assert_gradient(place: np.ndarray, equations: Equations, near: float) -> None:
    groups = output_groups(equations, np.ones(6))
    _, gradient = negative_log_likelihood(place, equations, groups, ROUGH)
    expected = differences(lambda x: negative_log_likelihood(x, equations, groups, ROUGH)[0], place)
    assert gradient == pytest.approx(expected, rel=near, abs=near)


@pytest.mark.parametrize("name", TABLES)
def test_the_gradient_equals_differences(name: str) -> None:
    assert_gradient(PLACE, _equations(TABLES[name]), 1e-6)


def test_the_gradient_equals_differences_with_second_derivatives() -> None:
    """Of rows with and without them; then each term of the covariance has a weight."""
    whole = part(stiffening, 3)
    places = np.random.default_rng(5).uniform(-1, 1, (9, 6))
    equations = _equations(whole.rows(places[:6]) + whole.rows(places[6:], second=False))
    assert equations.count == 6 * 28 + 3 * 7
    assert_gradient(np.append(PLACE, [0.3, -0.2, 0.4]), equations, 1e-5)


def test_the_maximum_is_no_worse_than_both_starts_and_in_bounds() -> None:
    equations = _equations(TABLES["solved"])
    groups = [OutputGroup(np.arange(6), np.arange(len(equations)), np.zeros(len(equations)))]
    settings = KrigingSettings()
    result = maximise(equations, groups, settings=settings).logarithms
    reached = negative_log_likelihood(result, equations, groups)[0]
    for theta in settings.theta_starts:
        start = np.array([theta] * 6 + [settings.weight_start])
        assert reached <= negative_log_likelihood(start, equations, groups)[0]
    assert (result[:6] >= settings.theta_bounds[0] - 1e-12).all()
    assert (result <= np.array([settings.theta_bounds[1]] * 6 + [settings.weight_bounds[1]])).all()


def test_a_response_that_is_a_sum_over_axes_needs_no_full_kernel() -> None:
    equations = _equations(solved(SMOOTH, spread_wrenches(4, 12, 2)))
    groups = output_groups(equations, np.ones(6))
    assert maximise(equations, groups).weights[0] < 1e-2


def test_no_more_equations_estimate_than_the_limit_allows() -> None:
    few = KrigingSettings()
    sloped = _equations(solved(SMOOTH, spread_wrenches(20, 40, 3)))
    measured = _equations(table(SMOOTH, spread_wrenches(60, 60, 3)))
    for equations in (sloped, measured):
        chosen = spread_rows(equations, few.likelihood_equations)
        assert equations.take(chosen).count <= few.likelihood_equations
        assert len(np.unique(chosen)) == len(chosen)


def test_hyperparameters_are_their_logarithms() -> None:
    np.testing.assert_allclose(Hyperparameters.of_logarithms(PLACE).logarithms, PLACE, atol=1e-15)


def test_equations_and_scalings_are_equal_to_themselves_only():
    rows = TABLES["solved"]
    assert _equations(rows) != _equations(rows)
    assert scaling_of(rows, RANGE) != scaling_of(rows, RANGE)


def test_a_minimum_on_a_bound_of_many_decimals_is_within_it():
    def slope(place: np.ndarray, upwards: float, _: KrigingSettings) -> tuple[float, np.ndarray]:
        return upwards * float(place[0]), np.array([upwards])

    low, high = -1.23456, 1.23456  # three decimals of each are beyond it
    for upwards, end in ((1.0, low), (-1.0, high)):
        place, _ = minimised(slope, np.zeros(1), [(low, high)], KrigingSettings(), upwards)
        assert place.tolist() == [end]
