"""What is over a tolerance by the solver's own error, in words that say what to do."""

import numpy as np
import pytest

from wrenchbook.fea.accuracy.advice import over_tolerance

MESH = np.diag([0.0, 0.0, 4e-6, 0.0, 1e-5, 0.0]).tolist()
TOLD = {"mesh": MESH, "loads": [1.0, 1.0, 100.0, 1.0, 1.0, 1.0], "cell_size": 0.008}


def test_a_mesh_within_the_tolerance_is_not_mentioned():
    assert over_tolerance(TOLD, 4.1e-4, 1.1e-5) == []
    assert over_tolerance(None, 1e-9, 1e-9) == []
    assert over_tolerance({"mesh": None, "loads": [1.0] * 6}, 1e-9, 1e-9) == []


def test_a_mesh_over_the_tolerance_is_told_with_its_worst_output_and_the_size_that_mends_it():
    (one,) = over_tolerance(TOLD, 1e-4, 1.0)
    assert "0.0004 m in uz, 4 times the tolerance" in one.message
    assert "cells about 2 times smaller, about 4 mm each" in one.message


def test_cells_that_are_all_but_fine_enough_are_never_told_to_stay_as_they_are():
    (one,) = over_tolerance(TOLD, 3.7e-4, 1.0)
    assert "cells about 1.1 times smaller" in one.message


def test_no_mesh_of_a_thousandth_is_advised():
    (one,) = over_tolerance(TOLD, 1e-9, 1.0)
    assert "much smaller" in one.message


def test_linearity_over_the_tolerance_advises_nonlinear_solves():
    (one,) = over_tolerance(TOLD | {"linearity": [0.1] * 6}, 1e-3, 1.0)
    assert "nonlinear = true" in one.message


@pytest.mark.parametrize(("factor", "count"), [(None, 0), (1.5, 0), (0.00108, 1)])
def test_a_range_beyond_buckling_is_told(factor, count):
    found = over_tolerance(TOLD | {"buckling": factor}, 1.0, 1.0)
    assert len(found) == count
    assert all("buckles at 0.00108" in one.message for one in found)
