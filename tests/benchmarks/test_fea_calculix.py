"""Agreement with CalculiX on shipped meshes, and where it takes CalculiX minutes."""

from dataclasses import replace

import pytest

from fea.validation import calculix
from fea.validation.clamped import shipped
from fea.validation.plate import WRENCH
from fea.validation.samemesh import same_mesh
from tests.fea.tets import in_tets

pytestmark = pytest.mark.skipif(not calculix.installed(), reason=calculix.ABSENT)


def agrees(part, wrench):
    (finding,) = same_mesh("here", part, wrench, nonlinear=True)
    print(f"\n{finding.computed:.1e} apart, {len(part.mesh.points)} nodes")
    assert finding.tolerance == 1e-4
    assert finding.verdict == "pass", finding


def test_the_shipped_plate_nonlinear():
    agrees(replace(shipped("plate_thin"), coupling="rigid"), WRENCH)


def test_the_plate_cut_into_c3d10_nonlinear():
    agrees(replace(in_tets(shipped("plate_thin", cells=4, layers=1)), coupling="rigid"), WRENCH)


@pytest.mark.parametrize("load", [1.0, 10.0])
def test_the_shipped_spring_nonlinear(load):
    agrees(shipped("spring"), [0, 0, -load, 0, 0, 0])


@pytest.mark.parametrize("load", [1.0, 10.0])
def test_the_spring_cut_into_c3d10_nonlinear(load):
    agrees(in_tets(shipped("spring", cells_per_turn=8)), [0, 0, -load, 0, 0, 0])
