"""Surface displacements and stresses of solves."""

from dataclasses import replace

import numpy as np
import pytest

from tests.fea import calculix
from tests.fea.boxes import box
from tests.fea.components import component
from tests.fea.supports import TABLE
from tests.validation.clamped import attached
from wrenchbook.fea.bundle.read import bundle_of, read_bundle
from wrenchbook.fea.bundle.shipped import SHIPPED
from wrenchbook.fea.component import build
from wrenchbook.fea.failure import SolveFailed
from wrenchbook.fea.mesh.facets import outer_surface
from wrenchbook.fea.mesh.mesh import NODES_PER_CELL, CellBlock, Mesh
from wrenchbook.fea.mesh.reference_cell import node_coordinates
from wrenchbook.fea.recovery import fields as recovery
from wrenchbook.fea.recovery.fields import shown_surface
from wrenchbook.fea.recovery.stress import yielding
from wrenchbook.fea.solve import Solver, solve
from wrenchbook.fea.spec.material import Material
from wrenchbook.fea.spec.problems import BundleError
from wrenchbook.fea.spec.schema import Analysis
from wrenchbook.fea.tensors import von_mises

KINDS = ["hex8", "hex20", "hex27", "tet10", "wedge15"]
WRENCH = np.array([3e3, -2e3, 4e4, 200.0, -300.0, 150.0])


def short(kind="hex20", divisions=(2, 2, 4), **changes):
    return component(box(kind, divisions, (0.1, 0.12, 0.4)), **changes)


def fields_of(built, wrench=WRENCH):
    return built.fields(built.solve(wrench))


@pytest.mark.parametrize("nonlinear", [False, True])
@pytest.mark.parametrize("kind", KINDS)
def test_a_pulled_bar_without_poissons_effect_bears_force_over_area(kind, nonlinear):
    result = fields_of(Solver(short(kind, poisson=0.0, nonlinear=nonlinear)), [0, 0, 1e4, 0, 0, 0])
    expected = 1e4 / (0.1 * 0.12)
    # Cauchy's stress of the stretched bar is larger by its stretch, sigma/E = 4e-6.
    np.testing.assert_allclose(result.stress[:, 2], expected, rtol=1e-5)
    np.testing.assert_allclose(result.stress[:, [0, 1, 3, 4, 5]], 0.0, atol=1e-6 * expected)
    assert result.largest == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("coupling", ["rigid", "distributed"])
@pytest.mark.parametrize("locked", [(), ("ux", "rz")])
def test_slopes_are_those_of_solves_beside_it(coupling, locked):
    built = Solver(short(coupling=coupling, young=2e9, nonlinear=True, locked=locked))
    result = fields_of(built)
    step = 1e-3 * WRENCH * [1, -1, 1, 1, 1, -1]
    more, less = fields_of(built, WRENCH + step), fields_of(built, WRENCH - step)
    for name, slopes in (("displacement", "displacement_slopes"), ("stress", "stress_slopes")):
        change = (getattr(more, name) - getattr(less, name)) / 2
        reported = getattr(result, slopes) @ step
        np.testing.assert_allclose(reported, change, atol=2e-6 * np.abs(change).max())


def test_a_linear_components_slopes_are_its_whole_answer():
    built = Solver(short(nonlinear=False))
    result = fields_of(built)
    assert result.linear
    np.testing.assert_allclose(
        result.displacement_slopes @ WRENCH,
        result.displacement,
        atol=1e-14 * np.abs(result.displacement).max(),
    )
    np.testing.assert_array_equal(result.stress_slopes @ WRENCH, result.stress)


def test_vertices_and_displacements_are_in_the_interface_frame():
    axes = np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]])
    straight, turned = short(nonlinear=False), short(nonlinear=False, axes=axes)
    plain = fields_of(Solver(straight))
    other = fields_of(Solver(turned), np.concatenate([axes @ WRENCH[:3], axes @ WRENCH[3:]]))
    np.testing.assert_allclose(other.vertices, plain.vertices @ axes.T, atol=1e-15)
    size = np.abs(plain.displacement).max()
    np.testing.assert_allclose(other.displacement, plain.displacement @ axes.T, atol=1e-12 * size)
    assert other.largest == pytest.approx(plain.largest, rel=1e-10)
    np.testing.assert_allclose(other.largest_at, axes @ plain.largest_at, atol=1e-12)
    assert np.abs(plain.vertices[:, 2]).min() < 1e-14  # the section is where the point is


def test_the_surface_of_a_rigid_section_moves_as_the_answer_says():
    built = Solver(short(coupling="rigid", young=1e9, nonlinear=True))
    solution = built.solve(WRENCH)
    result = built.fields(solution)
    section = np.abs(result.vertices[:, 2]) < 1e-12
    middle = result.displacement[section & (np.abs(result.vertices[:, :2]).max(axis=1) < 1e-9)]
    np.testing.assert_allclose(middle, solution.displacement[None, :3], rtol=1e-12)


def test_each_cells_material_names_its_points():
    part = short(nonlinear=False)
    soft = replace(part.materials[0], region="soft", youngs_modulus=1e9, poisson_ratio=0.45)
    low = part.mesh.points[part.mesh.blocks[0].nodes].mean(axis=1)[:, 2] < 0.1
    two = replace(
        part,
        materials=(part.materials[0], soft),
        material_of_cells=(low.astype(int),),
    )
    result = fields_of(Solver(two))  # the soft cells project their volume: they are sorted apart
    below = result.places[:, 2] < -0.3
    assert (result.materials[below] == 1).all()
    assert (result.materials[~below] == 0).all()
    assert result.regions == ("all", "soft")
    worst = von_mises(result.stress).argmax()
    np.testing.assert_array_equal(result.places[worst], result.largest_at)
    # Stresses pass from one material to the other: the pull is the same above and below.
    pull = fields_of(Solver(two), [0, 0, 1e4, 0, 0, 0]).stress[:, 2]
    assert pull[below].mean() == pytest.approx(pull[~below].mean(), rel=2e-2)


@pytest.mark.parametrize("nonlinear", [False, True])
def test_of_too_many_points_only_the_largest_stress_is_kept(monkeypatch, nonlinear):
    built = Solver(short(nonlinear=nonlinear))
    whole = fields_of(built)
    monkeypatch.setattr(recovery, "MAX_POINTS", 10)
    result = fields_of(built)
    assert (len(result.stress), len(result.stress_slopes), len(result.places)) == (0, 0, 0)
    assert (result.largest, result.largest_at) == (whole.largest, whole.largest_at)


def test_solve_gives_its_fields_to_whoever_asks():
    reported = []
    part = short(nonlinear=True)
    solution = solve(part, WRENCH, on_fields=reported.append)
    (result,) = reported
    nodes = outer_surface(part.mesh.blocks).node_ids
    np.testing.assert_allclose(result.displacement, solution.nodes[nodes], rtol=1e-12, atol=1e-20)


@pytest.mark.ccx
@pytest.mark.parametrize(
    ("kind", "coupling"), [("hex20", "rigid"), ("hex20", "distributed"), ("tet10", "rigid")]
)
def test_calculix_finds_the_same_linear_stresses(kind, coupling, tmp_path):
    calculix.require_ccx()
    part = short(kind, coupling=coupling)
    wrench = np.array([3e3, 0, 4e4, 0, 0, 0.0])
    result = fields_of(Solver(part), wrench)
    theirs = calculix.stresses(part, wrench, tmp_path, nonlinear=False)
    if kind == "tet10":  # the four points of each cell in another order
        ours, theirs = (
            np.sort(von_mises(item).reshape(-1, 4), axis=1) for item in (result.stress, theirs)
        )
    else:
        ours = result.stress
    assert np.abs(ours - theirs).max() < 1e-5 * np.abs(theirs).max()


@pytest.mark.ccx
@pytest.mark.parametrize("seed", [1, 2])
def test_calculix_finds_the_same_stresses_in_the_thin_plate(seed, tmp_path):
    calculix.require_ccx()
    part = attached(build(read_bundle(SHIPPED / "plate_thin")), coupling="rigid")
    loads = part.bundle.range
    wrench = 0.4 * np.random.default_rng(seed).uniform(loads.low, loads.high)
    built = Solver(part)
    solution = built.solve(wrench)
    result = built.fields(solution)
    conjugate = calculix.conjugate(wrench, solution.displacement)
    theirs = calculix.stresses(part, conjugate, tmp_path, nonlinear=True)
    assert np.abs(result.stress - theirs).max() < 1e-5 * np.abs(theirs).max()
    assert result.largest == pytest.approx(von_mises(theirs).max(), rel=1e-5)


SIDES = (0.2, 0.3, 0.5)


def volume(points, triangles):
    first, second, third = (points[triangles[:, i]] for i in range(3))
    return np.einsum("ij,ij->", first, np.cross(second, third)) / 6


def edges(triangles):
    return np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])


@pytest.mark.parametrize("kind", NODES_PER_CELL)
def test_the_triangles_look_outwards_and_hold_the_volume(kind):
    mesh = box(kind, (2, 3, 2), SIDES)
    result = shown_surface(mesh)
    assert volume(mesh.points[result.nodes], result.triangles) == pytest.approx(0.03, rel=1e-12)


@pytest.mark.parametrize("kind", NODES_PER_CELL)
def test_each_edge_has_one_triangle_on_each_side(kind):
    triangles = shown_surface(box(kind, (2, 3, 2), SIDES)).triangles
    forward, times = np.unique(edges(triangles), axis=0, return_counts=True)
    assert (times == 1).all()
    assert {tuple(e) for e in forward.tolist()} == {tuple(e[::-1]) for e in forward.tolist()}


def test_midside_nodes_are_vertices():
    mesh = Mesh(node_coordinates("hex20"), (CellBlock("hex20", np.arange(20)[None]),))
    result = shown_surface(mesh)
    assert result.nodes.tolist() == list(range(20))
    assert len(result.triangles) == 6 * 6


def test_a_node_within_is_no_vertex():
    mesh = box("hex8", (3, 3, 3))
    result = shown_surface(mesh)
    assert (len(mesh.points), len(result.nodes), result.full_count) == (64, 56, 56)


def test_a_large_surface_is_simplified_and_says_so():
    mesh = box("hex20", (12, 12, 12), SIDES)
    whole, result = shown_surface(mesh), shown_surface(mesh, max_vertices=500)
    assert result.full_count == len(whole.nodes) > 2000
    assert 200 < len(result.nodes) <= 500
    assert set(result.nodes.tolist()) <= set(whole.nodes.tolist())
    points = mesh.points[result.nodes]
    assert volume(points, result.triangles) == pytest.approx(0.03, rel=0.25)
    assert (result.triangles.max(), result.triangles.min()) == (len(result.nodes) - 1, 0)
    corners = np.sort(result.triangles, axis=1)
    assert len(np.unique(corners, axis=0)) == len(corners)
    assert (np.diff(corners, axis=1) > 0).all()


def test_a_thin_plate_that_is_simplified_keeps_both_faces():
    mesh = box("hex8", (40, 40, 1), (0.4, 0.4, 0.004))
    result = shown_surface(mesh, max_vertices=500)
    points = mesh.points[result.nodes]
    assert len(points) <= 500
    assert np.unique(points[:, 2]).tolist() == [0.0, 0.004]
    assert volume(points, result.triangles) == pytest.approx(0.4 * 0.4 * 0.004, rel=0.1)


STRENGTH = 100e6
AREA, MODULUS = 0.02 * 0.03, 0.03 * 0.02**2 / 6  # of a section 0.02 by 0.03 m, about y


def bar(on_yield="warn", strength=STRENGTH, nonlinear=False):
    mesh = box("hex20", (4, 4, 6), (0.02, 0.03, 0.2))
    one = component(mesh, poisson=0.0)
    material = replace(Material("all", 210e9, 0.0), yield_strength=strength)
    return Solver(
        replace(one, materials=(material,), analysis=Analysis(nonlinear, on_yield=on_yield))
    )


def of_yielding(solution):
    return [note for note in solution.notes if "yield strength" in note]


@pytest.mark.parametrize("nonlinear", [False, True])
def test_a_bar_that_is_pulled_yields_as_a_whole(nonlinear):
    (note,) = of_yielding(bar(nonlinear=nonlinear).solve([0, 0, 1.2 * STRENGTH * AREA, 0, 0, 0]))
    assert note.startswith("100 % of the part's volume is above its yield strength")
    assert 'up to 1.2 times 1e+08 Pa in "all"' in note


def test_a_bar_that_is_bent_yields_at_its_faces():
    moment = 1.5 * STRENGTH * MODULUS
    (note,) = of_yielding(bar().solve([0, 0, 0, 0, moment, 0]))
    # Of four layers the two outer ones are beyond 2/3 of the half depth at one point of two.
    assert note.startswith("25 % of the part's volume")


@pytest.mark.parametrize("strength", [STRENGTH, None])
def test_a_bar_that_does_not_yield_has_no_note(strength):
    assert not of_yielding(bar(strength=strength).solve([0, 0, 0.9 * STRENGTH * AREA, 0, 0, 0]))


def test_stresses_of_an_answer_are_found_only_where_the_loads_may_make_it_yield(monkeypatch):
    solver, results = bar(), []
    monkeypatch.setattr("wrenchbook.fea.solve.yielding", lambda *_: results.append(1) or "")
    for share in (0.4, 0.49, 0.51, 1.2):
        force, moment = share * STRENGTH * AREA, share * STRENGTH * MODULUS
        solver.solve([0, 0, force, 0, moment, 0])
    assert 1 <= len(results) <= 2


def test_loads_that_show_no_yielding_have_none():
    solver, chance = bar(), np.random.default_rng(3)
    scale = STRENGTH * np.array([2e-5, 2e-5, AREA, MODULUS, MODULUS, MODULUS])
    for wrench in chance.uniform(-0.7, 0.7, (40, 6)) * scale:
        result = solver.solve(wrench)
        assert bool(of_yielding(result)) == bool(yielding(solver.component, solver.body, result))


def test_a_component_that_must_not_yield_has_no_answer_where_it_does():
    solver = bar("fail")
    with pytest.raises(SolveFailed, match="100 % of the part's volume") as caught:
        solver.solve([0, 0, 1.2 * STRENGTH * AREA, 0, 0, 0])
    assert caught.value.kind == "yields"
    assert "on_yield" in caught.value.remedy
    assert solver.solve([0, 0, 0.9 * STRENGTH * AREA, 0, 0, 0]).displacement[2] > 0


def bundle(folder, **analysis):
    material = {"region": "all", "youngs_modulus": 1e9, "poisson_ratio": 0.3}
    table = TABLE | {
        "supports": {"fixed": ["z0"]},
        "material": [material],
        "interface": {"section": "z1", "coupling": "rigid"},
        "analysis": {"nonlinear": False} | analysis,
    }
    return bundle_of(table, folder)


def test_the_bundle_says_what_becomes_of_a_solve_that_yields(tmp_path):
    assert bundle(tmp_path).analysis.on_yield == "warn"
    assert bundle(tmp_path, on_yield="fail").analysis.on_yield == "fail"


def test_another_word_is_refused(tmp_path):
    with pytest.raises(BundleError, match="on_yield"):
        bundle(tmp_path, on_yield="stop")
