"""What the check says of mass and stresses under the full load range."""

from dataclasses import replace

import numpy as np
import pytest

from tests.fea.boxes import box
from tests.validation.clamped import clamped
from tests.validation.laminate import strip
from wrenchbook.fea.bundle.read import read_bundle
from wrenchbook.fea.bundle.shipped import SHIPPED
from wrenchbook.fea.check.trial import strength
from wrenchbook.fea.component import build
from wrenchbook.fea.solve import Solver
from wrenchbook.fea.spec.schema import DeclaredRange
from wrenchbook.fea.tensors import von_mises


def test_no_wrench_of_the_range_has_a_larger_stress():
    part = build(read_bundle(SHIPPED / "bar"))
    ((one,), _) = strength(Solver(part), nonlinear=False)
    loads = part.bundle.range
    assert set(one["wrench"]) <= {*loads.low, *loads.high}
    built = Solver(part)
    rng = np.random.default_rng(3)
    for wrench in rng.uniform(loads.low, loads.high, (20, 6)):
        assert von_mises(built.unit_stresses() @ wrench).max() <= one["largest"]
    ends = von_mises(built.unit_stresses() @ np.array(one["wrench"]))
    assert ends.max() == pytest.approx(one["largest"], rel=1e-12)


def rod(times=1.0, nonlinear=True):
    part = clamped(box("hex20", (2, 2, 4), (0.01, 0.01, 0.2)), "z0", "z1", (70e9, 0.3))
    high = times * np.array([20.0, 10.0, 100.0, 1.0, 1.0, 1.0])
    bundle = replace(part.bundle, range=DeclaredRange(-high, high))
    material = replace(part.materials[0], yield_strength=200e6)
    analysis = replace(part.analysis, nonlinear=nonlinear)
    return replace(part, bundle=bundle, materials=(material,), analysis=analysis)


def test_a_nonlinear_component_is_first_order_unless_it_is_solved():
    ((plain,), _) = strength(Solver(rod()), nonlinear=False)
    ((solved,), _) = strength(Solver(rod()), nonlinear=True)
    assert (plain["first_order"], solved["first_order"]) == (True, False)
    assert solved["wrench"] == plain["wrench"]
    assert solved["largest"] != plain["largest"]
    assert solved["largest"] == pytest.approx(plain["largest"], rel=0.1)
    built = Solver(rod())
    stress = built.fields(built.solve(solved["wrench"])).largest
    assert solved["largest"] == pytest.approx(stress, rel=1e-9)


def test_a_range_that_cannot_be_solved_stays_first_order_and_says_why():
    ((one,), warnings) = strength(Solver(rod(times=300.0)), nonlinear=True)
    assert one["first_order"]
    assert any("fails" in warning.message for warning in warnings)


def test_von_mises_says_little_of_an_orthotropic_material():
    part = strip((0, 90), (4, 1))
    loads = DeclaredRange(-np.ones(6), np.ones(6))
    materials = tuple(replace(one, yield_strength=1e12) for one in part.materials)
    part = replace(part, bundle=replace(part.bundle, range=loads), materials=materials)
    found, warnings = strength(Solver(part), nonlinear=False)
    assert len(found) == 2
    assert "a poor measure" in warnings[0].message
