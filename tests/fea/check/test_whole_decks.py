"""Decks of several files, with local axes, couplings of some freedoms and cells of all kinds."""

import shutil

import numpy as np
import pytest

from tests.fea import calculix
from tests.fea.cae import cards
from tests.fea.check.test_load_cases import (
    BAR,
    HEAD,
    HELD,
    MID,
    PULL,
    RIGID,
    ROOT_HELD,
    TIP,
    bulk,
    proposal,
    step,
    tip,
    tips_by_calculix,
)
from wrenchbook.fea.bundle.read import BundleError, read_bundle
from wrenchbook.fea.check import as_text
from wrenchbook.fea.check import report as check
from wrenchbook.fea.check.proposal import propose
from wrenchbook.fea.mesh.element_order import second_order
from wrenchbook.fea.mesh.io.read import read_mesh
from wrenchbook.fea.mesh.refine import halved
from wrenchbook.fea.solve import Solver
from wrenchbook.fea.spec.material import Orthotropic

pytestmark = pytest.mark.usefixtures("estimates")


def compliance(folder):
    return Solver(read_bundle(folder)).linear.compliance


def in_files(folder, text, name, parts, include):
    """Write a deck of which each part, (start, end, file), stands in a file of its own."""
    for start, end, file in parts:
        first, last = text.index(start), text.index(end)
        (folder / file).parent.mkdir(exist_ok=True, parents=True)
        (folder / file).write_text(text[first:last])
        text = text[:first] + include.format(file) + text[last:]
    (folder / name).write_text(text)
    return folder / name


@pytest.mark.parametrize(
    ("text", "name", "parts", "include"),
    [
        (
            HELD,
            "a.inp",
            [("1,", "*ELEMENT", "mesh/nodes.txt"), ("*MATERIAL", "*RIGID", "b.inc")],
            "*INCLUDE, INPUT={}\n",
        ),
        (
            bulk(),
            "a.bdf",
            [("GRID", "CHEXA", "mesh/grid.bdf"), ("SPC = 1", "BEGIN BULK", "case.bdf")],
            "INCLUDE '{}'\n",
        ),
    ],
    ids=["abaqus", "nastran"],
)
def test_a_deck_of_several_files_is_the_deck_of_its_lines(tmp_path, text, name, parts, include):
    (tmp_path / name.replace("a", "whole")).write_text(text)
    propose(tmp_path / name.replace("a", "whole"), tmp_path / "one", "mm")
    result = propose(in_files(tmp_path, text, name, parts, include), tmp_path / "new", "mm")
    assert "INCLUDE" not in (tmp_path / "new" / "a.inp").read_text()  # the proposal is complete
    assert result["check"]["ok"]
    assert (compliance(tmp_path / "new") == compliance(tmp_path / "one")).all()


def included(folder):
    """Return a component whose deck has its nodes and supports in other files."""
    (folder / "deck.inp").write_text(HELD)
    propose(folder / "deck.inp", folder / "new", "mm")
    text = (folder / "new" / "deck.inp").read_text().replace("NALL", "NALL, INPUT=n.txt", 1)
    first, last = text.index("\n", text.index("*NODE")) + 1, text.index("*ELEMENT")
    (folder / "new" / "n.txt").write_text(text[first:last])
    text, parts = text[:first] + text[last:], [("*BOUNDARY", "*CLOAD", "held.inc")]
    in_files(folder / "new", text, "deck.inp", parts, '*INCLUDE, INPUT="{}"\n')
    return folder / "new"


def test_the_fingerprint_of_a_deck_is_of_its_included_files_too(tmp_path):
    folder = included(tmp_path)
    before = read_bundle(folder).fingerprint
    assert compliance(folder)[2, 2] > 0
    (folder / "n.txt").write_text((folder / "n.txt").read_text() + "9999, 0., 0., 0.\n")
    assert read_bundle(folder).fingerprint != before


def test_an_included_file_that_is_a_link_out_of_the_folder_is_refused(tmp_path):
    folder = included(tmp_path)
    shutil.move(folder / "n.txt", tmp_path / "n.txt")
    (folder / "n.txt").symlink_to(tmp_path / "n.txt")
    with pytest.raises(BundleError, match="outside the folder of the deck"):
        read_bundle(folder)


PLY = "*ELASTIC, TYPE=ENGINEERING CONSTANTS\n135e3, 10e3, 9e3, .3, .25, .4, 5e3, 4e3,\n3.5e3\n"
HOLD = "*BOUNDARY\nROOT, 1, 3\n"
ORIENTATIONS = {
    "axes through points": "\n1., 1., 0.3, -1., 1., 0.",
    "axes turned about the third": ", SYSTEM=RECTANGULAR\n1., 1., 0., -1., 1., 0.\n3, 20.",
    "a cylinder": ", SYSTEM=CYLINDRICAL\n0., 5., -40., 0., 5., -30.",
}


STIFF = Orthotropic("all", (135e3, 10e3, 9e3), (0.3, 0.25, 0.4), (5e3, 4e3, 3.5e3)).elasticity
NINE = [f"{x:.10g}" for x in (*STIFF[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]], *np.diag(STIFF)[3:])]
ORTHO = f"*ELASTIC, TYPE=ORTHO\n{', '.join(NINE[:8])}\n{NINE[8]}\n"


def laminate(rows, constants=PLY):
    """Return the bar of an orthotropic material with an orientation of such rows."""
    text = HEAD.replace("*ELASTIC\n70000., 0.3\n", constants)
    text = text.replace("*MATERIAL", f"*ORIENTATION, NAME=Ply{rows}\n*MATERIAL")
    return text.replace("MATERIAL=ALU\n", "MATERIAL=ALU, ORIENTATION=PLY\n") + RIGID


@pytest.mark.parametrize(
    ("name", "constants"), [*((name, PLY) for name in ORIENTATIONS), ("a cylinder", ORTHO)]
)
def test_an_orientation_turns_nine_constants_as_in_calculix(tmp_path, name, constants):
    text = laminate(ORIENTATIONS[name], constants) + step(HOLD + PULL)
    result = proposal(tmp_path, text)
    assert (result["left"], result["check"]["warnings"]) == ([], [])
    assert tip(tmp_path) == pytest.approx(tips_by_calculix(tmp_path, text)[0], rel=1e-5)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("axes = [[0.69", "#", "in other directions"),
        ("135e3, 10e3", "135e3, 11e3", "1.1e+10, 9e+09 in SI; the component has 1.35e+11, 1e+10"),
        (PLY, "*ELASTIC\n70000., 0.3\n", "which is isotropic"),
        ("-1., 1., 0.\n", "2., 2., 0.6\n", "*ORIENTATION is not imported"),
        (
            "NAME=Ply",
            "NAME=Ply, SYSTEM=SPHERICAL",
            "it has SYSTEM=SPHERICAL and DEFINITION=COORDINATES; write",
        ),
        ("ORIENTATION=PLY", "ORIENTATION=OTHER", 'orientation "OTHER", which is not imported'),
    ],
)
def test_a_component_of_other_directions_than_its_deck_is_warned_of(tmp_path, old, new, words):
    proposal(tmp_path, laminate(ORIENTATIONS["axes through points"]) + step(HOLD + PULL))
    for path in (tmp_path / "new").iterdir():
        path.write_text(path.read_text().replace(old, new))
    warnings = check(tmp_path / "new")["warnings"]
    assert any(words in warning["message"] for warning in warnings), warnings


PLIES = {"": "\n1., 0., 0., 0., 1., 0.", "-1": "\n1., 0., 0., 0., 1., 0."}
PLIES |= {"5": "\n1., 1., 0.3, -1., 1., 0.", "6": ORIENTATIONS["a cylinder"]}
SYSTEM = "CORD2R,5,,0.,0.,0.,-.3,-.3,2.\n+,1.,1.,.3\nCORD2C,6,,0.,5.,-40.,0.,5.,-30.\n+,1.,5.,-40."


@pytest.mark.parametrize(("system", "across"), [("5", 0.0), ("6", 0.0), ("-1", 0.0), ("", 1.0)])
def test_an_orthotropic_mat9_is_that_of_abaqus_and_another_is_named(tmp_path, system, across):
    stiff = STIFF[:, [0, 1, 2, 3, 5, 4]][[0, 1, 2, 3, 5, 4]]
    stiff[1, 4] = across
    fields = [f"{each:.10g}" for each in [1, *stiff[np.triu_indices(6)], 1.6e-9]]
    lines = [",".join(["+", *fields[i : i + 8]]) for i in range(0, len(fields), 8)]
    text = bulk().replace("MAT1,1,70000.,,.3", "MAT9" + "\n".join(lines)[1:])
    text = text.replace("PSOLID,1,1", f"PSOLID,1,1,{system}\n{SYSTEM}")
    left = " ".join(proposal(tmp_path, text, name="deck.bdf")["left"])
    assert ("not orthotropic" in left, "CORDM of PSOLID" in left) == (across > 0, system == "-1")
    if across:
        return
    (material,) = read_bundle(tmp_path / "new").materials
    assert material.density == pytest.approx(1600)
    (tmp_path / "b").mkdir()
    proposal(tmp_path / "b", laminate(PLIES[system]) + step(HOLD + PULL))
    assert tip(tmp_path) == pytest.approx(tip(tmp_path / "b"), rel=1e-7)


TURNED = "*TRANSFORM, NSET=MID\n3., 0., 4., 0., 1., 0.\n"
SLIDING = HEAD + TURNED + RIGID + step(f"{HOLD}MID, 3\n{PULL}")


def test_nodes_of_turned_axes_are_held_along_these_as_in_calculix(tmp_path):
    result = proposal(tmp_path, SLIDING)
    assert (result["left"], result["check"]["warnings"]) == ([], [])
    assert tip(tmp_path) == pytest.approx(tips_by_calculix(tmp_path, SLIDING)[0], rel=1e-5)
    assert tip(tmp_path) < 0.5 * ROOT_HELD


@pytest.mark.parametrize(
    ("rows", "locked"), [("9000, 1", ()), ("9000, 1\n9000, 2\n9000, 3", ("ux", "uy", "uz"))]
)
def test_a_point_that_is_held_along_turned_axes_is_not_locked_along_others(tmp_path, rows, locked):
    turned = "*NSET, NSET=P\n9000\n*TRANSFORM, NSET=P\n0.6, 0.8, 0., -0.8, 0.6, 0.\n"
    text = HEAD + RIGID + turned + step(f"{HOLD}{rows}\n*CLOAD\n9001, 1, 100.\n")
    left = proposal(tmp_path, text)["left"]
    assert read_bundle(tmp_path / "new").interface.locked == locked
    assert any("write axes and locked" in line for line in left) == (not locked)


def test_nodes_by_local_coordinates_of_abaqus_are_the_same_nodes(tmp_path):
    x, y, z = (BAR.points - [7.0, 5.0, -2.0]).T  # 1 along y, 2 along z
    cylinder = [np.hypot(y, z), np.degrees(np.arctan2(z, y)), x]
    start, end = HEAD.index("1, "), HEAD.index("9000,")
    for option, columns in (("", [y, z, x]), (", SYSTEM=C", cylinder)):
        rows = enumerate(np.transpose(columns).tolist(), 1)
        local = "".join(f"{i}, {a:.12g}, {b:.12g}, {c:.12g}\n" for i, (a, b, c) in rows)
        axes = "*SYSTEM\n7., 5., -2., 7., 6., -2.\n7., 6., 4.\n"
        text = f"{axes}*NODE{option}\n{local}*SYSTEM\n*NODE\n{HEAD[end:]}"
        (tmp_path / "a.inp").write_text(HEAD[:start].replace("*NODE, NSET=NALL\n", "") + text)
        points = read_mesh(tmp_path / "a.inp", "mm").points
        np.testing.assert_allclose(points, BAR.points / 1e3, atol=1e-12)


SYSTEMS = """CORD2R,1,,7.,5.,-2.,8.,5.,-2.
+,7.,6.,-2.
CORD2C,2,1,0.,1.,0.,0.,1.,5.
+,2.,1.,0.
CORD2S,3,1,0.,0.,0.,0.,0.,1.
+,1.,0.,0.
CORD1R,4,9991,9992,9993
GRID,9991,,1.,1.,1.
GRID,9992,,.2,1.,1.6
GRID,9993,,1.6,1.,1.8
SPC1,1,3,MIDDLE
FORCE,2,9000,4,100.,.8,0.,.6
ENDDATA"""


def test_nastran_systems_of_nodes_supports_and_loads(tmp_path):
    """System 1 has z along x of the bar and x along y, 2 and 3 are in it, 4 turns about y."""
    x, y, z = (BAR.points - [7.0, 5.0, -2.0]).T
    far = np.sqrt(x * x + y * y + z * z)
    rectangular = np.stack([y, z, x], axis=1)
    cylinder = np.stack([np.hypot(y, z - 1), np.degrees(np.arctan2(z - 1, y)), x], axis=1)
    sphere = np.stack([far, np.degrees(np.arccos(x / far)), np.degrees(np.arctan2(z, y))], axis=1)
    grids = []
    for i, rows in enumerate(zip(rectangular, cylinder, sphere, strict=True)):
        fields = ",".join(f"{each:.12f}" for each in rows[i % 3].tolist())
        grids.append(f"GRID,{i + 1},{i % 3 + 1},{fields},{4 if i + 1 in MID else ''}\n")
    text = bulk().replace("FORCE,2,9000,,100.,0.,0.,1.\n", "")
    text = text[: text.index("GRID")] + "".join(grids) + text[text.index("GRID        9000") :]
    middle = "\n".join(cards.card("SPC1", 1, 3, *MID))
    result = proposal(
        tmp_path,
        text.replace("ENDDATA", SYSTEMS).replace("SPC1,1,3,MIDDLE", middle),
        name="deck.bdf",
    )
    assert [line for line in result["left"] if "SPC set 7" not in line] == []
    points = read_mesh(tmp_path / "new" / "deck.inp", "mm").points
    np.testing.assert_allclose(points, BAR.points / 1e3, atol=1e-9)
    assert read_bundle(tmp_path / "new").range.high[:3] == pytest.approx(100)
    assert tip(tmp_path) == pytest.approx(tips_by_calculix(tmp_path, SLIDING)[0], rel=1e-5)


def test_midside_nodes_that_cells_lack_are_another_cells_or_new_and_held_as_ends(tmp_path):
    """All cells lack the first nodes, the first cell those of the second: the bar is the same."""
    corners = np.unique(BAR.blocks[0].nodes[:, :8]) + 1
    middles = np.setdiff1d(np.arange(len(BAR.points)) + 1, corners)
    lacking, shared = middles[::3], middles[1::3]
    text = bulk(lambda cell, node: node in (shared if cell == 1 else () if cell else lacking))
    result = proposal(tmp_path, text, name="deck.bdf")
    (note,) = [line for line in result["decide"] if "midside nodes that cells lack" in line]
    assert f"{len(lacking)} new, in their middle" in note
    mesh = read_mesh(tmp_path / "new" / "deck.inp", "mm")
    assert (len(mesh.points), mesh.cell_counts) == (len(BAR.points), BAR.cell_counts)
    assert tip(tmp_path) == pytest.approx(ROOT_HELD, rel=1e-6)


WEIGHTS = np.random.default_rng(1).uniform(0.5, 2, len(TIP)).round(3)


def test_a_mean_of_weighted_nodes_moves_as_in_calculix(tmp_path):
    x, y, z = WEIGHTS @ BAR.points[np.array(TIP) - 1] / WEIGHTS.sum()
    head = HEAD.replace("9000, 100., 5., 5.", f"9000, {x:.12g}, {y:.12g}, {z:.12g}")
    mean = "*ELEMENT, TYPE=DCOUP3D, ELSET=Mean\n8000, 9000\n*DISTRIBUTING COUPLING, ELSET=MEAN\n"
    rows = "".join(f"{node}, {weight}\n" for node, weight in zip(TIP, WEIGHTS, strict=True))
    text = head + mean + rows + step(HOLD + PULL)
    result = proposal(tmp_path, text)
    assert (result["left"], result["check"]["warnings"]) == ([], [])
    assert tip(tmp_path) == pytest.approx(tips_by_calculix(tmp_path, text)[0], rel=1e-5)


def weighted(weights):
    """Return the bar with an RBE3 of such weights at its tip, one after the other."""
    text = bulk()
    fields = (each for pair in zip(weights, TIP, strict=True) for each in (pair[0], 123, pair[1]))
    mean = "\n".join(cards.card("RBE3", 80, "", 9000, 123456, *fields))
    return text[: text.index("RBE2")] + mean + "\n" + text[text.index("SPC1") :]


@pytest.mark.parametrize("weights", [WEIGHTS, np.ones(len(TIP))], ids=["several", "equal"])
def test_an_rbe3_spreads_a_wrench_by_its_weights_as_these_forces_do_in_calculix(tmp_path, weights):
    """Its law: F w_i + w_i A^-1 M x b_i with A = sum w (b.b I - b b^T), of weights of sum 1."""
    calculix.require_ccx()
    result = proposal(tmp_path, weighted(weights), name="deck.bdf")
    assert ["SPC set 7" in line for line in result["left"]] == [True]
    w, points, wrench = weights / weights.sum(), BAR.points[np.array(TIP) - 1], np.arange(1.0, 7)
    arms = points - w @ points
    inertia = np.einsum("i,ij,ij", w, arms, arms) * np.eye(3) - (arms.T * w) @ arms
    lever = [100.0, 5.0, 5.0] - w @ points
    moment = wrench[3:] * 1e3 + np.cross(lever, wrench[:3])
    forces = w[:, None] * (wrench[:3] + np.cross(np.linalg.solve(inertia, moment), arms))
    rows = ((node, i, forces[j, i]) for j, node in enumerate(TIP) for i in range(3))
    loads = "".join(f"{node}, {i + 1}, {force:.12e}\n" for node, i, force in rows)
    text = HEAD + step(f"{HOLD}*CLOAD\n{loads}")
    moved = {row[0]: [*map(float, row[1:])] for row in calculix.printed([text], tmp_path)}
    u = np.array([moved[str(node)] for node in TIP])
    turned = np.linalg.solve(inertia, w @ np.cross(arms, u))
    mean = w @ u + np.cross(turned, lever)
    expected = np.append(mean / 1e3, turned)
    np.testing.assert_allclose(compliance(tmp_path / "new") @ wrench, expected, rtol=1e-5)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('"deck"', '"equal"', 'by weights of its own; interface says weights = "equal"'),
        ('"distributed"', '"rigid"', "interface.weights: has no effect on a rigid coupling"),
        ('"RBE3_80"\n', '"nodes_held_in_xyz"\n', "interface.weights: the deck has no weights"),
        (
            f"{TIP[3]}, 1\n",
            f"{TIP[3]}, -99.\n",
            "interface.weights: the deck weights add up to -79, not above 0",
        ),
        (
            f"{TIP[3]}, 1\n",
            "99999, 1\n",
            "interface.weights: 1 weighted nodes are not defined, or in no solid cell; correct",
        ),
    ],
)
def test_weights_that_are_not_the_decks_or_make_no_mean_are_named(tmp_path, old, new, words):
    proposal(tmp_path, weighted(np.ones(len(TIP))), name="deck.bdf")
    for path in (tmp_path / "new").iterdir():
        path.write_text(path.read_text().replace(old, new))
    lines = as_text(check(tmp_path / "new")).splitlines()
    assert any(words in line for line in lines), lines


def test_a_finer_mesh_and_one_of_midside_nodes_keep_the_weights_of_the_nodes(tmp_path):
    proposal(tmp_path, weighted(WEIGHTS), name="deck.bdf")
    mesh = read_mesh(tmp_path / "new" / "deck.inp", "mm")
    for other in (halved(mesh), second_order(mesh)):
        nodes, weights = other.node_weights["RBE3_80"]
        np.testing.assert_allclose(other.points[nodes], mesh.points[np.array(TIP) - 1], atol=1e-15)
        np.testing.assert_array_equal(weights, WEIGHTS)
