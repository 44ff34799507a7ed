"""Surface displacements and stresses of solves."""

from dataclasses import replace

import numpy as np
import pytest

from tests.fea import calculix
from tests.fea.boxes import box
from tests.fea.components import component
from tests.validation.clamped import attached
from wrenchbook.fea.bundle.read import read_bundle
from wrenchbook.fea.bundle.shipped import SHIPPED
from wrenchbook.fea.component import build
from wrenchbook.fea.mesh.facets import outer_surface
from wrenchbook.fea.recovery import fields as recovery
from wrenchbook.fea.solve import Solver, solve
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
    found = fields_of(Solver(short(kind, poisson=0.0, nonlinear=nonlinear)), [0, 0, 1e4, 0, 0, 0])
    expected = 1e4 / (0.1 * 0.12)
    # Cauchy's stress of the stretched bar is larger by its stretch, sigma/E = 4e-6.
    np.testing.assert_allclose(found.stress[:, 2], expected, rtol=1e-5)
    np.testing.assert_allclose(found.stress[:, [0, 1, 3, 4, 5]], 0.0, atol=1e-6 * expected)
    assert found.largest == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("coupling", ["rigid", "distributed"])
@pytest.mark.parametrize("locked", [(), ("ux", "rz")])
def test_slopes_are_those_of_solves_beside_it(coupling, locked):
    built = Solver(short(coupling=coupling, young=2e9, nonlinear=True, locked=locked))
    found = fields_of(built)
    step = 1e-3 * WRENCH * [1, -1, 1, 1, 1, -1]
    more, less = fields_of(built, WRENCH + step), fields_of(built, WRENCH - step)
    for name, slopes in (("displacement", "displacement_slopes"), ("stress", "stress_slopes")):
        change = (getattr(more, name) - getattr(less, name)) / 2
        told = getattr(found, slopes) @ step
        np.testing.assert_allclose(told, change, atol=2e-6 * np.abs(change).max())


def test_a_linear_components_slopes_are_its_whole_answer():
    built = Solver(short(nonlinear=False))
    found = fields_of(built)
    assert found.linear
    np.testing.assert_allclose(
        found.displacement_slopes @ WRENCH,
        found.displacement,
        atol=1e-14 * np.abs(found.displacement).max(),
    )
    np.testing.assert_array_equal(found.stress_slopes @ WRENCH, found.stress)


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
    found = built.fields(solution)
    section = np.abs(found.vertices[:, 2]) < 1e-12
    middle = found.displacement[section & (np.abs(found.vertices[:, :2]).max(axis=1) < 1e-9)]
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
    found = fields_of(Solver(two))  # the soft cells project their volume: they are sorted apart
    below = found.places[:, 2] < -0.3
    assert (found.materials[below] == 1).all()
    assert (found.materials[~below] == 0).all()
    assert found.regions == ("all", "soft")
    worst = von_mises(found.stress).argmax()
    np.testing.assert_array_equal(found.places[worst], found.largest_at)
    # Stresses pass from one material to the other: the pull is the same above and below.
    pull = fields_of(Solver(two), [0, 0, 1e4, 0, 0, 0]).stress[:, 2]
    assert pull[below].mean() == pytest.approx(pull[~below].mean(), rel=2e-2)


@pytest.mark.parametrize("nonlinear", [False, True])
def test_of_too_many_points_only_the_largest_stress_is_kept(monkeypatch, nonlinear):
    built = Solver(short(nonlinear=nonlinear))
    whole = fields_of(built)
    monkeypatch.setattr(recovery, "MAX_POINTS", 10)
    found = fields_of(built)
    assert (len(found.stress), len(found.stress_slopes), len(found.places)) == (0, 0, 0)
    assert (found.largest, found.largest_at) == (whole.largest, whole.largest_at)


def test_solve_gives_its_fields_to_whoever_asks():
    told = []
    part = short(nonlinear=True)
    solution = solve(part, WRENCH, on_fields=told.append)
    (found,) = told
    nodes = outer_surface(part.mesh.blocks).node_ids
    np.testing.assert_allclose(found.displacement, solution.nodes[nodes], rtol=1e-12, atol=1e-20)


@pytest.mark.ccx
@pytest.mark.parametrize(
    ("kind", "coupling"), [("hex20", "rigid"), ("hex20", "distributed"), ("tet10", "rigid")]
)
def test_calculix_finds_the_same_linear_stresses(kind, coupling, tmp_path):
    calculix.require_ccx()
    part = short(kind, coupling=coupling)
    wrench = np.array([3e3, 0, 4e4, 0, 0, 0.0])
    found = fields_of(Solver(part), wrench)
    theirs = calculix.stresses(part, wrench, tmp_path, nonlinear=False)
    if kind == "tet10":  # the four points of each cell in another order
        ours, theirs = (
            np.sort(von_mises(one).reshape(-1, 4), axis=1) for one in (found.stress, theirs)
        )
    else:
        ours = found.stress
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
    found = built.fields(solution)
    conjugate = calculix.conjugate(wrench, solution.displacement)
    theirs = calculix.stresses(part, conjugate, tmp_path, nonlinear=True)
    assert np.abs(found.stress - theirs).max() < 1e-5 * np.abs(theirs).max()
    assert found.largest == pytest.approx(von_mises(theirs).max(), rel=1e-5)
