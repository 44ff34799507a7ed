"""The temperature as an input: thermal strain, its tangents, its stresses, decks and mistakes."""

from dataclasses import replace

import numpy as np
import pytest

from tests.fea.boxes import box
from tests.fea.calculix import require_ccx
from tests.fea.supports import PLANES, TABLE, largest
from tests.validation import calculix
from tests.validation.second_opinion import difference
from wrenchbook.fea.bundle.read import bundle_of
from wrenchbook.fea.component import build
from wrenchbook.fea.failure import SolveFailed
from wrenchbook.fea.inspection import warnings_of
from wrenchbook.fea.mesh.io.temperature_field import shape_on
from wrenchbook.fea.solve import Solver
from wrenchbook.fea.spec.problems import BundleError
from wrenchbook.fea.tensors import rotation

ALUMINIUM = {
    "region": "all",
    "youngs_modulus": 70e9,
    "poisson_ratio": 0.33,
    "thermal_expansion": 23e-6,
}
TURN = rotation(np.array([0.4, -0.7, 0.3]))
ALONG = [1e-6, 30e-6, 25e-6]
PLY = {
    "region": "all",
    "law": "orthotropic",
    "youngs_modulus": [100e9, 10e9, 8e9],
    "poisson_ratio": [0.3, 0.25, 0.35],
    "shear_modulus": [5e9, 4e9, 3e9],
    "axes": TURN.tolist(),
    "thermal_expansion": ALONG,
}
INPUTS = {"temperature": {"range": [-40, 120], "reference": 20}}
LOADS = np.array([300.0, -200.0, -900.0, 40.0, 60.0, 30.0])


def table(supports, *materials, nonlinear=False, **changes):
    whole = TABLE | {
        "supports": supports,
        "material": list(materials or [ALUMINIUM]),
        "interface": {"section": "z1", "coupling": "rigid"},
        "analysis": {"nonlinear": nonlinear},
        "inputs": INPUTS,
    }
    return whole | changes


def solver(mesh, folder, *what, coupling="rigid", section="z1", **options):
    interface = {"interface": {"section": section, "coupling": coupling}}
    return Solver(build(bundle_of(table(*what, **(interface | options)), folder), mesh))


def mistakes(folder, whole):
    try:
        bundle_of(whole, folder)
    except BundleError as error:
        return {problem.where: problem.message for problem in error.problems}
    return {}


def block():
    return box("hex20", (2, 2, 4), (0.1, 0.06, 0.4))


def arch():
    """A shallow arch in the plane of y and z, and the group of its middle's nodes."""
    flat = box("hex20", (2, 2, 12), (0.05, 0.02, 1.0))
    points = flat.points.copy()
    points[:, 1] += 0.05 * np.sin(np.pi * points[:, 2])
    middle = np.flatnonzero(np.abs(points[:, 2] - 0.5) < 1e-9)
    return replace(flat, points=points, node_groups={"middle": middle})


def clamped_arch(folder):
    both = {"fixed": ["z0", "z1"]}
    return solver(arch(), folder, both, nonlinear=True, section="middle")


@pytest.mark.parametrize("nonlinear", [False, True])
def test_a_free_block_grows_by_its_expansion_without_stress(tmp_path, nonlinear):
    own = solver(
        block(), tmp_path, {"sliding": PLANES}, nonlinear=nonlinear, coupling="distributed"
    )
    result = own.solve([*np.zeros(6), 120.0])
    np.testing.assert_allclose(result.nodes, 2.3e-3 * block().points, rtol=1e-9, atol=1e-13)
    assert np.abs(own.stresses(result)).max() < 1e-9 * 70e9 * 2.3e-3
    assert abs(result.strain_energy) < 1e-9 * 70e9 * 2.3e-3**2 * 0.1 * 0.06 * 0.4
    expected = 23e-6 * np.array([0.05, 0.03, 0.4])
    np.testing.assert_allclose(result.compliance[:3, 6], expected, rtol=1e-9)


@pytest.mark.parametrize("nonlinear", [False, True])
def test_an_orthotropic_block_of_turned_axes_grows_along_them(tmp_path, nonlinear):
    mesh = block()
    corners = [[0, 0, 0], [0, 0, 0.4], [0, 0.06, 0]]
    groups = {
        name: np.flatnonzero((np.abs(mesh.points - place) < 1e-9).all(axis=1))
        for name, place in zip("abc", corners, strict=True)
    }
    ways = {"a": ["x", "y", "z"], "b": ["x", "y"], "c": ["x"]}
    sliding = [{"group": name, "directions": way} for name, way in ways.items()]
    own = solver(
        replace(mesh, node_groups=groups),
        tmp_path,
        {"sliding": sliding},
        PLY,
        nonlinear=nonlinear,
        coupling="distributed",
    )
    result = own.solve([*np.zeros(6), -30.0])
    affine = np.column_stack([np.ones(len(mesh.points)), mesh.points])
    fit, rest, *_ = np.linalg.lstsq(affine, result.nodes, rcond=None)
    assert rest.max() < 1e-20
    growth = -50.0 * TURN.T @ np.diag(ALONG) @ TURN
    slope = fit[1:].T
    if nonlinear:
        stretch = np.eye(3) + slope
        np.testing.assert_allclose(
            stretch.T @ stretch, np.linalg.matrix_power(np.eye(3) + growth, 2), atol=1e-11
        )
    else:
        np.testing.assert_allclose(0.5 * (slope + slope.T), growth, atol=1e-12)
    assert np.abs(own.stresses(result)).max() < 1e-8 * 10e9 * 1.5e-3


def test_a_restrained_block_pushes_with_its_modulus_times_its_expansion(tmp_path):
    own = solver(block(), tmp_path, {"sliding": PLANES}, coupling="distributed")
    force = -70e9 * 0.1 * 0.06 * 23e-6 * 40.0
    result = own.solve([0, 0, force, 0, 0, 0, 60.0])
    assert abs(result.displacement[2]) < 1e-9 * 0.4 * 23e-6 * 40.0
    stress = own.stresses(result)
    np.testing.assert_allclose(stress[:, 2], -70e9 * 23e-6 * 40.0, rtol=1e-9)
    assert np.abs(np.delete(stress, 2, axis=1)).max() < 1e-9 * np.abs(stress).max()
    assert result.strain_energy == pytest.approx(0.5 * force**2 * 0.4 / (70e9 * 0.1 * 0.06))


def test_a_bimetal_strip_bends_as_timoshenko_has_it(tmp_path):
    height, length = 2e-3, 0.2
    mesh = box("hex20", (1, 4, 60), (2e-3, height, length))
    (cells,) = mesh.blocks
    upper = mesh.points[cells.nodes].mean(axis=1)[:, 1] > 0.5 * height
    mesh = replace(mesh, regions={"steel": (np.flatnonzero(upper),)})
    steel = {
        "region": "steel",
        "youngs_modulus": 210e9,
        "poisson_ratio": 0.33,
        "thermal_expansion": 12e-6,
    }
    own = solver(mesh, tmp_path, {"fixed": ["z0"]}, ALUMINIUM, steel, coupling="distributed")
    turned = own.solve([*np.zeros(6), 120.0]).displacement[3]
    ratio = 3.0  # of the moduli; the layers have one thickness
    stiffness = 12 + (1 + ratio) * (1 + 1 / ratio)
    curvature = 24 * (23e-6 - 12e-6) * 100.0 / (height * stiffness)
    assert abs(turned) == pytest.approx(curvature * length, rel=0.01)


@pytest.mark.parametrize("material", [ALUMINIUM, PLY])
def test_calculix_finds_the_same_in_linear_analysis(tmp_path, material):
    require_ccx()
    own = solver(block(), tmp_path, {"fixed": ["z0"]}, material)
    inputs = [*LOADS, 75.0]
    reply = calculix.solve_rigid(own.component, inputs)
    assert calculix.worst_gap(own.solve(inputs).displacement, reply.displacement) < 1e-5


@pytest.mark.parametrize("loads", [[0, -1000, 100, 0, 0, 0, 80], [0, -3000, 0, 20, 0, 0, -20]])
def test_calculix_finds_the_same_of_a_clamped_arch_with_heat_and_a_load(tmp_path, loads):
    require_ccx()
    own = clamped_arch(tmp_path)
    result = own.solve(loads).displacement
    reply = calculix.solve_rigid(own.component, loads, result[3:])
    assert difference(result, reply.displacement) < 1e-4


def test_a_heated_bar_between_walls_buckles_at_eulers_strain(tmp_path):
    mesh = box("hex20", (2, 2, 20), (0.03, 0.02, 2.0))
    middle = np.flatnonzero(np.abs(mesh.points[:, 2] - 1.0) < 1e-9)
    mesh = replace(mesh, node_groups={"middle": middle})
    both = {"fixed": ["z0", "z1"]}
    own = solver(mesh, tmp_path, both, section="middle", coupling="distributed")
    factor, opposite = own.buckling([*np.zeros(6), 20.0 + 10.0])
    strain = 4 * np.pi**2 * 0.02**2 / 12 / 2.0**2
    assert factor == pytest.approx(strain / (23e-6 * 10.0), rel=0.01)
    assert opposite == np.inf or opposite > 1e3 * factor


def test_an_arch_that_snaps_through_carries_more_when_it_is_warm(tmp_path):
    own, factors = clamped_arch(tmp_path), []
    for warm in (20.0, 60.0):
        with pytest.raises(SolveFailed) as caught:
            own.solve([0, -60000.0, 0, 0, 0, 0, warm])
        assert caught.value.kind == "snap_through"
        factors.append(caught.value.load_factor)
    assert 1.01 * factors[0] < factors[1] < 1.2 * factors[0]


def test_the_tangent_without_load_is_the_linear_response(tmp_path):
    linear = solver(block(), tmp_path, {"fixed": ["z0"]}, PLY)
    own = solver(block(), tmp_path, {"fixed": ["z0"]}, PLY, nonlinear=True)
    at_rest = own.solve([*np.zeros(6), 20.0])
    assert not at_rest.displacement.any()
    np.testing.assert_allclose(at_rest.compliance, linear.linear.compliance, atol=1e-18)
    step = 1e-3 * np.array([*LOADS, 50.0])
    near = own.solve(at_rest.wrench + step).displacement
    assert largest(near - at_rest.compliance @ step, near) < 1e-4


def test_a_component_at_its_reference_answers_as_one_without_the_input(tmp_path):
    for nonlinear in (False, True):
        own = solver(block(), tmp_path, {"fixed": ["z0"]}, nonlinear=nonlinear)
        whole = table({"fixed": ["z0"]}, nonlinear=nonlinear)
        del whole["inputs"]
        plain = Solver(build(bundle_of(whole, tmp_path), block())).solve(LOADS)
        warm = own.solve([*LOADS, 20.0])
        np.testing.assert_allclose(warm.displacement, plain.displacement, rtol=1e-11)
        assert warm.strain_energy == pytest.approx(plain.strain_energy, rel=1e-11)
        assert warm.work == pytest.approx(plain.work, rel=1e-11)


def test_work_and_strain_energy_agree_where_heat_works_too(tmp_path):
    own = solver(block(), tmp_path, {"fixed": ["z0"]}, nonlinear=True)
    result = own.solve([*(10 * LOADS), 100.0])
    held = 1.5 * 70e9 / (1 - 2 * 0.33) * (80 * 23e-6) ** 2 * 0.1 * 0.06 * 0.4
    assert abs(result.work - result.strain_energy) < 80 * 23e-6 * held


def two_ended(folder, nonlinear):
    """Return the solver of a block clamped below, with an interface at each side above."""
    loads = {"force": [1, 1, 1], "moment": [1, 1, 1]}
    ends = [
        {"name": "left", "section": "x0", "coupling": "distributed", "range": loads},
        {"name": "right", "section": "x1", "coupling": "rigid", "range": loads},
    ]
    whole = table({"fixed": ["z0"]}, interface=ends, nonlinear=nonlinear)
    del whole["range"]
    mesh = block()
    top = mesh.points[:, 2] > 0.2
    groups = {
        f"x{i}": np.flatnonzero(top & (np.abs(mesh.points[:, 0] - x) < 1e-9))
        for i, x in enumerate((0.0, 0.1))
    }
    mesh = replace(mesh, node_groups=groups, facet_groups={"z0": mesh.facet_groups["z0"]})
    return Solver(build(bundle_of(whole, folder), mesh))


def test_two_interfaces_take_the_temperature_by_name_or_behind_their_loads(tmp_path):
    own = two_ended(tmp_path, nonlinear=False)
    named = own.solve({"right": LOADS, "temperature": 60.0})
    listed = own.solve([*np.zeros(6), *LOADS, 60.0])
    assert named.compliance.shape == (12, 13)
    np.testing.assert_array_equal(named.displacement, listed.displacement)
    expected = listed.compliance @ [*np.zeros(6), *LOADS, 40.0]
    np.testing.assert_allclose(listed.displacement, expected, rtol=1e-12)


def test_the_tangent_of_two_interfaces_by_loads_and_temperature_is_that_of_differences(tmp_path):
    own = two_ended(tmp_path, nonlinear=True)
    inputs = np.array([*(10 * LOADS), *(-20 * LOADS), 90.0])
    result = own.solve(inputs)
    assert result.compliance.shape == (12, 13)
    for number, step in ((1, 50.0), (10, 5.0), (12, 0.05)):
        ahead, behind = (own.solve(inputs + s * np.eye(13)[number]) for s in (step, -step))
        slope = (ahead.displacement - behind.displacement) / (2 * step)
        assert largest(slope - result.compliance[:, number], slope) < 1e-6


def test_inputs_without_the_temperature_are_refused(tmp_path):
    own = solver(block(), tmp_path, {"fixed": ["z0"]})
    with pytest.raises(ValueError, match=r"7 finite numbers.*temperature"):
        own.solve(LOADS)
    with pytest.raises(ValueError, match='"temperature" is missing'):
        own.solve({"": LOADS})
    with pytest.raises(
        ValueError,
        match='"temprature" is no input here; give temperature; did you mean "temperature"',
    ):
        own.solve({"": LOADS, "temprature": 20.0})
    with pytest.raises(ValueError, match='"7" is no input here'):
        own.solve({"": LOADS, 7: 20.0})


def test_a_measured_part_may_have_a_temperature_without_a_field(tmp_path):
    whole = table({"fixed": ["start"]})
    only = {key: whole[key] for key in ("name", "title", "range", "inputs")}
    assert bundle_of(only, tmp_path).further[0].name == "temperature"
    (tmp_path / "hot.csv").write_text("x,y,z,T\n0,0,0,1\n")
    only["inputs"] = {"temperature": {**only["inputs"]["temperature"], "field": "hot.csv"}}
    assert "no nodes" in mistakes(tmp_path, only)["inputs.temperature.field"]


def test_an_expansion_without_the_input_is_a_note(tmp_path):
    whole = table({"fixed": ["z0"]})
    del whole["inputs"]
    own = build(bundle_of(whole, tmp_path), block())
    (note,) = [item for item in warnings_of(own) if "thermal_expansion" in item.where]
    assert "[inputs.temperature]" in note.message


def test_the_fingerprint_changes_with_expansion_and_reference_and_not_with_the_range(tmp_path):
    def digits(material=ALUMINIUM, inputs=INPUTS):
        whole = table({"fixed": ["start"]}, material) | ({"inputs": inputs} if inputs else {})
        if not inputs:
            del whole["inputs"]
        return bundle_of(whole, tmp_path).fingerprint

    other = ALUMINIUM | {"thermal_expansion": 24e-6}
    moved = {"temperature": {"range": [-40, 120], "reference": 21}}
    wider = {"temperature": {"range": [-60, 120], "reference": 20}}
    assert digits() == digits(inputs=wider)
    assert len({digits(), digits(other), digits(inputs=moved), digits(inputs=None)}) == 4
    assert digits(inputs=None) == digits(other, inputs=None)


def test_a_solve_is_started_from_a_state_at_another_temperature(tmp_path):
    own = clamped_arch(tmp_path)
    inputs = np.array([0, -1000.0, 100.0, 0, 0, 0, 80.0])
    first = own.solve(inputs)
    again = own.solve(inputs + np.array([0, 5.0, 0, 0, 0, 0, 1.0]), start=first.state)
    cold = own.solve(again.wrench)
    assert len(again.history) < len(cold.history)
    np.testing.assert_allclose(again.displacement, cold.displacement, rtol=1e-7, atol=1e-12)
    assert not np.array_equal(first.displacement, again.displacement)


@pytest.mark.parametrize(
    "own",
    [{"range": [-300, 60], "reference": 20}, {"unit": "K", "range": [-20, 60], "reference": 20}],
)
def test_a_temperature_below_absolute_zero_is_refused(tmp_path, own):
    result = mistakes(tmp_path, table({"fixed": ["start"]}, inputs={"temperature": own}))
    assert "absolute zero; correct it" in result["inputs.temperature.range"]


REFERENCE, HOTTEST = 20.0, 120.0
SIZE = np.array([0.02, 0.02, 0.4])
EXPANSION = 23e-6
STEEL = {
    "region": "all",
    "youngs_modulus": 210e9,
    "poisson_ratio": 0.0,
    "thermal_expansion": EXPANSION,
}


def write(folder, points, rise):
    lines = [f"{x},{y},{z},{REFERENCE + one}" for (x, y, z), one in zip(points, rise, strict=True)]
    (folder / "hot.csv").write_text("x,y,z,T\n" + "\n".join(lines) + "\n")


def bar(folder, *, nonlinear=False, cells=(1, 2, 8)):
    inputs = {"temperature": {"range": [0, HOTTEST], "reference": REFERENCE, "field": "hot.csv"}}
    whole = table({"fixed": ["z0"]}, STEEL, nonlinear=nonlinear, inputs=inputs)
    whole["interface"]["coupling"] = "distributed"
    return Solver(build(bundle_of(whole, folder), box("hex20", cells, tuple(SIZE))))


def corners():
    return np.array(np.meshgrid(*zip([0.0] * 3, SIZE, strict=True))).reshape(3, -1).T


def warmed(solver, temperature=HOTTEST):
    return solver.solve({"": np.zeros(6), "temperature": temperature}).displacement


@pytest.mark.parametrize("nonlinear", [False, True])
def test_a_bar_that_is_warmer_towards_its_end_grows_by_the_mean_rise(tmp_path, nonlinear):
    points = corners()
    write(tmp_path, points, 100.0 * points[:, 2] / SIZE[2])
    moved = warmed(bar(tmp_path, nonlinear=nonlinear))
    assert moved[2] == pytest.approx(EXPANSION * 50.0 * SIZE[2], rel=3e-3 if nonlinear else 1e-3)


def test_a_bar_that_is_warmer_on_one_side_bends_to_an_arc(tmp_path):
    points = corners()
    write(tmp_path, points, 100.0 * points[:, 1] / SIZE[1])
    moved = warmed(bar(tmp_path))
    curvature = EXPANSION * 100.0 / SIZE[1]
    assert abs(moved[1]) == pytest.approx(curvature * SIZE[2] ** 2 / 2, rel=2e-3)
    assert abs(moved[3]) == pytest.approx(curvature * SIZE[2], rel=2e-3)


def test_the_input_is_the_temperature_of_the_hottest_point(tmp_path):
    points = corners()
    write(tmp_path, points, 7.0 * points[:, 2] / SIZE[2])
    other = tmp_path / "other"
    other.mkdir()
    write(other, points, 100.0 * points[:, 2] / SIZE[2])
    assert warmed(bar(tmp_path)) == pytest.approx(warmed(bar(other)), rel=1e-12, abs=1e-18)


def test_a_field_with_a_mark_of_its_encoding_and_units_is_read_as_without(tmp_path):
    nodes = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.25], [0.0, 0.0, 1.0]])
    file = tmp_path / "hot.csv"
    file.write_text("x [m],y (m),z,T\n0,0,0,20\n0,0,1,120\n", encoding="utf-8-sig")
    np.testing.assert_allclose(shape_on(nodes, file, 20.0), [0.0, 0.25, 1.0], atol=1e-15)


def test_a_field_of_one_point_that_is_listed_twice_is_the_same_everywhere(tmp_path):
    (tmp_path / "hot.csv").write_text("x,y,z,T\n0,0,0,50\n0,0,0,50\n")
    nodes = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    np.testing.assert_array_equal(shape_on(nodes, tmp_path / "hot.csv", 20.0), [1.0, 1.0])


def test_a_field_that_is_the_same_everywhere_answers_as_none(tmp_path):
    write(tmp_path, corners(), np.full(8, 100.0))
    field = warmed(bar(tmp_path, nonlinear=True))
    whole = table({"fixed": ["z0"]}, STEEL, nonlinear=True)
    whole["interface"]["coupling"] = "distributed"
    mesh = box("hex20", (1, 2, 8), tuple(SIZE))
    uniform = warmed(Solver(build(bundle_of(whole, tmp_path), mesh)))
    np.testing.assert_allclose(field, uniform, rtol=1e-9, atol=1e-15)


def test_another_field_is_another_fingerprint(tmp_path):
    results = []
    for rise in (10.0, 11.0):
        write(tmp_path, corners(), np.arange(8.0) * rise)
        results.append(bar(tmp_path).component.bundle.fingerprint)
    assert results[0] != results[1]


@pytest.mark.parametrize("kept", [[0, 1, 2], [0, 2], [0]], ids=["space", "plane", "line"])
def test_points_of_a_plane_or_a_line_are_interpolated_in_it(tmp_path, kept):
    rng = np.random.default_rng(1)
    points, slope = np.zeros((60, 3)), np.array([1.0, 0.7, -0.4])
    points[:, kept] = rng.uniform(-1, 1, (60, len(kept)))
    corners = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
    points[:8, kept] = corners[:, kept]
    nodes = rng.uniform(-0.9, 0.9, (40, 3))
    rise = 100 * (2 + points[:, kept] @ slope[kept])
    text = "\n".join(f"{x!r},{y!r},{z!r},{t!r}" for x, y, z, t in np.c_[points, rise].tolist())
    (tmp_path / "t.csv").write_text("x,y,z,T\n" + text + "\n")
    result = shape_on(nodes, tmp_path / "t.csv", 0.0) * rise.max()
    np.testing.assert_allclose(result, 100 * (2 + nodes[:, kept] @ slope[kept]), rtol=1e-9)
