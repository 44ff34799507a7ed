"""Agreement with CalculiX on shipped meshes, and where it takes CalculiX minutes."""

import numpy as np
import pytest

from tests.fea import calculix as in_calculix
from tests.fea.tets import in_tets
from tests.validation import calculix
from tests.validation.calculix import same_mesh
from tests.validation.clamped import attached, shipped
from tests.validation.plate import WRENCH
from wrenchbook.fea.solve import Solver
from wrenchbook.fea.tensors import von_mises

pytestmark = pytest.mark.skipif(not calculix.installed(), reason=calculix.ABSENT)


def agrees(part, wrench):
    (finding,) = same_mesh("here", part, wrench, nonlinear=True)
    print(f"\n{finding.computed:.1e} apart, {len(part.mesh.points)} nodes")
    assert finding.tolerance == 1e-4
    assert finding.verdict == "pass", finding


def test_the_shipped_plate_nonlinear():
    agrees(attached(shipped("plate_thin"), coupling="rigid"), WRENCH)


def test_the_plate_cut_into_c3d10_nonlinear():
    agrees(attached(in_tets(shipped("plate_thin", cells=4, layers=1)), coupling="rigid"), WRENCH)


@pytest.mark.parametrize("load", [1.0, 10.0])
def test_the_shipped_spring_nonlinear(load):
    agrees(shipped("spring"), [0, 0, -load, 0, 0, 0])


@pytest.mark.parametrize("load", [1.0, 10.0])
def test_the_spring_cut_into_c3d10_nonlinear(load):
    agrees(in_tets(shipped("spring", cells_per_turn=8)), [0, 0, -load, 0, 0, 0])


def test_the_thin_plates_largest_stress_under_twenty_wrenches(tmp_path):
    """Of the whole load range, nonlinear, at the same integration points: some ten minutes."""
    part = attached(shipped("plate_thin"), coupling="rigid")
    loads, built, gaps = part.bundle.range, Solver(part), []
    for wrench in np.random.default_rng(20).uniform(loads.low, loads.high, (20, 6)):
        solution = built.solve(wrench)
        reported = in_calculix.conjugate(wrench, solution.displacement)
        theirs = von_mises(in_calculix.stresses(part, reported, tmp_path, nonlinear=True))
        result = built.fields(solution)
        assert von_mises(result.stress).argmax() == theirs.argmax()
        gaps.append(abs(result.largest / theirs.max() - 1.0))
        print(f"{result.largest / 1e6:8.2f} MPa, {gaps[-1]:.1e} off", flush=True)
    assert max(gaps) < 1e-4
