"""Springs of decks, and couplings of some freedoms, are supports and joints of the component."""

import numpy as np
import pytest

from tests.fea import calculix
from tests.fea.cae import cards
from tests.fea.check.test_load_cases import (
    BAR,
    HEAD,
    PULL,
    RIGID,
    ROOT,
    bulk,
    proposal,
    step,
    tip,
    tips_by_calculix,
)
from wrenchbook.fea.bundle.read import read_bundle
from wrenchbook.fea.check import as_text
from wrenchbook.fea.check import report as check
from wrenchbook.fea.component import build
from wrenchbook.fea.export.calculix import deck_of
from wrenchbook.fea.solve import Solver
from wrenchbook.fea.spec.schema import PLACEHOLDERS

pytestmark = pytest.mark.usefixtures("estimates")

SIZES = {1: 3e3, 2: 2e3, 3: 5e3, 4: 2e5, 5: 3e5, 6: 1e5}  # N/mm and N·mm
HOLD = "*BOUNDARY\nROOT, 1, 3\n"
AXES = "*ORIENTATION, NAME=Askew\n0.6, 0.8, 0., -0.8, 0.6, 0.1\n"


def rigid(name, x, node):
    """Return a rigid body of the nodes at x; its rotation node is the next."""
    rows = "\n".join(cards.rows(cards.at(BAR, x, 0)))
    at = f"*NODE\n{node}, 45., 5., 5.\n{node + 1}, 45., 5., 5.\n*NSET, NSET={name}\n{rows}\n"
    return f"{at}*RIGID BODY, NSET={name}, REF NODE={node}, ROT NODE={node + 1}\n"


def springs(*nodes, option="", sizes=SIZES):
    """Return springs along and about three axes at bodies' nodes."""
    lines = []
    for i, size in sizes.items():
        ends = ", ".join(str(node + (i > 3)) for node in nodes)
        lines += [f"*ELEMENT, TYPE=SPRING{len(nodes)}, ELSET=K{i}", f"{9200 + i}, {ends}"]
        ways = ", ".join([str((i - 1) % 3 + 1)] * len(nodes))
        lines += [f"*SPRING, ELSET=K{i}{option}", ways, f"{size}"]
    return "\n".join([*lines, ""])


GROUND = HEAD + RIGID + rigid("A", 0.0, 9100)
HELD = "*NODE\n9110, 0., 0., 0.\n9111, 0., 0., 0.\n"
PAIR = HEAD + RIGID + rigid("A", 20.0, 9100) + rigid("B", 70.0, 9110)
DECKS = {
    "to the ground": GROUND + springs(9100) + step(PULL),
    "to the ground, turned": GROUND
    + AXES
    + springs(9100, option=", ORIENTATION=ASKEW")
    + step(PULL),
    "to a held node": GROUND
    + HELD
    + springs(9100, 9110)
    + step("*BOUNDARY\n9110, 1, 3\n9111, 1, 3\n" + PULL),
    "between bodies, turned": PAIR
    + AXES
    + springs(9100, 9110, option=", ORIENTATION=ASKEW")
    + step(HOLD + PULL),
    "around a cylinder": HEAD
    + "*TRANSFORM, NSET=MID, TYPE=C\n0., -20., 5., 1., -20., 6.\n"
    + RIGID
    + step(HOLD + "MID, 2, 3\n" + PULL),
    "a coupling of one freedom, held": HEAD + RIGID + "*NODE\n9110, 50., 5., 5.\n"
    "*SURFACE, TYPE=NODE, NAME=M\nMID\n*COUPLING, CONSTRAINT NAME=C, SURFACE=M, REF NODE=9110\n"
    "*KINEMATIC\n3\n" + step(HOLD + "9110, 1, 6\n" + PULL),
}


@pytest.mark.parametrize("name", DECKS)
def test_a_deck_is_taken_over_whole_and_moves_as_in_calculix(tmp_path, name):
    result = proposal(tmp_path, DECKS[name])
    assert (result["left"], result["check"]["warnings"]) == ([], [])
    assert tip(tmp_path) == pytest.approx(tips_by_calculix(tmp_path, DECKS[name])[0], rel=1e-5)


def test_nodes_on_the_axis_of_turned_axes_are_held_as_in_calculix_and_named(tmp_path):
    axis = "*TRANSFORM, NSET=MID, TYPE=C\n50., 5., 5., 50., 6., 6.\n"
    text = HEAD + axis + RIGID + step(HOLD + "MID, 3\n" + PULL)
    (left,) = proposal(tmp_path, text)["left"]
    assert "*TRANSFORM has nodes on its axis, where radial is no direction" in left
    assert tip(tmp_path) == pytest.approx(tips_by_calculix(tmp_path, text)[0], rel=1e-5)


@pytest.mark.parametrize("name", ["to the ground, turned", "between bodies, turned"])
def test_the_exported_deck_has_the_springs(tmp_path, name):
    calculix.require_ccx()
    nonlinear = name.startswith("to")
    proposal(tmp_path, DECKS[name].replace("*STEP", "*STEP, NLGEOM" if nonlinear else "*STEP"))
    bundle, wrench = read_bundle(tmp_path / "new"), np.array([30.0, 60, 90, 3, 6, 9])
    expected = Solver(bundle).solve(wrench).displacement
    loads = calculix.conjugate(wrench, expected) if nonlinear else wrench
    text = deck_of(build(bundle))
    for word, load in zip(PLACEHOLDERS, loads, strict=True):
        text = text.replace(word, f"{load:.12e}")
    rows = calculix.printed([text], tmp_path)[-2:]
    moved = np.array([row[1:] for row in rows], dtype=float).ravel()
    np.testing.assert_allclose(moved, expected, rtol=1e-4 if nonlinear else 1e-5, atol=1e-9)


def test_the_check_names_a_spring_by_its_ends_and_not_as_rigid(tmp_path):
    result = proposal(tmp_path, DECKS["between bodies, turned"])
    assert "\nspring with rigid ends between A and B: 21 and 21 nodes" in as_text(result["check"])


@pytest.mark.parametrize("kind", ["CBUSH", "CELAS1", "CELAS2"])
def test_springs_of_nastran_along_own_axes_are_those_of_abaqus(tmp_path, kind):
    lines = ["GRID,9100,,45.,5.,5.,5", *cards.card("RBE2", 81, 9100, 123456, *ROOT)]
    lines += ["CORD2R,5,,0.,0.,0.,-.08,.06,1.", "+,.6,.8,0."]
    if kind == "CBUSH":
        sizes = ",".join(str(size) for size in SIZES.values())
        lines += ["CBUSH,90,91,9100,,,,,5", f"PBUSH,91,K,{sizes}"]
    for i, size in SIZES.items() if kind != "CBUSH" else ():
        lines += [f"{kind},{90 + i},{size if kind == 'CELAS2' else 190 + i},,0,9100,{i}"]
        lines += [f"PELAS,{190 + i},{size}"] if kind == "CELAS1" else []
    text = bulk().replace("SPC = 1", "SPC = 2").replace("ENDDATA", "\n".join([*lines, "ENDDATA"]))
    result = proposal(tmp_path, text, name="deck.bdf")
    assert [line for line in result["left"] if "SPC set" not in line] == []
    (tmp_path / "b").mkdir()
    proposal(tmp_path / "b", DECKS["to the ground, turned"])
    assert tip(tmp_path) == pytest.approx(tip(tmp_path / "b"), rel=1e-6)


def test_lines_of_the_deck_that_is_written_of_another_name_it(tmp_path):
    lines = ["GRID,9100,,45.,5.,5.", *cards.card("RBE2", 81, 9100, 13, *ROOT)]
    lines += ["CELAS2,90,5.,,0,9100,1", "ENDDATA"]
    text = bulk().replace("ENDDATA", "\n".join(lines))
    left = proposal(tmp_path, text, name="a.bdf")["left"]
    assert [line[:12] for line in left if "*SPRING" in line] == ["a.inp, line "]


LOADED = PULL + "9100, 1, 5.\n"
REFUSED = {
    "a node of no coupling": (
        "9201, 9100",
        "9201, 1",
        "node 1 is neither the point of a coupling nor held",
    ),
    "no node": ("9201, 9100", "9201, 77777", "node 77777 is neither the point of a coupling"),
    "a negative stiffness": ("3000.0", "-1.", "its stiffness is -1"),
    "no stiffness": ("3000.0", "0.", "its stiffness is 0"),
    "no number": ("3000.0", "nan", 'has "nan" where a number must be; write a number'),
    "a table": (
        "ELSET=K1\n1\n3000.0",
        "ELSET=K1, NONLINEAR\n1\n0., 0.\n5., 1.",
        "it has NONLINEAR, but must have one constant stiffness",
    ),
    "a seventh freedom": ("ELSET=K1\n1\n", "ELSET=K1\n7\n", "freedoms 7, but needs one of 1 to 6"),
    "a number twice": (
        "9202, 9100",
        "9201, 9100",
        "it defines element 9201 again; renumber one of the two",
    ),
    "a solid's number": (
        "9201, 9100",
        "1, 9100",
        "it defines element 1 again; renumber one of the two",
    ),
    "two blocks": ("*SPRING, ELSET=K2", "*SPRING, ELSET=K1", "a *SPRING above has element"),
    "a loaded point": (PULL, LOADED, "the point 9100 is loaded"),
    "another size": ("3000.0", "3500.0", 'has "A" on springs of 3.5e+06, 2e+06, 5e+06, 200, 300'),
}


@pytest.mark.parametrize("name", REFUSED)
def test_springs_that_are_no_bushing_or_another_are_named(tmp_path, name):
    old, new, texts = REFUSED[name]
    text = DECKS["to the ground"]
    proposal(tmp_path, text)
    (tmp_path / "new" / "deck.inp").write_text(text.replace(old, new))
    warnings = [warning["message"] for warning in check(tmp_path / "new")["warnings"]]
    assert any(texts in warning for warning in warnings), warnings
