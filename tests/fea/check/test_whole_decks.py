"""Decks of several files, with local axes, couplings of some freedoms and cells of all kinds."""

import shutil

import pytest

from tests.fea.check.test_load_cases import HELD, bulk
from wrenchbook.fea.bundle.read import BundleError, read_bundle
from wrenchbook.fea.check.proposal import propose
from wrenchbook.fea.solve import Solver


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
    found = propose(in_files(tmp_path, text, name, parts, include), tmp_path / "new", "mm")
    assert "INCLUDE" not in (tmp_path / "new" / "a.inp").read_text()  # the proposal is complete
    assert found["check"]["ok"]
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
    with pytest.raises(BundleError, match="outside the deck's folder"):
        read_bundle(folder)
