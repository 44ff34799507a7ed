"""Moments by the rotation vector they work on, and tangents by them."""

from collections.abc import Callable

import numpy as np
import pytest

from tests.slow import slow
from tests.surrogate.energies import PARTS, Part, part
from tests.surrogate.responses import HIGH
from tests.surrogate.tables.write import HERE
from wrenchbook.fea.tensors import spin_per_vector, spin_slope
from wrenchbook.surrogate.build import build
from wrenchbook.surrogate.kriging import Kriging, KrigingSettings
from wrenchbook.surrogate.packed.writer import packed_of
from wrenchbook.surrogate.table.rows import LoadRange, Rows
from wrenchbook.surrogate.table.second_derivatives import (
    moment_map,
    second_derivatives,
    symmetric_tangents,
)
from wrenchbook.surrogate.table.space import DEFAULT, Floats, Input, Space, space_of

RNG = np.random.default_rng(23)
AXES = RNG.normal(size=(5, 3))
ROTATIONS = AXES / np.linalg.norm(AXES, axis=1)[:, None] * np.radians([0, 1, 5, 12, 20])[:, None]
MOMENTS = RNG.normal(size=(5, 3))
TWO_AND_HEAT = space_of(("left", "right"), (Input("temperature", "K", "scalar"),))


def differences(function: Callable[[Floats], Floats], at: Floats, step: float = 1e-5) -> Floats:
    """Return central differences by each entry of the last axis, which is appended."""
    steps = step * np.eye(at.shape[-1])
    return np.stack([(function(at + h) - function(at - h)) / (2 * step) for h in steps], axis=-1)


def response(space: Space) -> tuple[Floats, Floats, Floats, Floats]:
    """Return wrench, displacement, tangent by (F, M) and tangent by q of a made-up energy.

    Its gradient by the loads q is a q + (b q)^2 b^T / 2, of up to 15 degrees.
    """
    inputs, outputs = len(space.inputs), len(space.outputs)
    q = RNG.normal(size=inputs)
    root, b = RNG.normal(size=(inputs, inputs)), RNG.normal(size=inputs) / 50
    a = root @ root.T / 300

    def moved(q: Floats) -> Floats:
        return (a @ q + (b @ q) ** 2 * b / 2)[:outputs]

    def wrench(q: Floats) -> Floats:
        result, y = q.copy(), moved(q)
        for first in range(3, outputs, 6):
            own = slice(first, first + 3)
            result[own] = np.linalg.solve(spin_per_vector(y[own]).T, q[own])
        return result

    by_q = (a + (b @ q) * np.outer(b, b))[:outputs]
    return wrench(q), moved(q), by_q @ np.linalg.inv(differences(wrench, q)), by_q


def test_the_moment_by_the_rotation_vector_is_that_of_the_solver() -> None:
    expected = [spin_per_vector(r).T @ m for r, m in zip(ROTATIONS, MOMENTS, strict=True)]
    assert moment_map(ROTATIONS, MOMENTS).value == pytest.approx(np.array(expected), abs=1e-15)


def test_its_slope_is_that_of_the_solver() -> None:
    expected = [spin_slope(r, m) for r, m in zip(ROTATIONS, MOMENTS, strict=True)]
    assert moment_map(ROTATIONS, MOMENTS).by_rotation == pytest.approx(
        np.array(expected), abs=2e-15
    )


def test_its_second_derivative_is_that_of_differences_of_the_slope() -> None:
    expected = differences(lambda r: moment_map(r, MOMENTS).by_rotation, ROTATIONS)
    assert moment_map(ROTATIONS, MOMENTS).second == pytest.approx(expected, abs=1e-10)


def test_unit_moments_give_the_columns_of_the_transposed_jacobian() -> None:
    units = moment_map(ROTATIONS[:, None], np.eye(3))
    parts = np.einsum("nkiab,nk->niab", units.second, MOMENTS)
    assert moment_map(ROTATIONS, MOMENTS).second == pytest.approx(parts, abs=1e-15)


@pytest.mark.parametrize("space", [DEFAULT, TWO_AND_HEAT], ids=["one interface", "two and heat"])
def test_a_tangent_by_force_and_moment_becomes_that_by_the_loads_of_an_energy(space: Space) -> None:
    wrench, moved, tangent, expected = response(space)
    result = symmetric_tangents(wrench[None], moved[None], tangent[None], space)[0]
    assert result == pytest.approx(expected, abs=1e-9)


def test_solved_tangents_become_symmetric() -> None:
    with np.load(HERE / "plate_thin.npz") as known:
        tangents, size = known["compliance"], np.abs(known["high"])
        wrench, moved = (known[name][: len(tangents)] for name in ("wrench", "displacement"))
    energies = symmetric_tangents(wrench, moved, tangents, DEFAULT) * size[:, None] * size
    apart = np.abs(energies - np.swapaxes(energies, 1, 2)).max(axis=(1, 2))
    assert (apart / np.abs(energies).max(axis=(1, 2))).max() < 1e-8  # 4e-3 by (F, M)


def test_a_load_on_a_locked_freedom_takes_no_part() -> None:
    wrench, moved, tangent, _ = response(DEFAULT)
    tangent[3], tangent[:, 3], moved[3] = 0.0, 0.0, 0.0
    without = np.where(np.arange(6) == 3, 0.0, wrench)
    result, expected = (
        symmetric_tangents(item[None], moved[None], tangent[None], DEFAULT)
        for item in (wrench, without)
    )
    assert result.tobytes() == expected.tobytes()
    assert not result[0, 3].any()
    assert not result[0, :, 3].any()


def test_a_tangent_without_a_counterpart_by_the_loads_is_not_a_number() -> None:
    # M = (0, 0, 2) turns r_y = 1 rad per N·m of M_x into -1 N·m of mu_x: no mu_x is left.
    wrench, tangent = np.zeros((1, 6)), np.zeros((1, 6, 6))
    wrench[0, 5], tangent[0, 4, 3], tangent[0, 5, 5] = 2.0, 1.0, 1.0
    assert np.isnan(symmetric_tangents(wrench, np.zeros((1, 6)), tangent, DEFAULT)).all()


def test_an_unknown_tangent_stays_unknown() -> None:
    wrench, moved, tangent, _ = response(DEFAULT)
    result = symmetric_tangents(
        np.array([wrench] * 2),
        np.array([moved] * 2),
        np.array([tangent, np.nan * tangent]),
        DEFAULT,
    )
    assert np.isfinite(result[0]).all()
    assert np.isnan(result[1]).all()


RANGE = LoadRange(-1.1 * HIGH, 1.1 * HIGH)
SEED = 20261125


def places(count: int, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-1, 1, (count, 6))


def error(kriging: Kriging, truth: Rows) -> np.ndarray:
    """Return the RMS errors of the outputs over their ranges."""
    result = kriging.answer_many(truth.wrench)[0] - truth.displacement
    return np.sqrt((result**2).mean(axis=0)) / np.ptp(truth.displacement, axis=0)


@pytest.fixture(scope="module")
def stiffening() -> Part:
    return part(PARTS["stiffening"], 1)


def test_made_up_rows_are_consistent(stiffening: Part) -> None:
    """Tangents and second derivatives by (F, M) are differences along rows of nearby loads."""
    at, step = places(4, 1), 1e-4
    rows = stiffening.rows(at)
    result = second_derivatives(
        rows.wrench, rows.displacement, rows.compliance, rows.curvature, rows.space
    )
    for way in step * np.eye(6):
        ahead, behind = stiffening.rows(at + way), stiffening.rows(at - way)
        change = ahead.wrench - behind.wrench
        moved = np.einsum("noa,na->no", rows.compliance, change)
        np.testing.assert_allclose(
            moved, ahead.displacement - behind.displacement, rtol=1e-5, atol=1e-10
        )
        bent = np.einsum("noab,nb->noa", result, change)
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
    result = second_derivatives(
        rows.wrench, rows.displacement, rows.compliance, rows.curvature, rows.space
    )
    for load, way in enumerate(step * np.diag(HIGH)):
        ends = (slopes_at(rows.wrench + sign * way) for sign in (1, -1))
        bent = np.subtract(*ends) / (2 * step) * HIGH / spread[:, None]
        expected = result[..., load] * HIGH[load] * HIGH / spread[:, None]
        np.testing.assert_allclose(bent, expected, atol=2e-3)


@pytest.mark.parametrize("name", PARTS)
@pytest.mark.parametrize("count", [6, slow(15), slow(30)])
def test_second_derivatives_lower_the_error(name: str, count: int) -> None:
    own = part(PARTS[name], 4)
    at = places(count, count)
    truth = own.rows(places(200, 99), second=False)
    without = error(Kriging.build(own.rows(at, second=False), RANGE), truth)
    result = error(Kriging.build(own.rows(at), RANGE), truth)
    assert np.median(result) < 0.85 * np.median(without)


@pytest.mark.parametrize("name", ["stiffening", slow("saturating"), slow("waving")])
@pytest.mark.parametrize("count", [15, slow(30)])
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
    result = [
        np.median(error(Kriging.build(rows, RANGE), truth))
        for rows in (stiffening.rows(at), mixed, stiffening.rows(at, second=False))
    ]
    assert result[0] < result[1] < result[2]


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
