"""A deck of several load cases becomes a component of one of them, and the others are listed."""

import re
import shutil
import subprocess

import numpy as np
import pytest

from tests.fea import calculix
from tests.fea.boxes import box
from tests.fea.cae import make
from wrenchbook.fea.bundle.read import read_bundle
from wrenchbook.fea.check.commands import main
from wrenchbook.fea.check.proposal import propose
from wrenchbook.fea.solve import Solver

# A cantilever of 100 x 10 x 10 mm, E 70 GPa, nu 0.3, 100 N across its tip; CalculiX 2.20 has these.
BAR = box("hex20", (10, 2, 2), (100.0, 10.0, 10.0))
ROOT_HELD, MIDDLE_HELD_TOO = 5.693627e-4, 7.196732e-5  # m


def at(x, mesh=BAR):
    return (np.flatnonzero(np.abs(mesh.points[:, 0] - x) < 1e-9) + 1).tolist()


HEAD = "\n".join(
    [
        *("*NODE, NSET=NALL", *make.nodes(BAR), "9000, 100., 5., 5.", "9001, 100., 5., 5."),
        *("*ELEMENT, TYPE=C3D20R, ELSET=EALL", *make.cells(BAR)),
        *("*NSET, NSET=ROOT", *make.rows(at(0.0)), "*NSET, NSET=MID", *make.rows(at(50.0))),
        *("*NSET, NSET=TIP", *make.rows(at(100.0)), "*MATERIAL, NAME=ALU", "*ELASTIC"),
        *("70000., 0.3", "*SOLID SECTION, ELSET=EALL, MATERIAL=ALU", ""),
    ]
)
RIGID = "*RIGID BODY, NSET=TIP, REF NODE=9000, ROT NODE=9001\n"
PULL = "*CLOAD\n9000, 3, 100.\n"


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
    found = proposal(tmp_path, text)
    assert tip(tmp_path) == pytest.approx(ROOT_HELD, rel=1e-5)
    line = next(words for words in found["decide"] if words.startswith("case:"))
    assert '"step 2" stands (--case NAME)' in line
    assert '"step 1" holds MID (xyz), ROOT (xyz); loads TIP (0, 0, 100, 0, 0, 0)' in line
    (tmp_path / "other").mkdir()
    found = proposal(tmp_path / "other", text, "STEP 1")
    assert tip(tmp_path / "other") == pytest.approx(MIDDLE_HELD_TOO, rel=1e-5)
    assert not any(words.startswith("case:") for words in found["decide"])


@pytest.mark.parametrize("case", ["step 1", "step 2"])
def test_the_check_finds_no_contradiction_to_a_case_that_was_chosen(tmp_path, case):
    text = HEAD + RIGID + "".join(STEPS["a step releases the middle"])
    check = proposal(tmp_path, text, case)["check"]
    assert [one for one in check["warnings"] if one["where"] == "mesh.file"] == []


def test_steps_that_act_alike_are_no_decision(tmp_path):
    text = HEAD + RIGID + step(f"*BOUNDARY\nROOT, 1, 3\n{PULL}") + step("")
    assert not any("case" in words for words in proposal(tmp_path, text)["decide"])


def test_steps_whose_names_differ_in_capitals_are_each_named_at_choice(tmp_path):
    text = HEAD + RIGID + step(f"*BOUNDARY\nROOT, 1, 3\n{PULL}", ", NAME=Pull")
    text += step("*BOUNDARY\nMID, 1, 3\n", ", NAME=PULL")
    proposal(tmp_path, text, "pull")
    assert tip(tmp_path) == pytest.approx(ROOT_HELD, rel=1e-5)
    (tmp_path / "other").mkdir()
    proposal(tmp_path / "other", text, "pull (2)")
    assert tip(tmp_path / "other") == pytest.approx(MIDDLE_HELD_TOO, rel=1e-5)


def test_loads_add_up_within_a_step_and_replace_those_of_an_earlier_one(tmp_path):
    text = HEAD + RIGID + step(f"*BOUNDARY\nROOT, 1, 3\n{PULL}") + step(PULL + PULL)
    proposal(tmp_path, text)
    force = read_bundle(tmp_path / "new").range.high[2]
    first, second = tips_by_calculix(tmp_path, text)
    assert force == pytest.approx(100 * second / first, rel=1e-5)


def test_load_cases_within_a_step_are_cases_of_their_own(tmp_path):
    cases = (f"*LOAD CASE, NAME={n}\n*CLOAD\n9000, {n}, 10.\n*END LOAD CASE\n" for n in (2, 3))
    text = HEAD + RIGID + step(f"*BOUNDARY\nROOT, 1, 3\n{''.join(cases)}", ", PERTURBATION")
    (line,) = (words for words in proposal(tmp_path, text)["decide"] if "case:" in words)
    assert '"2" holds ROOT (xyz); loads TIP (0, 10, 0, 0, 0, 0)' in line
    assert '"3" holds ROOT (xyz); loads TIP (0, 0, 10, 0, 0, 0)' in line
    assert "step" not in line


def test_a_perturbation_has_its_loads_alone_and_hands_none_on(tmp_path):
    text = HEAD + RIGID + step(f"*BOUNDARY\nROOT, 1, 3\n{PULL}", ", NAME=A")
    text += step("*CLOAD\n9000, 2, 7.\n", ", NAME=B, PERTURBATION") + step("", ", NAME=C")
    (line,) = (words for words in proposal(tmp_path, text)["decide"] if "case:" in words)
    assert '"A", "C" holds ROOT (xyz); loads TIP (0, 0, 100, 0, 0, 0)' in line
    assert '"B" holds ROOT (xyz); loads TIP (0, 7, 0, 0, 0, 0)' in line


def test_a_step_after_a_perturbation_with_supports_is_named(tmp_path):
    text = HEAD + RIGID + step(f"*BOUNDARY\nROOT, 1, 3\n{PULL}")
    text += step("*BOUNDARY\nMID, 1, 3\n", ", PERTURBATION") + step("")
    (left,) = proposal(tmp_path, text)["left"]
    assert "*STEP is without the supports of the perturbation before; CalculiX keeps them" in left


@pytest.mark.parametrize("kind", ["NODE", "ELEMENT"])
def test_a_coupling_reaches_the_nodes_within_its_influence_radius(tmp_path, kind):
    points = BAR.points[np.array(at(100.0)) - 1]
    near = np.array(at(100.0))[np.linalg.norm(points - [100, 5, 5], axis=1) <= 3]
    cells = np.flatnonzero(np.isin(BAR.blocks[0].nodes + 1, near).any(axis=1)) + 1
    sets = "\n".join(
        ["*NSET, NSET=NEAR", *make.rows(near), "*ELSET, ELSET=END", *make.rows(cells), ""]
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
    return set(BAR.blocks[0].nodes[cell - 1][list(face)] + 1) <= set(at(100.0))


def bulk(control="SPC = 1\nLOAD = 2", more="", root=None):
    """Return the bar as Nastran bulk data with the middle in SPC set 7."""
    order = [*range(12), *range(16, 20), *range(12, 16)]
    lines = ["SOL 101", "CEND", control, "BEGIN BULK"]
    for i, (x, y, z) in enumerate([*BAR.points.tolist(), (100.0, 5.0, 5.0)], 1):
        lines += make.card(
            "GRID", i if i <= len(BAR.points) else 9000, "", *(f"{c:.4f}" for c in (x, y, z))
        )
    for i, cell in enumerate((BAR.blocks[0].nodes + 1).tolist(), 1):
        lines += make.card("CHEXA", i, 1, *(cell[j] for j in order))
    lines += ["PSOLID,1,1", "MAT1,1,70000.,,.3", *make.card("RBE2", 80, 9000, 123456, *at(100.0))]
    lines += root or make.card("SPC1", 1, 123, *at(0.0))
    lines += make.card("SPC1", 7, 123, *at(50.0))
    return "\n".join([*lines, "FORCE,2,9000,,100.,0.,0.,1.", more, "ENDDATA", ""])


SELECTED = {
    "SPC = 1\nLOAD = 2": "",
    "SPC = 3 $ the sum\nLOAD = 2": "SPCADD,3,1",
    "spc=1\nload(case)=2": "",
    "SPC = 7\nSUBCASE 1\n LOAD = 2\nSUBCASE 2\n SPC = 1\n LOAD = 2": "",
    "SPC = 1\nLOAD = 2\nTITLE = SPC = 7\nSPCFORCES = ALL": "",
}


@pytest.mark.parametrize("control", SELECTED)
def test_a_nastran_deck_holds_what_its_case_control_selects(tmp_path, control):
    proposal(tmp_path, bulk(control, SELECTED[control]), name="deck.bdf")
    assert tip(tmp_path) == pytest.approx(ROOT_HELD, rel=1e-5)


def test_a_nastran_sum_of_two_sets_holds_both(tmp_path):
    proposal(tmp_path, bulk("SPC = 3\nLOAD = 2", "SPCADD,3,1,7"), name="deck.bdf")
    assert tip(tmp_path) == pytest.approx(MIDDLE_HELD_TOO, rel=1e-5)


def test_a_nastran_set_that_no_case_selects_is_named(tmp_path):
    found = proposal(tmp_path, bulk(more="FORCE,5,9000,,9.,1.,0.,0."), name="deck.bdf")
    assert [words.partition(" (")[0] for words in found["left"]] == [
        "SPC set 7, which no case selects",
        "LOAD set 5, which no case selects",
    ]
    assert read_bundle(tmp_path / "new").range.high[0] == 100.0


def test_a_nastran_nonlinear_solution_by_its_name_is_nonlinear(tmp_path):
    proposal(tmp_path, bulk().replace("SOL 101", "SOL NLSTATIC"), name="deck.bdf")
    assert read_bundle(tmp_path / "new").analysis.nonlinear


def test_a_nastran_deck_that_selects_no_supports_says_which_it_takes(tmp_path):
    found = proposal(tmp_path, bulk("LOAD = 2"), "SPC 1", "deck.bdf")
    assert tip(tmp_path) == pytest.approx(ROOT_HELD, rel=1e-5)
    assert "the case control selects no SPC; taken as cases: SPC 1, SPC 7" in found["decide"]


def test_nastran_subcases_that_differ_are_listed_and_named_at_choice(tmp_path):
    control = "LOAD = 2\nSUBCASE 1\nSPC = 1\nSUBCASE 22\nSPC = 7"
    found = proposal(tmp_path, bulk(control), "Subcase 1", "deck.bdf")
    assert tip(tmp_path) == pytest.approx(ROOT_HELD, rel=1e-5)
    assert found["left"] == []
    (tmp_path / "other").mkdir()
    found = proposal(tmp_path / "other", bulk(control), name="deck.bdf")
    assert any('"SUBCASE 22" stands' in words for words in found["decide"])


@pytest.mark.parametrize(("card", "force"), [("3., 1., 2", 300.0), ("2., 1., 2, -4., 5", 720.0)])
def test_a_nastran_load_is_the_sum_of_its_sets_by_their_factors(tmp_path, card, force):
    more = f"LOAD, 20, {card}\nFORCE,5,9000,,-65.,0.,0.,1."
    proposal(tmp_path, bulk("SPC = 1\nLOAD = 20", more), name="deck.bdf")
    assert read_bundle(tmp_path / "new").range.high[2] == pytest.approx(force)


@pytest.mark.parametrize(
    ("numbers", "count"), [("1,THRU,3,4,5,6", 6), ("1,THRU,7,BY,2,9", 5), ("1,2,3,4,THRU,6", 6)]
)
def test_a_nastran_list_of_nodes_may_have_ranges_anywhere(tmp_path, numbers, count):
    root = [f"SPC1,9,3,{numbers}", *make.card("SPC1", 1, 123, *at(0.0))]
    found = proposal(tmp_path, bulk(root=root), name="deck.bdf")
    assert f"SPC set 9, which no case selects ({count})" in found["left"]


def test_a_nastran_mean_of_some_freedoms_is_named(tmp_path):
    text = bulk(more="\n".join(make.card("RBE3", 81, "", 9000, 123456, "1.", 3, *at(50.0))))
    found = proposal(tmp_path, text, name="deck.bdf")
    assert "RBE3 of some freedoms only (1)" in found["left"]


def test_what_follows_the_end_of_bulk_data_is_not_read(tmp_path):
    text = bulk() + "\n".join(make.card("SPC1", 1, 123, *at(50.0)))
    proposal(tmp_path, text, name="deck.bdf")
    assert tip(tmp_path) == pytest.approx(ROOT_HELD, rel=1e-5)


def test_a_nastran_factor_of_masses_makes_densities(tmp_path):
    text = bulk(more="PARAM,WTMASS,.001").replace("70000.,,.3", "70000.,,.3,2.7-6")
    proposal(tmp_path, text, name="deck.bdf")
    assert read_bundle(tmp_path / "new").materials[0].density == pytest.approx(2700.0)


def archive(loads):
    """Return the bar as an Ansys archive with components ROOT, MID and TIP."""
    count = len(BAR.points)
    lines = ["/PREP7", "ET,1,186", f"NBLOCK,6,SOLID,{count},{count}", "(3i9,6e21.13e3)"]
    for i, point in enumerate(BAR.points.tolist(), 1):
        lines.append(f"{i:9d}{0:9d}{0:9d}" + "".join(f"{x:21.13E}" for x in point))
    lines += ["N,R5.3,LOC,       -1,", "EBLOCK,19,SOLID,40,40", "(19i9)"]
    for i, cell in enumerate((BAR.blocks[0].nodes + 1).tolist(), 1):
        fields = [1, 1, 1, 1, 0, 0, 0, 0, 20, 0, i, *cell]
        lines += ["".join(f"{n:9d}" for n in part) for part in (fields[:19], fields[19:])]
    lines.append(f"{-1:9d}")
    for name, nodes in (("ROOT", at(0.0)), ("MID", at(50.0)), ("TIP", at(100.0))):
        lines += [f"CMBLOCK,{name:8s},NODE,{len(nodes):8d}", "(8i10)"]
        lines += ["".join(f"{n:10d}" for n in nodes[i : i + 8]) for i in range(0, len(nodes), 8)]
    return "\n".join([*lines, "MP,EX,1,70000", "MP,PRXY,1,0.3", loads, "FINISH", ""])


ROOT_D = "\n".join(f"D,{n},ALL,0" for n in at(0.0))
TIP_F = "\n".join(f"F,{n},FZ,{100 / len(at(100.0)):.9f}" for n in at(100.0))
LISTED = {
    "all": f"{ROOT_D}\n{TIP_F}",
    "labels": f"{ROOT_D.replace('ALL,0', 'UX,0,,,,UY,UZ')}\n{TIP_F}",
    "component": f"D,ROOT,ALL\n{TIP_F}",
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


def test_ansys_load_steps_that_differ_are_listed(tmp_path):
    found = proposal(tmp_path, archive(LISTED["steps"]), "load step 2", "deck.cdb")
    assert found["left"] == []
    (tmp_path / "other").mkdir()
    found = proposal(tmp_path / "other", archive(LISTED["steps"]), name="deck.cdb")
    assert any('"LOAD STEP 2" stands' in words for words in found["decide"])


def test_an_ansys_force_replaces_that_of_its_place_and_may_be_deleted(tmp_path):
    more = f"F,TIP,FZ,1000\n{TIP_F}\nF,{at(50.0)[0]},FY,7\nFDELE,{at(50.0)[0]},FY"
    found = proposal(tmp_path, archive(f"{ROOT_D}\n{more}"), name="deck.cdb")
    assert read_bundle(tmp_path / "new").range.high[2] == pytest.approx(100.0, rel=1e-3)
    assert found["left"] == []


def test_a_range_of_ansys_nodes_is_held(tmp_path):
    text = archive(f"{ROOT_D}\nD,1,UX,0,,5,2\n{TIP_F}\nF,2,FX,1,,6,2")
    found = proposal(tmp_path, text, name="deck.cdb")
    assert "D" not in found["left"]
    deck = (tmp_path / "new" / "deck.inp").read_text()
    assert all(f"\n{n}, 1\n" in deck for n in (1, 3, 5))
    assert all(f"\n{n}, 1, 1.0\n" in deck for n in (2, 4, 6))


@pytest.mark.parametrize("kind", ["ET,1,186,,1", "ET,1,SOLID186\nKEYOPT,1,2,1"])
def test_an_ansys_type_that_integrates_fully_does_so(tmp_path, kind):
    proposal(tmp_path, archive(LISTED["all"]).replace("ET,1,186", kind), name="deck.cdb")
    assert read_bundle(tmp_path / "new").analysis.integration == "full"


def test_ansys_loads_on_the_geometry_are_named(tmp_path):
    found = proposal(
        tmp_path, archive(f"{LISTED['all']}\nDA,5,ALL,0\nBFUNIF,TEMP,50"), name="d.cdb"
    )
    assert found["left"] == ["DA (1)", "BFUNIF (1)"]


@pytest.mark.parametrize("assigned", ["*set,tid,1", "tid = 1"])
def test_an_ansys_type_by_a_parameter_is_that_of_its_value(tmp_path, assigned):
    text = archive(LISTED["all"]).replace("ET,1,186", f"{assigned}\net,tid,186")
    assert proposal(tmp_path, text, name="deck.cdb")["check"]["ok"]


def test_later_rows_of_an_ansys_table_do_not_replace_the_constant(tmp_path):
    table = (
        "MPDATA,R5.0,1,EX,1,1,70000.,69000.,68000.,67000.,66000.,65000.\nMPDATA,R5.0,1,EX,1,7,9."
    )
    text = archive(LISTED["all"]).replace("MP,EX,1,70000", table)
    found = proposal(tmp_path, text, name="deck.cdb")
    assert read_bundle(tmp_path / "new").materials[0].youngs_modulus == 70e9
    assert found["left"] == ["EX at further temperatures (2)"]


HELD = HEAD + RIGID + step(f"*BOUNDARY\nROOT, 1, 3\n{PULL}")


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-16-be", "utf-8-sig"])
def test_a_deck_in_another_encoding_is_read(tmp_path, encoding):
    (tmp_path / "deck.inp").write_text(HELD, encoding=encoding)
    assert propose(tmp_path / "deck.inp", tmp_path / "new", "mm")["check"]["ok"]


@pytest.mark.parametrize(
    ("constants", "unit", "words"),
    [
        ("1e7, 0.3", "in", "in by its constants, with pounds and psi"),
        ("3e7, 0.3", "in", "in by its constants, with pounds and psi"),
        ("70000., 0.3", "mm", "mm by its constants"),
        ("70e9, 0.3", "m", "m by its constants"),
        ("5e6, 0.45\n*DENSITY\n1100.", "m", "m by its constants"),
        ("5e6, 0.3\n*DENSITY\n60.", "m", "m by its constants"),
        ("4e5, 0.35\n*DENSITY\n1.1e-4", "in", "in by its constants, with pounds and psi"),
        ("210000., 0.3\n*DENSITY\n7.85e-3", "mm", "mm by its constants"),
    ],
)
def test_the_unit_is_guessed_by_the_constants(tmp_path, constants, unit, words):
    (tmp_path / "deck.inp").write_text(HELD.replace("70000., 0.3", constants))
    found = propose(tmp_path / "deck.inp", tmp_path / "new")
    assert f'unit = "{unit}"' in (tmp_path / "new" / "component.toml").read_text()
    assert f"unit: a deck names none; {words} (--unit)" in found["decide"]


def test_a_guess_without_constants_does_not_name_them(tmp_path):
    (tmp_path / "deck.inp").write_text(HELD.replace("*ELASTIC\n70000., 0.3\n", ""))
    decide = propose(tmp_path / "deck.inp", tmp_path / "new")["decide"]
    assert "unit: a deck names none and has no constants; mm (--unit)" in decide


@pytest.mark.parametrize("kind", ["hex8", "hex20"])
def test_a_single_stack_of_cells_is_integrated_fully(tmp_path, monkeypatch, kind):
    stack = box(kind, (1, 1, 8), (20.0, 20.0, 60.0))
    monkeypatch.setattr(make, "HEX", stack)
    text = make.abaqus().replace("C3D20R", "C3D8" if kind == "hex8" else "C3D20R")
    found = proposal(tmp_path, text.replace("1,  16,", "1,  8,"))
    assert found["check"]["ok"], found["check"]["problems"]
    assert read_bundle(tmp_path / "new").analysis.integration == "full"
    assert any(words.startswith('integration = "full"') for words in found["decide"])


def test_a_proposal_prints_the_warnings_of_its_check(tmp_path, capsys):
    text = HELD.replace("*STEP", "*EQUATION\n2\n1, 1, 1., 2, 1, -1.\n*STEP")
    (tmp_path / "deck.inp").write_text(text)
    words = ["new", "--unit", "mm", "--case", "step 1"]
    main([*words, str(tmp_path / "deck.inp"), str(tmp_path / "new")])
    assert "warning: mesh.file: line" in capsys.readouterr().out
