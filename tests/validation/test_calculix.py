"""Agreement with CalculiX on the same mesh, to the digits it prints."""

import numpy as np
import pytest

from tests.fea import calculix
from tests.fea.boxes import box
from tests.fea.components import component
from tests.validation.calculix import same_mesh
from tests.validation.clamped import attached, shipped
from tests.validation.plate import WRENCH
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


def gap(found, expected):
    return np.abs(found - expected).max() / np.abs(expected).max()


@pytest.mark.parametrize("kind", ["hex20", "tet10"])
def test_rigid_linear(kind, tmp_path):
    part = saddle(kind)
    wrench = [1000.0, 500, -800, 30, -20, 10]
    displacement, nodes = calculix.solve(part, wrench, tmp_path)
    found = Solver(part).solve(wrench)
    np.testing.assert_allclose(found.displacement, displacement, rtol=PRINTED)
    assert gap(found.nodes, nodes) < PRINTED


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
    found = Solver(part).solve(wrench)
    turn = found.displacement[3:]
    assert np.degrees(np.linalg.norm(turn)) > 3
    told = wrench.copy()
    told[3:] = spin_per_vector(turn).T @ wrench[3:]  # its moment works on the rotation vector
    displacement, nodes = calculix.solve(part, told, tmp_path, nonlinear=True)
    np.testing.assert_allclose(found.displacement, displacement, rtol=1e-5)
    assert gap(found.nodes, nodes) < 1e-5


def test_rigid_nonlinear_with_a_guide(tmp_path):
    part = saddle(nonlinear=True, locked=("uy", "rx", "rz"))
    wrench = [5e3, 0, -2e4, 0, 500, 0]
    found = Solver(part).solve(wrench)
    displacement, nodes = calculix.solve(part, wrench, tmp_path, nonlinear=True)
    np.testing.assert_allclose(found.displacement, displacement, rtol=1e-5, atol=1e-14)
    assert gap(found.nodes, nodes) < 1e-5


def plate():
    part = shipped("plate_thin", cells=2, rings=2, layers=1)
    return attached(part, coupling="rigid")


def spring():
    return shipped("spring", cells_per_turn=8)


def agrees(part, wrench, *, nonlinear):
    (finding,) = same_mesh("here", part, wrench, nonlinear=nonlinear)
    assert finding.tolerance == (1e-4 if nonlinear else 1e-5)
    assert finding.verdict == "pass", finding


@pytest.mark.parametrize("nonlinear", [False, True], ids=["linear", "nonlinear"])
def test_the_plate_with_a_rigid_coupling(nonlinear):
    agrees(plate(), WRENCH, nonlinear=nonlinear)


def test_the_plate_with_a_distributed_coupling_linear():
    agrees(attached(plate(), coupling="distributed"), WRENCH, nonlinear=False)


@pytest.mark.parametrize("load", [1.0, 10.0])
def test_the_spring_linear(load):
    agrees(spring(), [0, 0, -load, 0, 0, 0], nonlinear=False)


def test_the_spring_nonlinear():
    agrees(spring(), [0, 0, -1.0, 0, 0, 0], nonlinear=True)


def test_the_spring_without_its_guide_under_all_six_loads_linear():
    part = attached(spring(), locked=())
    agrees(part, [0.1, -0.1, -1.0, 1e-3, 2e-3, -1e-3], nonlinear=False)


@pytest.mark.exact("the digits that CalculiX prints are of one mesh: their error is the tolerance")
def test_the_spring_with_a_distributed_coupling_linear():
    """C3D20R only: the turn of a section of 1.4 mm is read from differences of printed numbers.

    CalculiX prints seven digits, which leave 5e-9 m over arms of half a millimetre: about 1e-5 of
    the turn.
    """
    part = attached(spring(), locked=(), coupling="distributed")
    agrees(part, [0.1, -0.1, -1.0, 1e-3, 2e-3, -1e-3], nonlinear=False)
