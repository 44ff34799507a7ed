"""A deck of several load cases becomes a component of one of them, and the others are listed."""

import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.fea import calculix
from tests.fea.boxes import box
from tests.fea.cae import cards
from tests.fea.written_deck import deck_lines
from tests.refusals import assert_told, cases, changed
from wrenchbook.fea.bundle.read import read_bundle
from wrenchbook.fea.check import as_text
from wrenchbook.fea.check import report as check
from wrenchbook.fea.check.commands import main
from wrenchbook.fea.check.proposal import propose
from wrenchbook.fea.mesh.bodies import stacked_singly
from wrenchbook.fea.solve import Solver

pytestmark = pytest.mark.usefixtures("estimates")

# A cantilever of 100 x 10 x 10 mm, E 70 GPa, nu 0.3, 100 N across its tip; CalculiX 2.20 has these.
BAR = box("hex20", (10, 2, 2), (100.0, 10.0, 10.0))
ROOT, MID, TIP = (cards.at(BAR, x, 0) for x in (0.0, 50.0, 100.0))
ROOT_HELD, MIDDLE_HELD_TOO = 5.693627e-4, 7.196732e-5  # m
RIGID = "*RIGID BODY, NSET=TIP, REF NODE=9000, ROT NODE=9001\n"
PULL = "*CLOAD\n9000, 3, 100.\n"


def head(mesh=BAR, element="C3D20R"):
    """Return the deck of a bar before its couplings and steps."""
    sets = []
    for name, x in (("ROOT", 0.0), ("MID", 50.0), ("TIP", 100.0)):
        sets += [f"*NSET, NSET={name}", *cards.rows(cards.at(mesh, x, 0))]
    return "\n".join(
        [
            *("*NODE, NSET=NALL", *cards.nodes(mesh), "9000, 100., 5., 5.", "9001, 100., 5., 5."),
            *(f"*ELEMENT, TYPE={element}, ELSET=EALL", *cards.cells(mesh)),
            *sets,
            *("*MATERIAL, NAME=ALU", "*ELASTIC", "70000., 0.3"),
            *("*SOLID SECTION, ELSET=EALL, MATERIAL=ALU", ""),
        ]
    )


HEAD = head()


def step(text, option=""):
    return f"*STEP{option}\n*STATIC\n{text}*NODE PRINT, NSET=NALL\nU\n*END STEP\n"


def proposal(folder, text, case=None, name="deck.inp"):
    (folder / name).write_text(text)
    return propose(folder / name, folder / "new", "mm", case)


def tip(folder):
    """Return the tip's displacement under 100 N, m."""
    return 100 * Solver(read_bundle(folder / "new")).linear.compliance[2, 2]


def tips_by_calculix(folder, text):
    """Return the tip's displacement after each step of a deck, m."""
    calculix.require_ccx()
    (folder / "ccx").mkdir()
    (folder / "ccx" / "deck.inp").write_text(text)
    program = shutil.which("ccx") or "ccx"
    subprocess.run([program, "deck"], cwd=folder / "ccx", capture_output=True, check=True)
    result = (folder / "ccx" / "deck.dat").read_text()
    rows = re.findall(r"^ *9000 +\S+ +\S+ +(\S+)", result, re.M)
    return [1e-3 * float(row) for row in rows]


STEPS = {
    "a step releases the middle": [
        step(f"*BOUNDARY\nROOT, 1, 3\nMID, 1, 3\n{PULL}"),
        step(f"*BOUNDARY, OP=NEW\nROOT, 1, 3\n{PULL}"),
    ],
    "a step holds the middle too": [
        step(f"*BOUNDARY\nROOT, 1, 3\n{PULL}"),
        step("*Boundary, op = mod\nMid, 1, 3\n"),
    ],
    "a step renews its supports in two blocks": [
        step(f"*BOUNDARY\nMID, 1, 3\n{PULL}"),
        step("*BOUNDARY, OP=NEW\nROOT, 1\n*BOUNDARY, OP=NEW\nROOT, 2, 3\n"),
    ],
    "a step renews what holds before the first": [
        "*BOUNDARY\nROOT, 1, 3\nMID, 1, 3\n",
        step(PULL),
        step(f"*BOUNDARY, OP=NEW\nROOT, 1, 3\n{PULL}"),
    ],
}


@pytest.mark.parametrize("name", STEPS)
def test_a_component_of_a_deck_of_steps_gives_as_calculix_does_in_the_last(tmp_path, name):
    text = HEAD + RIGID + "".join(STEPS[name])
    proposal(tmp_path, text)
    assert tip(tmp_path) == pytest.approx(tips_by_calculix(tmp_path, text)[-1], rel=1e-5)


def test_steps_that_hold_different_nodes_are_listed_and_named_at_choice(tmp_path):
    text = HEAD + RIGID + "".join(STEPS["a step releases the middle"])
    result = proposal(tmp_path, text)
    assert tip(tmp_path) == pytest.approx(ROOT_HELD, rel=1e-5)
    line = next(words for words in result["decide"] if words.startswith("case:"))
    assert '"step 2" is taken (or write --case NAME)' in line
    assert '"step 1" holds MID (xyz), ROOT (xyz); loads TIP (0, 0, 100, 0, 0, 0)' in line
    (tmp_path / "other").mkdir()
    result = proposal(tmp_path / "other", text, "STEP 1")
    assert tip(tmp_path / "other") == pytest.approx(MIDDLE_HELD_TOO, rel=1e-5)
    assert not any(words.startswith("case:") for words in result["decide"])


@pytest.mark.parametrize("case", ["step 1", "step 2"])
def test_the_check_finds_no_contradiction_to_a_case_that_was_chosen(tmp_path, case):
    text = HEAD + RIGID + "".join(STEPS["a step releases the middle"])
    check = proposal(tmp_path, text, case)["check"]
    assert [warning for warning in check["warnings"] if warning["where"] == "mesh.file"] == []


def test_loads_add_up_within_a_step_and_replace_those_of_an_earlier_one(tmp_path):
    text = HEAD + RIGID + step(f"*BOUNDARY\nROOT, 1, 3\n{PULL}") + step(PULL + PULL)
    proposal(tmp_path, text)
    force = read_bundle(tmp_path / "new").range.high[2]
    first, second = tips_by_calculix(tmp_path, text)
    assert force == pytest.approx(100 * second / first, rel=1e-5)


@pytest.mark.parametrize(
    ("first", "second"),
    [
        ("*BOUNDARY\nROOT, 1, 3\n9000, 1, 2\n", "*BOUNDARY, OP=NEW\nROOT, 1, 3\n9000, 2, 3\n"),
        ("*BOUNDARY\nROOT, 1, 3\n*CLOAD\n9000, 3, 100.00001\n", PULL),
    ],
)
def test_steps_that_differ_in_a_held_freedom_or_the_last_digit_of_a_load_are_listed(
    tmp_path, first, second
):
    result = proposal(tmp_path, HEAD + RIGID + step(first) + step(second))
    line = next(words for words in result["decide"] if words.startswith("case:"))
    assert "the deck has several" in line


@pytest.mark.parametrize("unit", ["in", "mm"])
def test_an_expansion_of_an_inch_deck_is_to_decide_as_it_may_be_in_fahrenheit(tmp_path, unit):
    text = HEAD.replace("70000., 0.3\n", "70000., 0.3\n*EXPANSION\n1.3e-5\n")
    (tmp_path / "deck.inp").write_text(text + RIGID + step(f"*BOUNDARY\nROOT, 1, 3\n{PULL}"))
    result = propose(tmp_path / "deck.inp", tmp_path / "new", unit, None)
    assert any("Fahrenheit" in line for line in result["decide"]) == (unit == "in")


@pytest.mark.parametrize("kind", ["NODE", "ELEMENT"])
def test_a_coupling_reaches_the_nodes_within_its_influence_radius(tmp_path, kind):
    points = BAR.points[np.array(TIP) - 1]
    near = np.array(TIP)[np.linalg.norm(points - [100, 5, 5], axis=1) <= 3]
    cells = np.flatnonzero(np.isin(BAR.blocks[0].nodes + 1, near).any(axis=1)) + 1
    sets = "\n".join(
        ["*NSET, NSET=NEAR", *cards.rows(near), "*ELSET, ELSET=END", *cards.rows(cells), ""]
    )
    face = next(f"S{i}" for i, f in enumerate(calculix.FACES, 1) if _on_tip(cells[0], f))
    surface = f"*SURFACE, NAME=S, TYPE={kind}\n{'TIP' if kind == 'NODE' else f'END, {face}'}\n"
    coupling = "*COUPLING, REF NODE=9000, SURFACE=S, CONSTRAINT NAME=C, INFLUENCE RADIUS=3.\n"
    held = step(f"*BOUNDARY\nROOT, 1, 3\n{PULL}")
    proposal(tmp_path, f"{HEAD}{sets}{surface}{coupling}*KINEMATIC\n{held}")
    expected = tips_by_calculix(tmp_path, HEAD + sets + RIGID.replace("TIP", "NEAR") + held)
    assert tip(tmp_path) == pytest.approx(expected[0], rel=1e-5)
    assert tip(tmp_path) > 1.0001 * ROOT_HELD


def _on_tip(cell, face):
    return set(BAR.blocks[0].nodes[cell - 1][list(face)] + 1) <= set(TIP)


def bulk(lacks=lambda cell, node: False):
    """Return the bar as Nastran bulk data with the middle in SPC set 7; `lacks` of cell 0: all."""
    order = [*range(12), *range(16, 20), *range(12, 16)]
    lines = ["SOL 101", "CEND", "SPC = 1\nLOAD = 2", "BEGIN BULK"]
    for i, (x, y, z) in enumerate([*BAR.points.tolist(), (100.0, 5.0, 5.0)], 1):
        number = i if i <= len(BAR.points) else 9000
        if not lacks(0, i):
            lines += cards.card("GRID", number, "", *(f"{c:.4f}" for c in (x, y, z)))
    for i, cell in enumerate((BAR.blocks[0].nodes + 1).tolist(), 1):
        nodes = ("" if lacks(0, cell[j]) or lacks(i, cell[j]) else cell[j] for j in order)
        lines += cards.card("CHEXA", i, 1, *nodes)
    root, mid, tip = ([n for n in nodes if not lacks(0, n)] for nodes in (ROOT, MID, TIP))
    lines += ["PSOLID,1,1", "MAT1,1,70000.,,.3", *cards.card("RBE2", 80, 9000, 123456, *tip)]
    lines += cards.card("SPC1", 1, 123, *root) + cards.card("SPC1", 7, 123, *mid)
    return "\n".join([*lines, "FORCE,2,9000,,100.,0.,0.,1.", "ENDDATA", ""])


def archive(loads):
    """Return the bar as an Ansys archive with components ROOT, MID and TIP."""
    sets = []
    for name, nodes in (("ROOT", ROOT), ("MID", MID), ("TIP", TIP)):
        sets += [f"CMBLOCK,{name:8s},NODE,{len(nodes):8d}", "(8i10)"]
        sets += ["".join(f"{n:10d}" for n in nodes[i : i + 8]) for i in range(0, len(nodes), 8)]
    return cards.archive(BAR, loads, sets="\n".join(["", *sets]))


ROOT_D = "\n".join(f"D,{n},ALL,0" for n in ROOT)
TIP_F = "\n".join(f"F,{n},FZ,{100 / len(TIP):.9f}" for n in TIP)
LISTED = {
    "all": f"{ROOT_D}\n{TIP_F}",
    "labels": f"{ROOT_D.replace('ALL,0', 'UX,0,,,,UY,UZ')}\n{TIP_F}",
    "component": f"D,ROOT,ALL\n{TIP_F}",
    "a range of no node": f"D,5000,ALL,0,,5010\n{ROOT_D}\n{TIP_F}",
    "deleted": f"{ROOT_D}\nD,MID,ALL\n{TIP_F}\nDDELE,MID,ALL",
    "all but the root deleted": f"D,ALL,ALL\nDDELE,ALL,ALL\n{ROOT_D}\n{TIP_F}",
    "two commands a line": f"{ROOT_D.replace('ALL,0', 'UX,0 $ D,ROOT,UY $ D,ROOT,UZ')}\n{TIP_F}",
    "steps begun anew": f"D,MID,ALL\n{TIP_F}\nLSWRITE,1\nLSCLEAR,ALL\n{ROOT_D}\n{TIP_F}\nLSWRITE,2",
    "steps": f"D,MID,ALL\n{TIP_F}\nLSWRITE,1\nDDELE,MID,ALL\n{ROOT_D}\nLSWRITE,2\nLSSOLVE,1,2",
}


@pytest.mark.parametrize("name", LISTED)
def test_an_ansys_archive_holds_what_its_last_load_step_does(tmp_path, name):
    proposal(tmp_path, archive(LISTED[name]), name="deck.cdb")
    assert tip(tmp_path) == pytest.approx(ROOT_HELD, rel=1e-4)  # distributed: ccx 5.6939e-4


HELD = HEAD + RIGID + step(f"*BOUNDARY\nROOT, 1, 3\n{PULL}")


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-16-be", "utf-8-sig"])
def test_a_deck_in_another_encoding_is_read(tmp_path, encoding):
    (tmp_path / "deck.inp").write_text(HELD, encoding=encoding)
    assert propose(tmp_path / "deck.inp", tmp_path / "new", "mm")["check"]["ok"]


@pytest.mark.parametrize(("kind", "element"), [("hex8", "C3D8"), ("hex20", "C3D20R")])
def test_a_single_stack_of_cells_is_integrated_fully(tmp_path, kind, element):
    stack = head(box(kind, (8, 1, 1), (100.0, 10.0, 10.0)), element)
    result = proposal(tmp_path, stack + HELD[len(HEAD) :])
    assert result["check"]["ok"], result["check"]["problems"]
    assert read_bundle(tmp_path / "new").analysis.integration == "full"
    assert any(words.startswith('integration = "full"') for words in result["decide"])


def test_a_proposal_prints_the_warnings_of_its_check(tmp_path, capsys):
    text = HELD.replace("*STEP", "*EQUATION\n2\n1, 1, 1., 2, 1, -1.\n*STEP")
    (tmp_path / "deck.inp").write_text(text)
    words = ["new", "--unit", "mm", "--case", "step 1"]
    main([*words, str(tmp_path / "deck.inp"), str(tmp_path / "new")])
    assert "warning: mesh.file: line" in capsys.readouterr().out


BLOCK = Path(__file__).parent / "block"
TOML = (BLOCK / "component.toml").read_text("utf-8")
AGREES = (BLOCK / "agrees.inp").read_text("utf-8")


def block(folder, more=AGREES, element="C3D20R", case=None):
    """Write a bundle of a block of 20 x 20 x 60 mm on a deck with `more` in it."""
    lines = list(deck_lines(box("hex20", (2, 2, 4), (0.02, 0.02, 0.06)), 1e-3))
    deck = "\n".join(lines).replace("C3D20R", element) + f"\n{more}"
    toml, deck = changed(f"{TOML}\0{deck}", case or {"change": {}}).split("\0")
    (folder / "block.inp").write_text(deck)
    (folder / "component.toml").write_text(toml)
    return folder


def warnings(folder):
    report = check(folder)
    assert report["ok"], report["problems"]
    return [warning["message"] for warning in report["warnings"] if warning["where"] == "mesh.file"]


def test_a_deck_that_agrees_with_its_component_gives_no_warning(tmp_path):
    assert warnings(block(tmp_path)) == []


@cases(__file__, "warned")
def test_what_a_deck_says_otherwise_is_a_warning_with_its_line(tmp_path, case):
    (result,) = warnings(block(tmp_path, case=case))
    assert_told(case, [result])
    assert result.startswith("line ")


def test_read_and_ignored_keywords_are_listed_with_their_lines(tmp_path):
    folder = block(tmp_path, AGREES + "*NODE PRINT, NSET=REF\nU\n")
    listed = check(folder)["mesh_file"]
    assert set(listed["ignored"]) == {"STEP", "STATIC", "CLOAD", "NODE PRINT"}
    lines = (folder / "block.inp").read_text().splitlines()
    assert lines[listed["ignored"]["STATIC"][0] - 1] == "*STATIC"
    assert {"NODE", "ELEMENT", "ELASTIC", "BOUNDARY"} <= set(listed["read"])
    text = as_text(check(folder))
    assert "deck, ignored: *STEP (1), *STATIC (1), *CLOAD (1), *NODE PRINT (1)" in text


@pytest.mark.parametrize(
    ("element", "integration"),
    [("C3D20", "full"), ("C3D20H", "full"), ("C3D20R", "reduced"), ("C3D20RH", "reduced")],
)
def test_the_integration_is_that_of_the_decks_elements(tmp_path, element, integration):
    assert read_bundle(block(tmp_path, element=element)).analysis.integration == integration


def test_an_integration_other_than_the_decks_is_a_warning(tmp_path):
    case = {"change": {"[analysis]": '[analysis]\nintegration = "reduced"'}}
    (result,) = warnings(block(tmp_path, element="C3D20", case=case))
    assert "has C3D20; [analysis] says" in result


def test_a_hybrid_element_is_named_with_what_is_solved_instead(tmp_path):
    report = check(block(tmp_path, element="C3D20H"))
    assert report["mesh_file"]["elements"]["C3D20H"]["count"] == 16
    assert "displacements alone" in as_text(report)


def test_held_reference_nodes_are_supports_of_what_they_move(tmp_path):
    text = AGREES.replace("FOOT, 1, 3", "9001, 1, 6")
    text = text.replace("*RIGID BODY, NSET=HEAD", "*RIGID BODY, NSET=FOOT")
    assert warnings(block(tmp_path, text)) == []


def arch(folder, across, integration):
    """Write a half circle of radius 0.3 m, 10 x 10 mm, of 40 cells along."""
    mesh = box("hex20", (across, across, 40), (0.01, 0.01, 1.0))
    x, y, z = mesh.points.T
    radius, angle = 0.3 + x, np.pi * (z - 0.5)
    points = np.column_stack([radius * np.cos(angle), y, radius * np.sin(angle)])
    lines = deck_lines(replace(mesh, points=points), 1e-3, integration)
    (folder / "block.inp").write_text("\n".join(lines) + "\n")
    text = TOML.replace("point = [0.01, 0.01, 0.06]\n", "").replace("rigid", "distributed")
    (folder / "component.toml").write_text(text)
    return check(folder)


def test_an_arch_of_single_reduced_cells_is_refused_as_an_hourglass(tmp_path):
    report = arch(tmp_path, 1, "reduced")
    (problem,) = report["problems"]
    assert problem["where"] == "analysis.integration"
    assert "40 hex20 cells" in problem["message"]
    assert "hourglass" in problem["message"]


@pytest.mark.parametrize("estimates", ["estimate"], indirect=True)
@pytest.mark.parametrize(("across", "integration"), [(1, "full"), (2, "reduced")])
def test_full_integration_or_two_cells_across_make_it_ready_and_far_from_buckling(
    tmp_path, across, integration
):
    report = arch(tmp_path, across, integration)
    assert report["ok"]
    assert report["solver_error"]["buckling"] is None


@pytest.mark.parametrize(("cells", "count"), [((1, 1, 1), 0), ((1, 2, 5), 0), ((1, 1, 2), 2)])
def test_a_single_cell_and_a_layer_are_no_stack(cells, count):
    assert len(stacked_singly(box("hex20", cells, (0.01, 0.02, 0.05)))) == count
