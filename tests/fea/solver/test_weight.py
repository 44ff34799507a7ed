"""Own weight: closed forms, equilibrium, CalculiX on the same mesh, the tangent."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from tests.fea.components import component
from tests.fea.two_interfaces import rod_between_loads
from wrenchbook.fea.bundle.read import BundleError, bundle_of, read_bundle
from wrenchbook.fea.check.trial import sag_per_gravity, weight_warnings
from wrenchbook.fea.component import build
from wrenchbook.fea.failure import SolveFailed
from wrenchbook.fea.mesh.generators import GENERATORS
from wrenchbook.fea.solve import Solver
from wrenchbook.fea.spec.material import Material
from wrenchbook.fea.spec.schema import Analysis, DeclaredTolerance

YOUNG, DENSITY, GRAVITY = 70e9, 2700.0, 9.81
LENGTH, SIDE = 1.0, 0.02
WRENCH = np.array([50.0, -20.0, 30.0, 2.0, -3.0, 1.0])


def bar(nonlinear=False, gravity=(0.0, 0.0, -GRAVITY), young=YOUNG, poisson=0.0, **how):
    size = {"length": LENGTH, "width": SIDE, "height": SIDE, "cells_along": 20}
    mesh = GENERATORS["bar"](**size).mesh()
    part = component(mesh, fixed="start", section="end", **how)
    return replace(
        part,
        materials=(Material("all", young, poisson, density=DENSITY),),
        analysis=Analysis(nonlinear=nonlinear, gravity=gravity),
    )


def gap(one, other):
    """Return the largest difference, translations and rotations each relative to the largest."""
    size = np.abs(other).reshape(2, 3).max(axis=1).repeat(3)
    return float((np.abs(one - other) / size).max())


@pytest.mark.parametrize("coupling", ["rigid", "distributed"])
def test_the_sag_is_the_work_of_the_weight_on_the_fields_of_unit_loads(coupling):
    turned = np.array([[0.0, 1.0, 0.0], [0.6, 0.0, 0.8], [0.8, 0.0, -0.6]])
    solver = Solver(bar(coupling=coupling, axes=turned, poisson=0.3))
    gravity = turned @ np.array([0.0, 0.0, -GRAVITY])
    expected = sag_per_gravity(solver) @ gravity
    assert gap(solver.linear.sag_displacement, expected) < 1e-9


def test_a_linear_answer_is_the_sag_and_the_compliance_times_the_wrench():
    solver = Solver(bar(poisson=0.3))
    result = solver.solve(WRENCH)
    expected = solver.linear.sag_displacement + solver.compliance @ WRENCH
    assert (result.displacement == expected).all()
    assert result.work == pytest.approx(result.strain_energy, rel=1e-9)


@pytest.mark.parametrize("nonlinear", [False, True])
@pytest.mark.parametrize("coupling", ["rigid", "distributed"])
def test_the_supports_carry_the_weight_and_the_wrench(coupling, nonlinear):
    solver = Solver(bar(nonlinear, coupling=coupling, poisson=0.3))
    result = solver.solve(WRENCH)
    if nonlinear:
        internal = solver.body.forces(result.nodes)[0]
    else:
        internal = solver.body.small_strain_forces(result.nodes[:, :, None])[:, :, 0]
    weight = DENSITY * LENGTH * SIDE**2 * GRAVITY
    carried = (internal - solver._system.weight)[solver.component.fixed_nodes].sum(axis=0)
    expected = -WRENCH[:3] + [0.0, 0.0, weight]
    assert carried == pytest.approx(expected, abs=1e-6 * np.abs(expected).max())


def table(**analysis):
    return {
        "name": "bar",
        "title": "Bar",
        "mesh": {"generator": "bar", "length": 1.0, "width": 0.02, "height": 0.02},
        "material": [{"region": "all", "youngs_modulus": 70e9, "poisson_ratio": 0.3}],
        "supports": {"fixed": ["start"]},
        "interface": {"section": "end", "coupling": "rigid"},
        "analysis": {"nonlinear": False, **analysis},
        "range": {"force": [100, 100, 100], "moment": [5, 5, 5]},
    }


def test_gravity_without_a_density_is_a_mistake_of_the_bundle(tmp_path):
    with pytest.raises(
        BundleError, match=r"material\[0\].density: is missing; \[analysis\] gravity"
    ):
        bundle_of(table(gravity=[0, 0, -9.81]), tmp_path)


def test_gravity_and_density_change_the_fingerprint_and_no_gravity_does_not(tmp_path):
    plain = bundle_of(table(), tmp_path).fingerprint
    assert bundle_of(table(gravity=[0, 0, 0]), tmp_path).fingerprint == plain
    created = {plain}
    for density, down in ((2700.0, -9.81), (2700.0, -1.62), (7800.0, -9.81)):
        own = table(gravity=[0, 0, down])
        own["material"][0]["density"] = density
        created.add(bundle_of(own, tmp_path).fingerprint)
        assert build(bundle_of(own, tmp_path)).analysis.gravity == (0.0, 0.0, down)
    assert len(created) == 4


def test_the_warning_of_self_weight_is_of_the_worst_of_two_interfaces(tmp_path):
    part = build(read_bundle(rod_between_loads(tmp_path)))
    bundle = replace(part.bundle, tolerance=DeclaredTolerance(1e-9, 1e-9))
    materials = (replace(part.materials[0], density=DENSITY),)
    part = replace(part, materials=materials, bundle=bundle)
    (warning,) = weight_warnings(Solver(part))
    sags = []
    for gravity in (GRAVITY * np.eye(3)).tolist():
        pulled = replace(part, analysis=Analysis(nonlinear=False, gravity=tuple(gravity)))
        sags.append(Solver(pulled).linear.sag_displacement)
    by_interface = np.array(sags).T.reshape(2, 6, 3)
    moved, turned = (
        max(np.linalg.norm(half, 2) for half in by_interface[:, rows])
        for rows in (slice(3), slice(3, 6))
    )
    assert f"by up to {moved:.2g} m and {turned:.2g} rad" in warning.message


def test_a_part_that_buckles_under_its_weight_alone_is_not_told_to_reduce_a_wrench():
    bending = YOUNG * SIDE**4 / 12
    critical = 7.837 * bending / (DENSITY * SIDE**2 * LENGTH**3)  # Greenhill 1881
    solver = Solver(bar(nonlinear=True, gravity=(-2 * critical, 0.0, 0.0)))
    text = "^Under self-weight alone, before any wrench, the part buckles at 0.5[^ ]* of its weight"
    with pytest.raises(SolveFailed) as caught:
        solver.solve(np.zeros(6))
    assert re.search(text, caught.value.message)
    assert caught.value.remedy.startswith("Correct gravity under [analysis]")
