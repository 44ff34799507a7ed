"""From bundle to component: groups resolved, materials placed, faults named."""

import copy
from pathlib import Path

import numpy as np
import pytest

from tests.fea.shipped_meshes import COMPONENTS, hot_bracket, link
from wrenchbook.fea.bundle.read import BundleError, bundle_of, read_bundle
from wrenchbook.fea.component import build
from wrenchbook.fea.coupling.section import section_of_facets
from wrenchbook.fea.solve import Solver

SHIPPED = Path(__file__).parents[2] / "data" / "components"
FILES = Path(__file__).parent / "mesh" / "meshfiles"

BLOCKS = {
    "name": "blocks",
    "title": "Two glued blocks of 10 mm",
    "mesh": {"file": "hex20_41.msh", "unit": "mm"},
    "material": [
        {"region": "soft", "youngs_modulus": 1e9, "poisson_ratio": 0.3},
        {"region": "stiff", "youngs_modulus": 2e11, "poisson_ratio": 0.3},
    ],
    "supports": {"fixed": ["root"]},
    "interface": {"section": "tip", "coupling": "distributed"},
    "analysis": {"nonlinear": False},
    "range": {"force": [1, 1, 1], "moment": [1, 1, 1]},
}


def component(folder=FILES, **changes):
    table = copy.deepcopy(BLOCKS)
    for path, value in changes.items():
        at = table
        *parents, last = path.split("__")
        for key in parents:
            at = at[int(key) if key.isdigit() else key]
        at[last] = value
    return build(bundle_of(table, folder))


def mistakes(**changes):
    with pytest.raises(BundleError) as caught:
        component(**changes)
    return {problem.where: problem.message for problem in caught.value.problems}


def test_a_component_has_its_groups_its_section_and_its_frame():
    built = component()
    assert built.mesh.unknowns == 423
    assert (built.mesh.points[built.fixed_nodes][:, 0] == 0.0).all()
    assert len(built.fixed_nodes) == len(built.interfaces[0].section.node_ids) == 21
    assert built.interfaces[0].section.area == pytest.approx(1e-4, rel=1e-12)
    np.testing.assert_allclose(built.interfaces[0].point, [0.02, 0.005, 0.005], atol=1e-15)
    np.testing.assert_array_equal(built.axes, np.eye(3))
    assert (built.interfaces[0].coupling, built.interfaces[0].locked) == ("distributed", ())


def test_a_point_that_is_given_is_taken():
    assert component(interface__point=[0, 1, 2]).interfaces[0].point.tolist() == [0, 1, 2]


def test_each_cell_has_the_material_of_its_region():
    built = component()
    (numbers,) = built.material_of_cells
    middle = built.mesh.points[built.mesh.blocks[0].nodes].mean(axis=1)[:, 0]
    np.testing.assert_array_equal(numbers, middle > 0.01)


def test_all_fills_what_no_other_material_names():
    materials = [BLOCKS["material"][1], BLOCKS["material"][0] | {"region": "all"}]
    (numbers,) = component(material=materials).material_of_cells
    (expected,) = component().material_of_cells
    np.testing.assert_array_equal(numbers, 1 - expected)


def test_section_weights_integrate_a_constant_and_a_linear_field():
    section = component().interfaces[0].section
    points = component().mesh.points[section.node_ids]
    assert section.weights.sum() == pytest.approx(1e-4, rel=1e-12)
    assert section.weights @ points[:, 1] == pytest.approx(1e-4 * 0.005, rel=1e-12)
    assert section.weights.min() < 0.0  # corners of quad8, as they must be


def test_a_node_group_weighs_by_the_faces_whose_nodes_are_all_in_it(tmp_path):
    text = (FILES / "tet10.inp").read_text()
    (tmp_path / "a.inp").write_text(text.replace("ELSET=tip", "ELSET=skin"))
    file = {"file": "a.inp", "unit": "mm"}
    built = component(tmp_path, mesh=file, supports__fixed=["root"])
    assert "tip" in built.mesh.node_groups
    assert "tip" not in built.mesh.facet_groups
    facets = component(tmp_path, mesh=file, interface__section="skin").interfaces[0].section
    np.testing.assert_array_equal(built.interfaces[0].section.node_ids, facets.node_ids)
    np.testing.assert_allclose(built.interfaces[0].section.weights, facets.weights, atol=1e-18)


def test_a_node_group_without_a_whole_face_weighs_every_node_the_same(tmp_path):
    text = (FILES / "tet10.inp").read_text() + "*NSET, NSET=bolts\n9, 10, 12\n"
    (tmp_path / "a.inp").write_text(text)
    section = (
        component(tmp_path, mesh={"file": "a.inp", "unit": "mm"}, interface__section="bolts")
        .interfaces[0]
        .section
    )
    assert section.area is None
    np.testing.assert_allclose(section.weights, 1 / 3)
    np.testing.assert_allclose(section.centre, [0.02, 0.01 / 3, 0.01 / 3])


def test_every_missing_group_is_told_at_once():
    results = mistakes(interface__section="a", supports__fixed=["b"], material__0__region="c")
    assert {"interface.section", "supports.fixed[0]", "material[0].region"} <= set(results)


def test_a_table_only_component_cannot_be_built():
    table = {key: BLOCKS[key] for key in ("name", "title", "range")}
    with pytest.raises(BundleError, match="cannot be solved; add "):
        build(bundle_of(table, FILES))


def test_a_component_of_a_deck_names_the_table_that_the_embedded_solver_lacks(tmp_path):
    (tmp_path / "job.inp").write_text("*NODE\n")
    deck = {"file": "job.inp", "command": ["ccx"], "output": {"reader": "numbers", "file": "u"}}
    table = {key: BLOCKS[key] for key in ("name", "title", "range")} | {"deck": deck}
    with pytest.raises(BundleError, match=r"is solved by its \[deck\], but this needs a \[mesh\]"):
        build(bundle_of(table, tmp_path))
    (tmp_path / "hex20_41.msh").write_bytes((FILES / "hex20_41.msh").read_bytes())
    table |= {key: BLOCKS[key] for key in ("mesh", "material", "interface")}
    with pytest.raises(BundleError, match=r"supports: is missing, .* add \[supports\]"):
        build(bundle_of(table, tmp_path))


def test_a_component_without_a_material_is_told_to_add_it_in_double_brackets(tmp_path):
    (tmp_path / "job.inp").write_text("*NODE\n")
    (tmp_path / "hex20_41.msh").write_bytes((FILES / "hex20_41.msh").read_bytes())
    deck = {"file": "job.inp", "command": ["ccx"], "output": {"reader": "numbers", "file": "u"}}
    table = {key: BLOCKS[key] for key in ("name", "title", "range", "mesh")} | {"deck": deck}
    with pytest.raises(BundleError, match=r"material: is missing, .* add \[\[material\]\]"):
        build(bundle_of(table, tmp_path))


@pytest.mark.parametrize(
    ("name", "area", "centre", "fixed_area"),
    [
        ("bar", 4e-4, [1, 0, 0], 4e-4),
        ("plate", np.pi * 0.06**2, [0, 0, 0.01], 0.016),
        ("plate_thin", np.pi * 0.06**2, [0, 0, 0.004], 0.0064),
        ("spring", np.pi / 4 * 1.4e-3**2, [-0.0113, 0, 0.088], np.pi / 4 * 1.4e-3**2),
    ],
)
def test_the_shipped_components_build(name, area, centre, fixed_area):
    built = build(read_bundle(SHIPPED / name))
    assert built.mesh.unknowns < 15_000
    assert built.interfaces[0].section.area == pytest.approx(area, rel=1e-12)
    np.testing.assert_allclose(built.interfaces[0].section.centre, centre, atol=1e-12)
    (fixed,) = built.bundle.supports.fixed
    support = section_of_facets(built.mesh.points, built.mesh.facet_groups[fixed])
    assert support.area == pytest.approx(fixed_area, rel=1e-12)
    np.testing.assert_array_equal(support.node_ids, built.fixed_nodes)


def test_the_spring_is_held_on_its_axis_and_guided():
    built = build(read_bundle(SHIPPED / "spring"))
    assert built.interfaces[0].point.tolist() == [0, 0, 0.088]
    assert built.interfaces[0].coupling == "rigid"
    assert built.interfaces[0].locked == ("ux", "uy", "rx", "ry")


@pytest.mark.parametrize(("name", "text"), [("link", link()), ("hot_bracket", hot_bracket())])
def test_a_shipped_mesh_file_is_what_its_generator_writes(name, text):
    assert (COMPONENTS / name / f"{name}.inp").read_text() == text


def test_the_link_bends_less_than_a_tube_without_flanges_and_more_than_with_rigid_ones():
    """Euler's beam with the shear of a thin tube, over its whole length and between flanges."""
    result = Solver(read_bundle(COMPONENTS / "link")).linear.compliance
    inertia, area = np.pi / 4 * (0.0125**4 - 0.011**4), np.pi * (0.0125**2 - 0.011**2)

    def deflection(near: float, far: float) -> float:
        bent = ((0.35 - near) ** 3 - (0.35 - far) ** 3) / 3 / (70e9 * inertia)
        return bent + (far - near) * 2 / (70e9 / 2.66 * area)

    assert deflection(0.006, 0.344) < result[8, 8] < deflection(0, 0.35)
    assert not result[:6].any()


def test_the_hot_bracket_bends_down_when_heated_as_timoshenkos_strip():
    """Aluminium above, steel below, each 3 mm: the arm's curvature, 5 %."""
    result = Solver(read_bundle(COMPONENTS / "hot_bracket")).linear.compliance[:, 6]
    ratio, thickness = 210 / 70, 0.006
    curvature = 24 * (23.5e-6 - 12e-6) / thickness / (14 + ratio + 1 / ratio)
    turned = curvature * (0.1 - 0.006)
    assert result[4] == pytest.approx(turned, rel=5e-2)
    assert result[2] < 0
