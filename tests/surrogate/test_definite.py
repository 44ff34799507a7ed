"""Whether a compliance is positive definite, and in which direction it is not."""

from __future__ import annotations

import numpy as np

from wrenchbook.surrogate.table.spread import weakest


def test_the_direction_against_which_a_part_moves_is_found_whatever_the_units():
    scale = np.array([1000.0, 0.01])
    least, loads = weakest(np.array([[[1.0, 2.0], [2.0, 1.0]]]) / np.outer(scale, scale), scale)
    np.testing.assert_allclose(least, [-1.0])
    np.testing.assert_allclose(loads[0] / loads[0, 0], [1.0, -1.0])


def test_an_elastic_part_and_one_with_a_stiff_freedom_are_not_indefinite():
    matrices = np.array([np.diag([1.0, 1e-9]), np.diag([1.0, 0.0]), np.diag([1.0, -1e-30])])
    assert (weakest(matrices, np.ones(2))[0] >= 0.0).all()


def test_an_unknown_compliance_has_no_eigenvalue():
    least, _ = weakest(np.array([np.eye(2), np.full((2, 2), np.nan)]), np.ones(2))
    assert np.isfinite(least).tolist() == [True, False]
