"""Rows that bring second derivatives: what the kriging makes of them."""

import numpy as np
import pytest

from tests.surrogate.energies import PARTS, Part, part
from tests.surrogate.responses import HIGH
from wrenchbook.surrogate.build import build
from wrenchbook.surrogate.kriging import Kriging, KrigingSettings
from wrenchbook.surrogate.packed.writer import packed_of
from wrenchbook.surrogate.table.rows import LoadRange, Rows
from wrenchbook.surrogate.table.second_derivatives import second_derivatives

RANGE = LoadRange(-1.1 * HIGH, 1.1 * HIGH)
SEED = 20261125


def places(count: int, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-1, 1, (count, 6))


def error(kriging: Kriging, truth: Rows) -> np.ndarray:
    """Return the RMS errors of the outputs over their ranges."""
    found = kriging.answer_many(truth.wrench)[0] - truth.displacement
    return np.sqrt((found**2).mean(axis=0)) / np.ptp(truth.displacement, axis=0)


@pytest.fixture(scope="module")
def stiffening() -> Part:
    return part(PARTS["stiffening"], 1)


def test_made_up_rows_are_consistent(stiffening: Part) -> None:
    """Tangents and second derivatives by (F, M) are differences along rows of nearby loads."""
    at, step = places(4, 1), 1e-4
    rows = stiffening.rows(at)
    found = second_derivatives(
        rows.wrench, rows.displacement, rows.compliance, rows.curvature, rows.space
    )
    for way in step * np.eye(6):
        ahead, behind = stiffening.rows(at + way), stiffening.rows(at - way)
        change = ahead.wrench - behind.wrench
        moved = np.einsum("noa,na->no", rows.compliance, change)
        np.testing.assert_allclose(
            moved, ahead.displacement - behind.displacement, rtol=1e-5, atol=1e-10
        )
        bent = np.einsum("noab,nb->noa", found, change)
        size = np.abs(rows.compliance).max()
        np.testing.assert_allclose(
            bent / size, (ahead.compliance - behind.compliance) / size, atol=1e-7
        )


def test_answers_at_rows_have_their_values_slopes_and_second_derivatives(stiffening: Part) -> None:
    rows = stiffening.rows(places(10, 2))
    kriging = Kriging.build(rows, RANGE)
    spread = rows.displacement.std(axis=0)
    values, _ = kriging.answer_many(rows.wrench)
    np.testing.assert_allclose(values / spread, rows.displacement / spread, atol=1e-7)
    packed = packed_of(build(rows, RANGE))

    def slopes_at(wrenches: np.ndarray) -> np.ndarray:
        return packed.derivatives(wrenches, method="kriging", without_rows=True)

    slopes = slopes_at(rows.wrench) * HIGH / spread[:, None]
    np.testing.assert_allclose(slopes, rows.compliance * HIGH / spread[:, None], atol=1e-5)
    step = 1e-3
    found = second_derivatives(
        rows.wrench, rows.displacement, rows.compliance, rows.curvature, rows.space
    )
    for load, way in enumerate(step * np.diag(HIGH)):
        ends = (slopes_at(rows.wrench + sign * way) for sign in (1, -1))
        bent = np.subtract(*ends) / (2 * step) * HIGH / spread[:, None]
        expected = found[..., load] * HIGH[load] * HIGH / spread[:, None]
        np.testing.assert_allclose(bent, expected, atol=2e-3)


@pytest.mark.parametrize("name", PARTS)
@pytest.mark.parametrize("count", [6, 15, 30])
def test_second_derivatives_lower_the_error(name: str, count: int) -> None:
    own = part(PARTS[name], 4)
    at = places(count, count)
    truth = own.rows(places(200, 99), second=False)
    without = error(Kriging.build(own.rows(at, second=False), RANGE), truth)
    found = error(Kriging.build(own.rows(at), RANGE), truth)
    assert np.median(found) < 0.85 * np.median(without)


@pytest.mark.parametrize("name", ["stiffening", "saturating", "waving"])
@pytest.mark.parametrize("count", [15, 30])
def test_error_bars_hold(name: str, count: int) -> None:
    inside, ratio = [], []
    for seed in range(4):
        own = part(PARTS[name], SEED + seed)
        truth = own.rows(places(200, SEED + seed), second=False)
        kriging = Kriging.build(own.rows(places(count, SEED - seed)), RANGE)
        values, bars = kriging.answer_many(truth.wrench)
        known = np.isfinite(bars).all(axis=1)
        assert known.mean() > 0.8
        missed = np.abs(values - truth.displacement)[known]
        inside.append((missed <= bars[known]).mean(axis=0))
        ratio.append(np.median(bars[known], axis=0) / np.median(missed, axis=0))
    assert np.mean(inside) >= 0.9
    assert np.median(ratio) <= 10


def test_rows_with_and_without_second_derivatives_stand_in_one_table(stiffening: Part) -> None:
    at = places(20, 3)
    truth = stiffening.rows(places(200, 98), second=False)
    mixed = stiffening.rows(at[:8]) + stiffening.rows(at[8:], second=False)
    found = [
        np.median(error(Kriging.build(rows, RANGE), truth))
        for rows in (stiffening.rows(at), mixed, stiffening.rows(at, second=False))
    ]
    assert found[0] < found[1] < found[2]


def test_beyond_one_factor_rows_far_apart_keep_their_second_derivatives(stiffening: Part) -> None:
    close = np.clip(places(6, 6) * 0.01, -1, 1)
    rows = stiffening.rows(np.concatenate((places(8, 5), close)))
    settings = KrigingSettings(dense_equations=14 * 7 + 9 * 21)
    equations = Kriging.build(rows, RANGE, settings).equations
    assert equations.count <= settings.dense_equations
    bent = np.asarray(equations.known[:, 7:].any(axis=1))
    assert bent.sum() == 9
    near_zero = np.abs(equations.x).max(axis=1) < 0.05
    assert bent[~near_zero].all()


def test_a_table_without_second_derivatives_has_the_covariance_of_before() -> None:
    own = part(PARTS["stiffening"], 2)
    plain = Kriging.build(own.rows(places(8, 1), second=False), RANGE).hyperparameters
    assert (plain.smoothness, len(plain.weights)) == (3, 1)
    bent = Kriging.build(own.rows(places(8, 1)), RANGE).hyperparameters
    assert (bent.smoothness, len(bent.weights)) == (4, 4)
