"""What `check` tells of a deck: read, ignored, in contradiction to the component."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.fea.boxes import box
from tests.fea.written_deck import deck_lines
from tests.refusals import assert_told, cases, changed
from wrenchbook.fea.bundle.read import read_bundle
from wrenchbook.fea.check import as_text
from wrenchbook.fea.check import report as check
from wrenchbook.fea.inspection import stacked_singly

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
