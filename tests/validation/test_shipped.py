"""The shipped components against beam, rod and published theory."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.validation.clamped import attached
from wrenchbook.fea.bundle.read import read_bundle
from wrenchbook.fea.failure import SolveFailed
from wrenchbook.fea.solve import Solver

SHIPPED = Path(__file__).parents[2] / "data" / "components"


@pytest.fixture(scope="module")
def spring():
    return Solver(read_bundle(SHIPPED / "spring"))


def test_the_spring_without_its_guide_tips_over_by_name(spring):
    free = Solver(attached(spring.component, locked=()))
    with pytest.raises(SolveFailed) as caught:
        free.solve([0, 0, -10, 0, 0, 0])
    assert caught.value.kind in {"rotation_too_large", "snap_through"}


def test_the_spring_at_ten_newtons_takes_a_few_iterations(spring):
    """How long they take is in the benchmarks."""
    result = spring.solve([0, 0, -10, 0, 0, 0])
    assert len(result.history) <= 10
    assert result.unknowns > 10_000
    assert (result.displacement[[0, 1, 3, 4]] == 0).all()


@pytest.mark.parametrize("name", ["bar", "plate", "plate_thin", "spring", "link", "hot_bracket"])
def test_every_shipped_compliance_is_symmetric_positive_and_energetic(name):
    built = Solver(read_bundle(SHIPPED / name))
    assert built.linear.asymmetry < 1e-9
    assert built.linear.energy_gap < 1e-9
    active = built.component.active
    compliance = built.compliance[np.ix_(active, active)]
    scale = 1 / np.sqrt(np.diagonal(compliance))
    assert np.linalg.eigvalsh(compliance * np.outer(scale, scale)).min() > 0


def test_the_plates_corners_of_the_load_range_converge_in_one_load_step():
    for name in ("plate", "plate_thin"):
        bundle = read_bundle(SHIPPED / name)
        built = Solver(bundle)
        for signs in ([1, 1, 1, 1, 1, 1], [1, -1, -1, 1, -1, 1], [-1, 1, -1, -1, -1, -1]):
            result = built.solve(np.array(signs) * bundle.range.high)
            assert {step.load_factor for step in result.history} == {1.0}, name
            assert len(result.history) <= 10


def test_the_thick_plate_is_nearly_twice_as_soft_distributed_as_rigid():
    bundle = read_bundle(SHIPPED / "plate")
    interface = replace(bundle.interface, coupling="rigid")
    soft = Solver(bundle).compliance[2, 2]
    stiff = Solver(replace(bundle, interface=interface)).compliance[2, 2]
    assert soft / stiff == pytest.approx(1.9, abs=0.1)
