"""Moments by the rotation vector they work on, and tangents by them."""

from collections.abc import Callable

import numpy as np
import pytest

from tests.surrogate.tables.write import HERE
from wrenchbook.fea.tensors import spin_per_vector, spin_slope
from wrenchbook.surrogate.table.second_derivatives import moment_map, symmetric_tangents
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
        found, y = q.copy(), moved(q)
        for first in range(3, outputs, 6):
            own = slice(first, first + 3)
            found[own] = np.linalg.solve(spin_per_vector(y[own]).T, q[own])
        return found

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
    found = symmetric_tangents(wrench[None], moved[None], tangent[None], space)[0]
    assert found == pytest.approx(expected, abs=1e-9)


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
    found, expected = (
        symmetric_tangents(one[None], moved[None], tangent[None], DEFAULT)
        for one in (wrench, without)
    )
    assert found.tobytes() == expected.tobytes()
    assert not found[0, 3].any()
    assert not found[0, :, 3].any()


def test_a_tangent_without_a_counterpart_by_the_loads_is_not_a_number() -> None:
    # M = (0, 0, 2) turns r_y = 1 rad per N·m of M_x into -1 N·m of mu_x: no mu_x is left.
    wrench, tangent = np.zeros((1, 6)), np.zeros((1, 6, 6))
    wrench[0, 5], tangent[0, 4, 3], tangent[0, 5, 5] = 2.0, 1.0, 1.0
    assert np.isnan(symmetric_tangents(wrench, np.zeros((1, 6)), tangent, DEFAULT)).all()


def test_an_unknown_tangent_stays_unknown() -> None:
    wrench, moved, tangent, _ = response(DEFAULT)
    found = symmetric_tangents(
        np.array([wrench] * 2),
        np.array([moved] * 2),
        np.array([tangent, np.nan * tangent]),
        DEFAULT,
    )
    assert np.isfinite(found[0]).all()
    assert np.isnan(found[1]).all()
