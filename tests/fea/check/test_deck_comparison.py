"""What `check` tells of a deck: read, ignored, in contradiction to the component."""

from pathlib import Path

import pytest

from tests.fea.boxes import box
from tests.fea.written_deck import deck_lines
from tests.refusals import assert_told, cases, changed
from wrenchbook.fea.bundle.read import read_bundle
from wrenchbook.fea.check import as_text
from wrenchbook.fea.check import report as check

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
    return [one["message"] for one in report["warnings"] if one["where"] == "mesh.file"]


def test_a_deck_that_agrees_with_its_component_gives_no_warning(tmp_path):
    assert warnings(block(tmp_path)) == []


@cases(__file__, "warned")
def test_what_a_deck_says_otherwise_is_a_warning_with_its_line(tmp_path, case):
    (found,) = warnings(block(tmp_path, case=case))
    assert_told(case, [found])
    assert found.startswith("line ")


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
    (found,) = warnings(block(tmp_path, element="C3D20", case=case))
    assert "has C3D20; [analysis] says" in found


def test_a_hybrid_element_is_named_with_what_is_solved_instead(tmp_path):
    report = check(block(tmp_path, element="C3D20H"))
    assert report["mesh_file"]["elements"]["C3D20H"]["count"] == 16
    assert "displacements alone" in as_text(report)


def test_held_reference_nodes_are_supports_of_what_they_move(tmp_path):
    text = AGREES.replace("FOOT, 1, 3", "9001, 1, 6")
    text = text.replace("*RIGID BODY, NSET=HEAD", "*RIGID BODY, NSET=FOOT")
    assert warnings(block(tmp_path, text)) == []
