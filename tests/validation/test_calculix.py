"""Agreement with CalculiX on the same mesh, to the digits it prints."""

import numpy as np
import pytest

from tests.fea import calculix
from tests.fea.boxes import box
from tests.fea.components import component
from wrenchbook.fea.solve import Solver
from wrenchbook.fea.tensors import spin_per_vector

pytestmark = pytest.mark.ccx

PRINTED = 1e-6  # CalculiX prints seven digits


@pytest.fixture(autouse=True)
def _ccx():
    calculix.require_ccx()


def saddle(kind="hex20", **changes):
    """A curved plate with its interface point off the section."""
    mesh = box(
        kind,
        (4, 3, 2),
        (0.4, 0.3, 0.02),
        warp=lambda p: p + np.outer((p[:, 0] - 0.1) ** 2 - p[:, 1] ** 2, [0, 0, 0.3]),
    )
    options = {"young": 70e9, "poisson": 0.33, "point": [0.41, 0.13, 0.05], **changes}
    return component(mesh, fixed="x0", section="x1", **options)


def gap(result, expected):
    return np.abs(result - expected).max() / np.abs(expected).max()


@pytest.mark.parametrize("kind", ["hex20", "tet10"])
def test_rigid_linear(kind, tmp_path):
    part = saddle(kind)
    wrench = [1000.0, 500, -800, 30, -20, 10]
    displacement, nodes = calculix.solve(part, wrench, tmp_path)
    result = Solver(part).solve(wrench)
    np.testing.assert_allclose(result.displacement, displacement, rtol=PRINTED)
    assert gap(result.nodes, nodes) < PRINTED


def test_distributed_linear(tmp_path):
    """CalculiX takes no moment at the reference node; forces off the centre bring their moments."""
    part = saddle(coupling="distributed")
    wrench = [1000.0, 500, -800, 0, 0, 0]
    _, nodes = calculix.solve(part, wrench, tmp_path)
    assert gap(Solver(part).solve(wrench).nodes, nodes) < PRINTED


@pytest.mark.parametrize("kind", ["hex20", "tet10"])
def test_rigid_nonlinear_with_moments_about_all_axes(kind, tmp_path):
    part = saddle(kind, nonlinear=True)
    wrench = np.array([2e4, 1e4, -2e4, 600, -1500, 900])
    result = Solver(part).solve(wrench)
    turn = result.displacement[3:]
    assert np.degrees(np.linalg.norm(turn)) > 3
    reported = wrench.copy()
    reported[3:] = spin_per_vector(turn).T @ wrench[3:]  # its moment works on the rotation vector
    displacement, nodes = calculix.solve(part, reported, tmp_path, nonlinear=True)
    np.testing.assert_allclose(result.displacement, displacement, rtol=1e-5)
    assert gap(result.nodes, nodes) < 1e-5


def test_rigid_nonlinear_with_a_guide(tmp_path):
    part = saddle(nonlinear=True, locked=("uy", "rx", "rz"))
    wrench = [5e3, 0, -2e4, 0, 500, 0]
    result = Solver(part).solve(wrench)
    displacement, nodes = calculix.solve(part, wrench, tmp_path, nonlinear=True)
    np.testing.assert_allclose(result.displacement, displacement, rtol=1e-5, atol=1e-14)
    assert gap(result.nodes, nodes) < 1e-5
