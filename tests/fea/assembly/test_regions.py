"""Two materials in one part, against the closed forms."""

import numpy as np
import pytest

from tests.fea.boxes import box
from wrenchbook.fea.component import AttachedInterface, ComponentModel
from wrenchbook.fea.coupling.section import section_of_facets
from wrenchbook.fea.solve import Solver
from wrenchbook.fea.spec.material import Material
from wrenchbook.fea.spec.schema import Analysis

LENGTH, SIDE = 0.2, 0.01
SOFT, STIFF = 10e9, 200e9


def two_materials(mesh, is_soft):
    middles = [mesh.points[block.nodes].mean(axis=1) for block in mesh.blocks]
    section = section_of_facets(mesh.points, mesh.facet_groups["z1"])
    return ComponentModel(
        bundle=None,
        mesh=mesh,
        materials=(Material("stiff", STIFF, 0.0), Material("soft", SOFT, 0.0)),
        material_of_cells=tuple(is_soft(m).astype(int) for m in middles),
        fixed_nodes=mesh.facet_groups["z0"].node_ids,
        interfaces=(
            AttachedInterface("interface", "", section, section.centre, np.eye(3), "rigid", ()),
        ),
        analysis=Analysis(nonlinear=False),
    )


@pytest.mark.parametrize("kind", ["hex20", "hex27", "tet10", "wedge15"])
def test_materials_in_a_row_stretch_like_springs_in_series(kind):
    mesh = box(kind, (2, 2, 10), (SIDE, SIDE, LENGTH))
    built = two_materials(mesh, lambda m: m[:, 2] > LENGTH / 2)
    right = LENGTH / 2 / SIDE**2 * (1 / SOFT + 1 / STIFF)
    assert Solver(built).compliance[2, 2] == pytest.approx(right, rel=1e-9)


def test_materials_in_a_row_bend_as_the_moment_says():
    """The tip's rotation under a moment is the integral of M / EI, exact in these cells."""
    mesh = box("hex20", (2, 2, 10), (SIDE, SIDE, LENGTH))
    built = two_materials(mesh, lambda m: m[:, 2] > LENGTH / 2)
    right = LENGTH / 2 / (SIDE**4 / 12) * (1 / SOFT + 1 / STIFF)
    assert Solver(built).compliance[4, 4] == pytest.approx(right, rel=1e-9)


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
