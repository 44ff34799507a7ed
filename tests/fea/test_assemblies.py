"""Bolts that are tightened, springs between two groups, and groups joined rigidly."""

from dataclasses import replace

import numpy as np
import pytest

from tests.fea.boxes import box
from tests.fea.calculix import require_ccx
from tests.fea.supports import TABLE, largest
from tests.fea.third_derivatives import unpacked
from tests.validation import calculix, second_opinion
from wrenchbook.fea.bundle.read import bundle_of
from wrenchbook.fea.check.findings import motion_problems
from wrenchbook.fea.component import build
from wrenchbook.fea.coupling import relative
from wrenchbook.fea.export.calculix import deck_of
from wrenchbook.fea.failure import SolveFailed
from wrenchbook.fea.inspection import bodies_of, coincident_nodes, warnings_of
from wrenchbook.fea.mesh.mesh import CellBlock, FacetBlock, FacetGroup, Mesh
from wrenchbook.fea.mesh.refine import halved
from wrenchbook.fea.solve import Solver
from wrenchbook.fea.solver.vibration import Riding
from wrenchbook.fea.spec.problems import BundleError
from wrenchbook.fea.tensors import rotation, spin_per_vector

WRENCH = np.array([300.0, -200.0, -900.0, 90.0, 150.0, 60.0])
TURN = rotation(np.array([0.4, -0.7, 0.3]))
YOUNG, AREA = 3e9, 0.006
SPRING = [3e6, 2e6, 5e6, 2e4, 3e4, 1e4]
RNG = np.random.default_rng(5)
ROOT = RNG.standard_normal((6, 6)) * np.sqrt(SPRING)
FULL = (ROOT.T @ ROOT + np.diag(SPRING)).tolist()
LOADS = {"force": [1, 1, 1], "moment": [1, 1, 1]}


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


def clamped_bar(tmp=None, **options):
    """A bar of 1 m, clamped at both ends, with its interface at 5/6 and a bolt's cut at 0.3."""
    bar = box("hex20", (2, 2, 6), (0.1, 0.06, 1.0))
    bar = replace(bar, node_groups={"at": np.flatnonzero(np.abs(bar.points[:, 2] - 5 / 6) < 1e-9)})
    of_bolt = bolt(point=[0, 0, 0.3]) | options.pop("of_bolt", {})
    interface = {"section": "at"} | options.pop("interface", {})
    tables = {"bolt": [of_bolt], "interface": interface, "supports": {"fixed": ["z0", "z1"]}}
    return assembly(options.pop("mesh", bar), **tables, **options)


def frame():
    """A ring of cells: a shank between two plates, and a sleeve beside it that they clamp."""
    whole = box("hex20", (6, 2, 6), (0.3, 0.1, 0.6))
    (block,) = whole.blocks
    x, _, z = whole.points[block.nodes].mean(axis=1).T
    kept = (np.abs(x - 0.15) > 0.05) | (np.abs(z - 0.3) > 0.2)
    used, nodes = np.unique(block.nodes[kept], return_inverse=True)
    shank = np.flatnonzero((x[kept] < 0.1) & (np.abs(z[kept] - 0.3) < 0.2))
    cells = CellBlock("hex20", nodes.reshape(-1, 20))
    groups = {
        name: FacetGroup(
            (FacetBlock("quad8", np.searchsorted(used, whole.facet_groups[name].blocks[0].nodes)),)
        )
        for name in ("z0", "z1")
    }
    return Mesh(whole.points[used], (cells,), {"shank": (shank,)}, groups)


def blocks(gap=0.0, offset=0.0):
    """Two bars of 0.5 m in a line, a0 to a1 and b0 to b1."""
    first = box("hex20", (2, 2, 3), (0.1, 0.06, 0.5))
    second = first.points + [offset, 0, 0.5 + gap]
    size = len(first.points)
    cells = CellBlock("hex20", np.concatenate([first.blocks[0].nodes + n for n in (0, size)]))
    groups = {
        f"{body}{end}": FacetGroup(
            (FacetBlock("quad8", first.facet_groups[f"z{end}"].blocks[0].nodes + n),)
        )
        for body, n in (("a", 0), ("b", size))
        for end in (0, 1)
    }
    return Mesh(np.vstack([first.points, second]), (cells,), {"all": (np.arange(24),)}, groups)


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
    factor = 1.0 if nonlinear else 2.0  # linear: that of all loads at their full size
    for found in (tight, solver.solve(WRENCH)):
        assert found.work == pytest.approx(factor * found.strain_energy, rel=1e-6)
    assert not tight.displacement.any()


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
    found, other = tight.solve(WRENCH), loose.solve(WRENCH)
    shift = -2e4 / 6 / (YOUNG * AREA)  # the upper sixth is longer by F L / EA
    np.testing.assert_allclose(
        other.displacement - found.displacement, [0, 0, shift, 0, 0, 0], atol=1e-15
    )
    np.testing.assert_array_equal(found.nodes, other.nodes)


@pytest.mark.parametrize("interface", ["rigid", "distributed"])
@pytest.mark.parametrize("keeps", ["length", "force"])
def test_answers_relative_to_the_tightened_part_have_their_derivatives(interface, keeps):
    """A shank beside its sleeve bends the part as it is tightened, so that the zero is turned."""
    own = bolt(region="shank", force=4e4, keeps=keeps)
    solver = Solver(
        assembly(frame(), nonlinear=True, bolt=[own], interface={"coupling": interface})
    )
    assert np.linalg.norm(solver._origin[3:]) > 0.02
    assert not solver.solve(np.zeros(6)).displacement.any()
    wrench = 4 * WRENCH
    found, active = solver.solve(wrench), np.arange(6)
    steps = np.repeat([40.0, 4.0], 3)
    ends = [
        [solver.solve(wrench + s * steps * unit, start=found.state) for s in (1, -1)]
        for unit in np.eye(6)
    ]
    slopes = np.stack(
        [(a.displacement - b.displacement) / (2 * h) for (a, b), h in zip(ends, steps)], axis=1
    )
    print(
        largest(slopes - found.compliance, found.compliance),
        np.linalg.norm(solver._origin[3:]),
        found.displacement,
    )
    assert largest(slopes - found.compliance, found.compliance) < 1e-6

    def per_load(answer, at):
        """Compliance by the loads (F, mu) of the relative rotation; mu = J(r)^T M."""
        vector, rates = answer.displacement[3:], np.eye(6)
        step = 1e-5 * np.eye(3)
        slope = [
            (spin_per_vector(vector + h).T - spin_per_vector(vector - h).T) @ at[3:] for h in step
        ]
        rates[3:, 3:] = spin_per_vector(vector).T
        rates[3:] += np.stack(slope, axis=1) / 2e-5 @ answer.compliance[3:]
        return answer.compliance @ np.linalg.inv(rates), rates

    own, rates = per_load(found, wrench)
    size = np.sqrt(np.diagonal(own))
    assert np.abs((own - own.T) / np.outer(size, size)).max() < 1e-7
    changes = np.stack(
        [
            (per_load(a, wrench + h * unit)[0] - per_load(b, wrench - h * unit)[0]) / (2 * h)
            for (a, b), h, unit in zip(ends, steps, np.eye(6))
        ],
        axis=2,
    ) @ np.linalg.inv(rates)
    tensor = unpacked(found.curvature)
    print(
        np.abs((own - own.T) / np.outer(size, size)).max(),
        largest(
            (tensor - changes) / np.einsum("a,b,c->abc", size, size, size),
            tensor / np.einsum("a,b,c->abc", size, size, size),
        ),
    )
    assert (
        largest(
            (tensor - changes) / np.einsum("a,b,c->abc", size, size, size),
            tensor / np.einsum("a,b,c->abc", size, size, size),
        )
        < 1e-4
    )


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
