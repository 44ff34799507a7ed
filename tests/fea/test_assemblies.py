"""Bolts that are tightened, springs between two groups, and groups joined rigidly."""

from dataclasses import replace

import numpy as np
import pytest

from tests.fea.boxes import box
from tests.fea.calculix import require_ccx
from tests.fea.supports import TABLE, largest
from tests.fea.third_derivatives import unpacked
from tests.fea.two_interfaces import rod_between_loads
from tests.validation import calculix, second_opinion
from wrenchbook.fea.bundle.read import bundle_of
from wrenchbook.fea.check import as_text, report
from wrenchbook.fea.check.mechanisms import motion_problems
from wrenchbook.fea.component import build
from wrenchbook.fea.coupling import spring_motion
from wrenchbook.fea.failure import SolveFailed
from wrenchbook.fea.inspection import warnings_of
from wrenchbook.fea.mesh.bodies import bodies_of, coincident_nodes
from wrenchbook.fea.mesh.mesh import CellBlock, FacetBlock, FacetGroup, Mesh
from wrenchbook.fea.solve import Solver
from wrenchbook.fea.solver.vibration import Riding
from wrenchbook.fea.spec.problems import BundleError
from wrenchbook.fea.tensors import rotation, spin_per_vector, spin_slope

WRENCH = np.array([300.0, -200.0, -900.0, 90.0, 150.0, 60.0])
CHANGE = np.array([30.0, -10.0, 20.0, 2.0, 3.0, -4.0])
TURN = rotation(np.array([0.4, -0.7, 0.3]))
YOUNG, AREA = 3e9, 0.006
SPRING = [3e6, 2e6, 5e6, 2e4, 3e4, 1e4]
RNG = np.random.default_rng(5)
ROOT = RNG.standard_normal((6, 6)) * np.sqrt(SPRING)
FULL = (ROOT.T @ ROOT + np.diag(SPRING)).tolist()
BOLT = '[[bolt]]\nregion = "rod"\naxis = [0, 0, 1]\nforce = 2e4\npoint = [0, 0, 0.25]'


def assembly(mesh, *, nonlinear=False, zero="preloaded", **tables):
    """Build a component of plastic, its interface at z1 and clamped at z0 unless tables differ."""
    material = {"region": "all", "youngs_modulus": YOUNG, "poisson_ratio": 0.0, "density": 1e3}
    whole = TABLE | {"supports": {"fixed": ["z0"]}, "material": [material]} | tables
    whole["interface"] = {"section": "z1", "coupling": "rigid"} | tables.get("interface", {})
    whole["analysis"] = {"nonlinear": nonlinear} | tables.get("analysis", {})
    whole["analysis"] |= {"zero": zero} if "bolt" in tables else {}
    return build(bundle_of(whole, "."), mesh)


def bolt(**changes):
    return {"region": "all", "axis": [0, 0, 1], "force": 2e4} | changes


def clamped_bar(**options):
    """A bar of 1 m, clamped at both ends, with its interface at 5/6 and a bolt's cut at 0.3."""
    bar = box("hex20", (2, 2, 6), (0.1, 0.06, 1.0))
    bar = replace(bar, node_groups={"at": np.flatnonzero(np.abs(bar.points[:, 2] - 5 / 6) < 1e-9)})
    of_bolt = bolt(point=[0, 0, 0.3]) | options.pop("of_bolt", {})
    interface = {"section": "at"} | options.pop("interface", {})
    tables = {"bolt": [of_bolt], "interface": interface, "supports": {"fixed": ["z0", "z1"]}}
    return assembly(options.pop("mesh", bar), **tables, **options)


def part_of(group, renumber):
    return FacetGroup((FacetBlock("quad8", renumber(group.blocks[0].nodes)),))


def frame():
    """Two plates with a shank, and a sleeve beside it that it clamps, between them."""
    whole = box("hex20", (6, 2, 6), (0.3, 0.1, 0.6))
    x, _, z = whole.points[whole.blocks[0].nodes].mean(axis=1).T
    between = np.abs(z - 0.3) < 0.2
    kept = (np.abs(x - 0.15) > 0.05) | ~between
    used, nodes = np.unique(whole.blocks[0].nodes[kept], return_inverse=True)
    legs = [np.flatnonzero(where[kept]) for where in (between & (x < 0.1), between)]
    groups = {
        name: part_of(whole.facet_groups[name], lambda nodes: np.searchsorted(used, nodes))
        for name in ("z0", "z1")
    }
    regions = {"shank": (legs[0],), "legs": (legs[1],)}
    cells = CellBlock("hex20", nodes.reshape(-1, 20))
    return Mesh(whole.points[used], (cells,), regions, groups)


def blocks(gap=0.0):
    """Two bars of 0.5 m in a line, from a0 to a1 and from b0 to b1."""
    first, groups = box("hex20", (2, 2, 3), (0.1, 0.06, 0.5)), {}
    size = len(first.points)
    points = np.vstack([first.points, first.points + np.array([0, 0, 0.5 + gap])])
    cells = CellBlock("hex20", np.concatenate([first.blocks[0].nodes + n for n in (0, size)]))
    for body, start in (("a", 0), ("b", size)):
        for end in (0, 1):
            own = part_of(first.facet_groups[f"z{end}"], lambda nodes, n=start: nodes + n)
            groups[f"{body}{end}"] = own
    return Mesh(points, (cells,), {"all": (np.arange(24),), "a": (np.arange(12),)}, groups)


def joined(joint, mesh=None, **options):
    spring = {"groups": ["a1", "b0"], "coupling": "rigid"} | joint
    tables = {"supports": {"fixed": ["a0"]}, "interface": {"section": "b1"}}
    tables["interface"] |= options.pop("interface", {})
    return assembly(mesh or blocks(gap=0.1), spring=[spring], **tables, **options)


@pytest.mark.parametrize("nonlinear", [False, True])
def test_a_bolt_gives_the_shank_its_tension_and_the_energy_is_the_work(nonlinear):
    solver = Solver(clamped_bar(nonlinear=nonlinear))
    tight = solver.solve(np.zeros(6))
    np.testing.assert_allclose(
        solver.stresses(tight)[:, 2] * AREA, 2e4, rtol=3e-3 if nonlinear else 1e-9
    )
    for result in (tight, solver.solve(WRENCH)):
        assert result.work == pytest.approx(result.strain_energy, rel=1e-6)
    assert not tight.displacement.any()


@pytest.mark.parametrize("keeps", ["length", "force"])
def test_the_work_of_a_warmed_bolt_is_the_strain_energy(keeps):
    material = {"region": "all", "youngs_modulus": YOUNG, "poisson_ratio": 0.3}
    material["thermal_expansion"] = 80e-6
    inputs = {"temperature": {"range": [-40, 120], "reference": 20}}
    part = clamped_bar(of_bolt={"keeps": keeps}, material=[material], inputs=inputs)
    result = Solver(part).solve([*WRENCH, 70.0])
    assert result.work == pytest.approx(result.strain_energy, rel=1e-9)


def test_a_bolt_that_keeps_its_length_shares_a_load_and_one_that_keeps_its_force_does_not():
    """The joint's diagram: two springs of EA/L, of which the lower is the bolt's."""
    for keeps, stiffness in (("length", 6 / 5 + 6), ("force", 6)):
        solver = Solver(clamped_bar(of_bolt={"keeps": keeps}))
        assert solver.solve(WRENCH).displacement[2] == pytest.approx(
            -900 / (YOUNG * AREA * stiffness), rel=1e-9
        )
        tensions = np.unique(
            np.round(solver.stresses(solver.solve([0, 0, -900.0, 0, 0, 0]))[:, 2] * AREA, 6)
        )
        share = 6 / 5 / stiffness if keeps == "length" else 0.0
        np.testing.assert_allclose(tensions, [2e4 - 900 * share, 2e4 + 900 * (1 - share)])


def test_the_compliance_mass_and_frequency_are_those_of_the_part_without_a_cut():
    cut = clamped_bar()
    plain = replace(cut, mesh=cut.uncut, bolts=())
    own, other = Solver(cut), Solver(plain)
    assert largest(own.compliance - other.compliance, other.compliance) < 1e-10
    swings = [solver.vibration(Riding.of(2.0)) for solver in (own, other)]
    assert swings[0].mass == pytest.approx(swings[1].mass, rel=1e-12)
    assert swings[0].frequency == pytest.approx(swings[1].frequency, rel=1e-9)
    matrices = [solver.craig_bampton(4) for solver in (own, other)]
    np.testing.assert_allclose(matrices[0].mass[:12, :12], matrices[1].mass[:12, :12], atol=1e-9)
    assert own.unknowns == other.unknowns
    assert warnings_of(cut) == warnings_of(plain)


def test_the_zero_of_displacement_changes_displacements_alone():
    tight, loose = (Solver(clamped_bar(zero=zero)) for zero in ("preloaded", "untightened"))
    result, other = tight.solve(WRENCH), loose.solve(WRENCH)
    shift = -2e4 / 6 / (YOUNG * AREA)  # the upper sixth is longer by F L / EA
    np.testing.assert_allclose(
        other.displacement - result.displacement, [0, 0, shift, 0, 0, 0], atol=1e-15
    )
    np.testing.assert_array_equal(result.nodes, other.nodes)


def per_load(result, wrench):
    """Return d(u, r)/d(F, mu), (6, 6), where mu = J(r)^T M, and the change of (F, mu)."""
    vector, rates = result.displacement[3:], np.eye(6)
    rates[3:, 3:] = spin_per_vector(vector).T
    rates[3:] += spin_slope(vector, wrench[3:]) @ result.compliance[3:]
    return result.compliance @ np.linalg.inv(rates), rates


def gaps_to_differences(solver, wrench, change):
    """Return how far compliance and curvature are from differences of solves, relative."""
    result = solver.solve(wrench)
    ahead, behind = (solver.solve(wrench + s * change, start=result.state) for s in (1, -1))
    own, rates = per_load(result, wrench)
    size = np.sqrt(np.diagonal(own))
    slope = (ahead.displacement - behind.displacement) / size / 2
    bend = per_load(ahead, wrench + change)[0] - per_load(behind, wrench - change)[0]
    bend /= 2 * np.outer(size, size)
    curvature = unpacked(result.curvature) @ (rates @ change) / np.outer(size, size)
    return largest(result.compliance @ change / size - slope, slope), largest(
        curvature - bend, bend
    )


@pytest.mark.parametrize("interface", ["rigid", "distributed"])
@pytest.mark.parametrize("keeps", ["length", "force"])
def test_answers_relative_to_the_tightened_part_have_their_derivatives(interface, keeps):
    """The sleeve beside the shank bends as it is tightened, so that the zero is turned."""
    own = bolt(region="shank", force=4e4, keeps=keeps)
    one = assembly(frame(), nonlinear=True, bolt=[own], interface={"coupling": interface})
    solver = Solver(one)
    assert np.linalg.norm(solver._origin[3:]) > 0.07
    assert not solver.solve(np.zeros(6)).displacement.any()
    slope, bend = gaps_to_differences(solver, 4 * WRENCH, CHANGE)
    assert slope < 1e-7
    assert bend < 1e-6


@pytest.mark.parametrize("coupling", ["rigid", "distributed"])
def test_a_spring_between_groups_has_its_derivatives_at_finite_rotations(coupling):
    joint = {"stiffness": FULL, "coupling": coupling, "axes": TURN.tolist()}
    solver = Solver(joined(joint, nonlinear=True))
    result = solver.solve(2 * WRENCH)
    assert np.degrees(np.linalg.norm(result.displacement[3:])) > 7
    assert result.work == pytest.approx(result.strain_energy, rel=1e-3)
    slope, bend = gaps_to_differences(solver, 2 * WRENCH, 0.02 * CHANGE)
    assert slope < 1e-7
    assert bend < 1e-6
    motion = result.state.frames[-6:]
    assert (
        np.abs(spring_motion.relative_motion(np.tile(motion, 2))[0]).max() < 1e-15
    )  # a rigid motion of both


@pytest.mark.parametrize("coupling", ["rigid", "distributed"])
def test_blocks_joined_by_a_spring_have_the_compliance_of_all_in_series(coupling):
    solver = Solver(joined({"stiffness": SPRING, "coupling": coupling}))
    assert solver.compliance[2, 2] == pytest.approx(1 / (YOUNG * AREA) + 1 / SPRING[2], rel=1e-10)
    assert solver.linear.energy_gap < 1e-12


def test_the_groups_of_a_spring_move_by_its_weights():
    joint = {"stiffness": SPRING, "coupling": "distributed"}
    equal, by_area = (
        joined(joint | {"weights": name}).joints[0].ends for name in ("equal", "area")
    )
    assert [np.ptp(end.section.weights) for end in equal] == [0, 0]
    assert all(np.ptp(end.section.weights) > 0 for end in by_area)


@pytest.mark.parametrize("joint", [{"stiffness": SPRING}, {"rigid": True}])
def test_surfaces_that_touch_and_are_joined_by_a_spring_need_no_merging(joint):
    loose = assembly(blocks(), supports={"fixed": ["a0"]}, interface={"section": "b1"})
    merging = [
        str(warnings_of(own)).count("same coord") for own in (joined(joint, blocks()), loose)
    ]
    assert merging == [0, 1]


def test_the_check_reports_a_bolt_and_what_only_it_holds(tmp_path):
    """A rod that is fixed in its middle, so that its end is loose as the bolt is tightened."""
    folder = rod_between_loads(tmp_path)
    for name, old, new in (
        ("rod.inp", "TYPE=C3D20R", "TYPE=C3D20R, ELSET=rod"),
        ("component.toml", "[analysis]", f"{BOLT}\n[analysis]"),
    ):
        text = (folder / name).read_text()
        (folder / name).write_text(text.replace(old, new, 1))
    summary = report(folder)
    (own,) = summary["bolts"]
    assert own["area"] == pytest.approx(4e-4)
    assert own["stress"] == pytest.approx(5e7)
    assert "cut below 4 cells near (0.01, 0.01, 0.25) m, 400 mm^2, mean stress 50 MPa" in as_text(
        summary
    )
    assert [problem["where"] for problem in summary["problems"]] == ["bolt"]


@pytest.mark.parametrize("nonlinear", [False, True])
@pytest.mark.parametrize("kind", ["length", "force", "diagonal", "full", "rigid"])
def test_calculix_finds_the_same_with_a_bolt_or_a_joint(nonlinear, kind):
    """A spring's first block is hardly turned, as the deck's spring does not turn with it."""
    require_ccx()
    if kind in ("length", "force"):
        options = {"of_bolt": {"keeps": kind, "axis": [0.1, 0, 1]}, "zero": "untightened"}
        options |= {"interface": {"axes": TURN.tolist()}, "analysis": {"gravity": [300, 0, -500]}}
        own = clamped_bar(nonlinear=nonlinear, **options)
    else:
        joint = {"rigid": True} if kind == "rigid" else {"stiffness": SPRING}
        joint |= {"stiffness": FULL} if kind == "full" else {}
        stiff = {"region": "a", "youngs_modulus": 1e5 * YOUNG, "poisson_ratio": 0.0}
        soft = stiff | {"region": "all", "youngs_modulus": YOUNG}
        joint |= {"axes": TURN.tolist()}
        own = joined(joint, nonlinear=nonlinear, material=[stiff, soft])
    result = Solver(own).solve(WRENCH).displacement
    reply = calculix.solve_rigid(own, WRENCH, result[3:] if nonlinear else None)
    limit = 1e-4 if nonlinear else 1e-5
    assert second_opinion.difference(result, reply.displacement) < limit


def test_a_motion_that_only_bolts_or_no_spring_hold_is_named_and_refused():
    bar = box("hex20", (2, 2, 6), (0.1, 0.06, 1.0))
    for own, text in (
        (assembly(bar, bolt=[bolt()]), "while they are tightened: it can slide along (0, 0, 1)"),
        (joined({"stiffness": [1e6, 1e6, 0, 1e3, 1e3, 1e3]}), "it can slide along (0, 0, 1)"),
    ):
        whole = own.uncut_mesh
        (problem,) = motion_problems(own, bodies_of(whole), coincident_nodes(whole))
        assert text in problem.message
        with pytest.raises(SolveFailed, match=r"mechanism|without any resistance"):
            Solver(own).solve(WRENCH)


def test_an_axis_off_the_shank_is_named_with_its_angle_and_the_axis_to_write():
    lean = np.radians(17)
    for axis, degrees in ([0, 0, 1], None), ([np.sin(lean), 0, np.cos(lean)], 17):
        part = clamped_bar(of_bolt={"axis": [float(x) for x in axis]})
        results = [each.message for each in warnings_of(part) if each.where == "bolt[0].axis"]
        assert bool(results) == bool(degrees)
        assert all(
            "17 degrees off" in text and "axis = [0.0, 0.0, 1.0]" in text for text in results
        )


def test_a_preload_that_the_part_does_not_carry_is_named_with_the_force_reached():
    part = assembly(frame(), bolt=[bolt(region="shank", force=1e7)], nonlinear=True)
    text = r"The preload of bolt\[0\], 1e\+07 N, exceeds .*; the solve reached .*e\+05 N"
    with pytest.raises(SolveFailed, match=text) as failure:
        Solver(part).solve(np.zeros(6))
    assert failure.value.remedy.startswith("Reduce force under [[bolt]]")
    stretched = assembly(frame(), bolt=[bolt(region="shank", force=0.2 * YOUNG * AREA)])
    assert "is a strain of 0." in str(warnings_of(stretched))


def test_a_group_of_facets_cuts_as_a_region_does_and_a_jagged_cut_too():
    cut = clamped_bar()
    (block,) = cut.uncut.blocks
    face = np.flatnonzero(np.abs(cut.uncut.points[:, 2] - 1 / 3) < 1e-9)
    lower = block.nodes[np.isin(block.nodes[:, 4:8], face).all(axis=1)]
    facets = FacetGroup((FacetBlock("quad8", lower[:, [4, 5, 6, 7, 12, 13, 14, 15]]),))
    named = replace(cut.uncut, facet_groups=cut.uncut.facet_groups | {"across": facets})
    by_group = clamped_bar(mesh=named, of_bolt={"region": None, "group": "across", "point": None})
    np.testing.assert_array_equal(by_group.bolts[0].nodes, cut.bolts[0].nodes)
    assert by_group.bolts[0].area == pytest.approx(AREA)
    jagged = box("tet10", (2, 2, 6), (0.1, 0.06, 1.0))
    at = np.flatnonzero(np.abs(jagged.points[:, 2] - 5 / 6) < 1e-9)
    cut = clamped_bar(mesh=replace(jagged, node_groups={"at": at}), of_bolt={"point": [0, 0, 0.42]})
    assert np.ptp(cut.mesh.points[cut.bolts[0].nodes, 2]) > 0.1
    assert cut.bolts[0].area == pytest.approx(AREA)
    solver = Solver(cut)
    tensions = solver.stresses(solver.solve(np.zeros(6)))[:, 2] * AREA
    np.testing.assert_allclose(tensions, 2e4, rtol=1e-9)


def test_a_cut_or_a_joint_that_will_not_do_is_refused_by_name():
    bar = box("hex20", (2, 2, 6), (0.1, 0.06, 1.0))
    half = np.flatnonzero(bar.points[bar.blocks[0].nodes, 0].mean(axis=1) < 0.05)
    bar = replace(bar, regions=bar.regions | {"half": (half,)})
    joint = {"groups": ["z1", "x0"], "coupling": "rigid", "rigid": True}
    for mesh, tables, text in (
        (bar, {"bolt": [bolt()], "supports": {"fixed": ["x0"]}}, "also belong to supports.fixed"),
        (
            bar,
            {"bolt": [bolt(point=[0, 0, 9.0])]},
            "sides of its cut, 9 m along axis; the region is from 0 to 1 m",
        ),
        (
            box("hex20", (2, 2, 1), (0.1, 0.06, 1.0)),
            {"bolt": [bolt(point=[0, 0, 0.5])]},
            "has only one layer of cells at its cut, 0.5 m along axis; mesh the shank",
        ),
        (bar, {"bolt": [bolt(region=None, group="z0")]}, '"z0" has cells on one side only'),
        (bar, {"bolt": [bolt(region="half")]}, "with cells outside the region"),
        (bar, {"bolt": [bolt(region=None, group="x0")]}, "does not cut through"),
        (frame(), {"bolt": [bolt(region="legs")]}, "2 separate shanks"),
        (bar, {"spring": [joint]}, "shares 21 nodes"),
    ):
        with pytest.raises(BundleError, match=text):
            assembly(mesh, **tables)
