"""Orthotropic and neo-Hookean components against CalculiX and classical laminate theory."""

from dataclasses import replace

import numpy as np
import pytest

from tests.fea.calculix import require_ccx
from tests.validation import calculix, laminate
from tests.validation.calculix import worst_gap
from tests.validation.clamped import attached
from tests.validation.finding import CASES
from tests.validation.materials import SQUEEZE, rubber_block
from wrenchbook.fea.solve import Solver


def findings(name):
    (one,) = [item for item in CASES if item.check.__name__ == name]
    return list(one.check())


def test_laminated_strips_are_as_stiff_as_classical_laminate_theory_says():
    results = findings("laminated_strips")
    assert len(results) == 7
    assert [result.verdict for result in results] == ["pass"] * 7, results
    coupled = [result for result in results if "u_x/M_y" in result.quantity]
    assert coupled[0].reference > 1e-3  # [0/90] stretches when bent


def test_a_laminate_of_one_angle_is_the_ply_itself():
    one = laminate.stiffness((30,))
    two = laminate.stiffness((30, 30))
    np.testing.assert_allclose(two[:3, :3], 2 * one[:3, :3])
    np.testing.assert_allclose(two[3:, 3:], 8 * one[3:, 3:])
    assert np.abs(two[:3, 3:]).max() < 1e-6 * np.abs(two).max()


@pytest.mark.ccx
@pytest.mark.parametrize(
    "name", ["orthotropic_same_mesh", "rubber_same_mesh", "wound_tube_same_mesh"]
)
def test_calculix_finds_the_same_on_the_same_mesh(name):
    require_ccx()
    results = findings(name)
    assert [result.tolerance for result in results] == [1e-5, 1e-4] * (len(results) // 2)
    assert {result.verdict for result in results} == {"pass"}, results


@pytest.mark.ccx
def test_rubber_at_0_4999_is_calculixs_where_neither_projects():
    """C3D20R projects nothing: the same cells of ours without their pressure are the same law."""
    require_ccx()
    part = rubber_block("hex20", 0.49)
    part = replace(part, analysis=replace(part.analysis, nonlinear=True))
    nearly = replace(part.materials[0], poisson_ratio=0.4999)
    shear = 3e6 / (2 * 1.4999)
    solver = Solver(part)
    cells = solver._system.body.parts
    lame = 2 * shear * 0.4999 / (1 - 2 * 0.4999), shear
    cells[:] = [
        replace(own, volume_modes=None, first_lame=np.full(8, lame[0]), shear=np.full(8, lame[1]))
        for own in cells
    ]
    wrench = 0.3 * np.array(SQUEEZE)
    result = solver.solve(wrench).displacement
    reply = calculix.solve_rigid(replace(part, materials=(nearly,)), wrench, result[3:])
    assert worst_gap(result, reply.displacement) < 1e-4


def test_rubber_at_0_4999_keeps_its_volume_and_does_not_lock():
    """Two meshes of hex27 apart by what the bonded corners are; five iterations, not ninety."""
    squeezed = [300.0, 0.0, -1200.0, 0.0, 0.0, 0.0]
    results = []
    for divisions in ((2, 2, 2), (3, 3, 3)):
        part = rubber_block("hex27", 0.4999, divisions)
        part = replace(part, analysis=replace(part.analysis, nonlinear=True))
        part = attached(part, locked=("rx", "ry", "rz"))
        solution = Solver(part).solve(squeezed)
        assert len(solution.history) <= 8
        assert solution.displacement[0] > 4e-3
        results.append(solution.displacement[[0, 2]])
    assert np.abs(results[0] / results[1] - 1).max() < 0.02


@pytest.mark.parametrize("law", ["orthotropic", "neo-hookean"])
def test_nonlinear_answers_of_small_loads_are_the_linear_ones(law):
    part = rubber_block("hex20", 0.3) if law == "neo-hookean" else laminate.strip((0, 90), (4, 1))
    linear = Solver(part)
    wrench = 1e-5 * np.array(SQUEEZE) / (1 if law == "neo-hookean" else 1e4)
    bent = Solver(replace(part, analysis=replace(part.analysis, nonlinear=True))).solve(wrench)
    right = linear.compliance @ wrench
    np.testing.assert_allclose(bent.displacement, right, atol=1e-5 * np.abs(right).max())
    np.testing.assert_allclose(
        bent.compliance, linear.compliance, atol=1e-4 * np.abs(linear.compliance).max()
    )
