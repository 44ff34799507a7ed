"""The condition of the equations: estimated, told, and named where it leaves no digits."""

from dataclasses import replace

import numpy as np
import pytest

from tests.fea.boxes import box
from tests.fea.components import component
from tests.fea.linalg.test_multifrontal import body_of, clamped, matrix_of
from wrenchbook.fea.failure import SolveFailed
from wrenchbook.fea.solve import Solver
from wrenchbook.fea.spec.material import Material


@pytest.mark.parametrize("thickness", [1.0, 0.1, 0.01])
def test_the_condition_is_estimated_within_a_factor_of_ten(thickness):
    part = component(box("hex20", (4, 2, 2), (1.0, 1.0, thickness)), fixed="x0", section="x1")
    system = Solver(part)._system
    matrix = matrix_of(system.body, system.undeformed.tangent).toarray()
    scale = 1.0 / np.sqrt(np.diagonal(matrix))
    exact = np.linalg.cond(matrix * scale[:, None] * scale, 1)
    assert 0.3 * exact < system.condition < 10 * exact


def test_no_estimate_depends_on_units_or_stiffness():
    conditions = [
        Solver(component(box("hex20", (3, 2, 2), (s, s, s)), young=young))._system.condition
        for s, young in ((1.0, 210e9), (1e-3, 1e6))
    ]
    assert conditions[0] == pytest.approx(conditions[1], rel=1e-6)


def thin(ratio, **options):
    mesh = box("hex20", (10, 10, 2), (1.0, 1.0, 1.0 / ratio))
    options = {"fixed": "x0", "section": "x1", "coupling": "distributed", **options}
    return component(mesh, **options)


def test_a_thin_plate_is_corrected_and_says_so():
    solution = Solver(thin(1000)).solve([0, 0, 1e-6, 0, 0, 0])
    shape, condition = solution.notes
    assert "long and thin" in shape
    assert "Scaled condition about 6e+14" in condition
    assert Solver(thin(10)).solve([0, 0, 1, 0, 0, 0]).notes == ()
    assert Solver(thin(1000, nonlinear=True)).solve([0, 0, 1e-6, 0, 0, 0]).notes == solution.notes


@pytest.mark.parametrize("nonlinear", [False, True])
@pytest.mark.parametrize("coupling", ["rigid", "distributed"])
def test_a_foil_beyond_all_digits_is_ill_conditioned_and_no_mechanism(coupling, nonlinear):
    part = thin(1e5, coupling=coupling, nonlinear=nonlinear)
    with pytest.raises(SolveFailed) as caught:
        Solver(part).solve([0, 0, 1e-9, 0, 0, 0])
    assert caught.value.kind == "ill_conditioned"
    assert "roundoff" in caught.value.message
    assert "slenderness" in caught.value.remedy


@pytest.mark.parametrize("coupling", ["rigid", "distributed"])
@pytest.mark.parametrize("held", ["nothing", "a point", "a line"])
def test_too_few_supports_are_a_mechanism_and_not_ill_conditioned(coupling, held):
    part = component(box("hex20", (2, 2, 3)), coupling=coupling)
    low = part.mesh.points < 1e-9
    nodes = {"nothing": low[:, 0] < 0, "a point": low.all(axis=1), "a line": low[:, 1] & low[:, 2]}
    with pytest.raises(SolveFailed) as caught:
        Solver(replace(part, fixed_nodes=np.flatnonzero(nodes[held]))).solve([1, 1, 1, 1, 1, 1])
    assert caught.value.kind == "mechanism"


def test_the_negative_eigenvalues_of_an_unstable_tangent_are_counted():
    mesh = box("hex20", (5, 4, 6), (1.0, 0.7, 1.3))
    body = body_of(mesh, clamped(mesh))
    squeezed = mesh.points * np.array([0.0, 0.0, -0.4])
    tangent = body.tangent(squeezed)
    expected = int((np.linalg.eigvalsh(matrix_of(body, tangent).toarray()) < 0).sum())
    assert expected > 0
    assert not tangent.factor.definite
    assert tangent.factor.negatives == expected
    assert body.tangent(None).factor.negatives == 0


LENGTH, SIDE = 0.2, 0.01
SOFT, STIFF = 10e9, 200e9


def two_materials(mesh, is_second, first=STIFF, second=SOFT):
    middles = [mesh.points[block.nodes].mean(axis=1) for block in mesh.blocks]
    return replace(
        component(mesh),
        materials=(Material("first", first, 0.0), Material("second", second, 0.0)),
        material_of_cells=tuple(is_second(m).astype(int) for m in middles),
    )


@pytest.mark.parametrize(
    ("kind", "first", "second"),
    [(kind, STIFF, SOFT) for kind in ("hex20", "hex27", "tet10", "wedge15")]
    + [("hex20", *ends) for most in (1e12, 1e18) for ends in ((1e9, most), (most, 1e9))],
)
def test_materials_in_a_row_stretch_and_bend_like_springs_in_series(kind, first, second):
    """Pure tension and, in hex20, pure bending are exact on this mesh, at any contrast."""
    side = 2 * SIDE
    mesh = box(kind, (2, 2, 10), (side, side, LENGTH))
    built = two_materials(mesh, lambda m: m[:, 2] > LENGTH / 2, first, second)
    give = LENGTH / 2 * (1 / first + 1 / second)
    compliance = Solver(built).compliance
    assert compliance[2, 2] == pytest.approx(give / side**2, rel=1e-9)
    if kind == "hex20":
        assert compliance[4, 4] == pytest.approx(give / (side**4 / 12), rel=1e-9)


def test_a_sandwich_bends_about_its_weighted_middle():
    """Layers side by side: EI about the neutral axis, which lies towards the stiff one."""
    mesh = box("hex20", (2, 2, 10), (SIDE, SIDE, LENGTH))
    built = two_materials(mesh, lambda m: m[:, 0] > SIDE / 2)
    half, breadth = SIDE / 2, SIDE
    areas = np.array([STIFF, SOFT]) * half * breadth
    middles = np.array([half / 2, 3 * half / 2])
    neutral = areas @ middles / areas.sum()
    own = np.array([STIFF, SOFT]) * breadth * half**3 / 12
    right = LENGTH / (own.sum() + areas @ (middles - neutral) ** 2)
    assert Solver(built).compliance[4, 4] == pytest.approx(right, rel=1e-3)
