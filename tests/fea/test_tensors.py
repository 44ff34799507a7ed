"""Rotation vectors and spins."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from wrenchbook.fea.tensors import (
    rotation,
    rotation_derivatives,
    rotation_less_identity,
    rotation_vector,
    spin_per_vector,
    spin_slope,
)

VECTORS = [[0.0, 0.0, 0.0], [1e-9, -2e-9, 3e-10], [0.3, -0.2, 0.1], [0.9, 1.1, -0.6], [0, 3.0, 0]]


@pytest.mark.parametrize("vector", VECTORS)
def test_the_exponential_map_is_scipys_and_its_logarithm_leads_back(vector):
    vector = np.array(vector)
    expected = Rotation.from_rotvec(vector).as_matrix()
    np.testing.assert_allclose(rotation(vector), expected, atol=1e-15)
    np.testing.assert_allclose(rotation_vector(rotation(vector)), vector, rtol=1e-12, atol=1e-16)


def test_a_tiny_rotation_keeps_its_digits():
    vector = np.array([1e-20, 2e-20, -3e-20])
    turn = rotation_less_identity(vector)
    np.testing.assert_allclose([turn[2, 1], turn[0, 2], turn[1, 0]], vector, rtol=1e-15)


@pytest.mark.parametrize("vector", VECTORS)
def test_the_left_jacobian_gives_the_spin_of_a_change(vector):
    vector, step = np.array(vector), 1e-6
    for axis in range(3):
        change = step * np.eye(3)[axis]
        spin = rotation_vector(rotation(vector + change) @ rotation(vector - change).T) / (2 * step)
        np.testing.assert_allclose(spin_per_vector(vector)[:, axis], spin, atol=2e-9)


@pytest.mark.parametrize("vector", VECTORS)
def test_the_slope_of_the_transposed_jacobian_matches_finite_differences(vector):
    vector, moment, step = np.array(vector), np.array([0.4, -1.3, 2.2]), 1e-6
    slope = spin_slope(vector, moment)
    for axis in range(3):
        change = step * np.eye(3)[axis]
        ahead, behind = (spin_per_vector(vector + s * change).T @ moment for s in (1, -1))
        np.testing.assert_allclose(slope[:, axis], (ahead - behind) / (2 * step), atol=1e-9)


@pytest.mark.parametrize("vector", VECTORS)
def test_the_derivatives_of_a_rotation_are_those_of_its_differences(vector):
    step, vector = 1e-4, np.array(vector, dtype=float)
    own = rotation_derivatives(vector)
    np.testing.assert_allclose(own[0], rotation(vector), atol=1e-14)
    for axis in range(3):
        ends = [rotation_derivatives(vector + sign * step * np.eye(3)[axis]) for sign in (1, -1)]
        for order in range(3):
            difference = (ends[0][order] - ends[1][order]) / (2 * step)
            np.testing.assert_allclose(own[order + 1][axis], difference, atol=1e-8)
