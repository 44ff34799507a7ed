"""Decks of five CAE tools become components that answer, and say what they leave open."""

import json
from dataclasses import replace

import numpy as np
import pytest

from tests.fea.boxes import box, volumes
from tests.fea.cae import cards
from tests.fea.check.test_load_cases import (
    HELD,
    LISTED,
    MIDDLE_HELD_TOO,
    ROOT_HELD,
    archive,
    bulk,
    head,
)
from tests.fea.written_deck import deck_lines
from tests.refusals import assert_told, cases, changed
from wrenchbook.fea.bundle.read import BundleError, bundle_of, read_bundle
from wrenchbook.fea.bundle.shipped import SHIPPED
from wrenchbook.fea.check.commands import main
from wrenchbook.fea.check.proposal import propose
from wrenchbook.fea.mesh.io.read import read_mesh
from wrenchbook.fea.mesh.mapping import folded_cells
from wrenchbook.fea.solve import Solver

pytestmark = pytest.mark.usefixtures("estimates")

LOAD = np.array([50.0, 0, 0, 0, 0, 0.8])


def table(coupling="rigid", section="z1", integration="reduced", **more):
    """Return the part of the decks as a bundle's table, on a mesh file of its own."""
    return {
        "name": "block",
        "title": "Block",
        "mesh": {"file": "block.inp", "unit": "mm"},
        "material": [{"region": "all", "youngs_modulus": 70e9, "poisson_ratio": 0.33}],
        "supports": {"fixed": ["z0"]},
        "interface": {"section": section, "coupling": coupling, **more},
        "analysis": {"nonlinear": False, "integration": integration},
        "range": {"force": [50, 50, 50], "moment": [1, 1, 1]},
    }


def reference(folder, mesh, **options):
    folder.mkdir()
    metres = replace(mesh, points=mesh.points / 1000)
    (folder / "block.inp").write_text("\n".join(deck_lines(metres, 1e-3)) + "\n")
    return Solver(bundle_of(table(**options), folder)).linear.compliance


MEAN = {"coupling": "distributed", "weights": "equal"}
CASES = {
    "abaqus_part.inp": (cards.HEX, {"point": [0.01, 0.01, 0.08]}),
    "orphan_mesh.inp": (cards.TET, {"point": [0.01, 0.01, 0.08]} | MEAN),
    "calculix.inp": (cards.HEX, {"point": [0.01, 0.01, 0.08], "integration": "full"}),
    "patran.bdf": (cards.HEX, {"point": [0.01, 0.01, 0.08]}),
    "archive.cdb": (cards.HEX, {"coupling": "distributed"}),
}


@pytest.mark.parametrize("name", CASES)
def test_a_deck_goes_from_file_to_the_answer_of_a_component_written_by_hand(tmp_path, name):
    mesh, options = CASES[name]
    result = propose(cards.HERE / name, tmp_path / "new")
    assert result["check"]["ok"], result["check"]["problems"]
    answer = Solver(read_bundle(tmp_path / "new")).linear.compliance @ LOAD
    expected = reference(tmp_path / "hand", mesh, **options) @ LOAD
    np.testing.assert_allclose(answer, expected, rtol=1e-6, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize(
    ("name", "decided"),
    [("bracket.inp", 'range at "Surf-1"'), ("tied_blocks.inp", "hex8 cells get midside nodes")],
)
def test_a_shipped_deck_becomes_a_component_with_one_decision(tmp_path, name, decided):
    result = propose(SHIPPED.parent / "decks" / name, tmp_path / "new", "mm")
    assert result["check"]["ok"]
    assert [line.startswith(decided) for line in result["decide"]] == [True]


DECKS = {
    "patran.bdf": (cards.HERE / "patran.bdf").read_text("utf-8"),
    "archive.cdb": (cards.HERE / "archive.cdb").read_text("utf-8"),
    "abaqus.inp": (cards.HERE / "abaqus_part.inp").read_text("utf-8"),
    "cube.inp": (cards.HERE / "cube.inp").read_text("utf-8"),
    "link.inp": (SHIPPED / "link" / "link.inp").read_text("utf-8"),
    "steps.inp": HELD,
    "bulk.bdf": bulk(),
    "listed.cdb": archive(LISTED["all"]),
    "steps.cdb": archive(LISTED["steps"]),
}
HELD_AT = {"root": ROOT_HELD, "root and middle": MIDDLE_HELD_TOO}


def proposed(folder, case):
    """Write the deck of a case and propose its component."""
    deck = folder / case["deck"]
    deck.write_text(changed(DECKS[deck.name], case), "utf-8")
    unit = case.get("unit", "mm")
    return propose(deck, folder / "new", unit or None, case.get("case"))


@cases(__file__, "proposed")
def test_what_a_deck_lacks_or_cannot_say_is_named(tmp_path, capsys, case):
    place = case["place"]
    if place == "refused":
        with pytest.raises(BundleError) as caught:
            proposed(tmp_path, case)
        reported = [str(problem) for problem in caught.value.problems]
    elif place == "printed":
        deck = tmp_path / case["deck"]
        deck.write_text(changed(DECKS[deck.name], case), "utf-8")
        assert main(["new", str(deck), str(tmp_path / "new")]) == 1
        reported = capsys.readouterr().out.splitlines()
    else:
        reported = proposed(tmp_path, case)[place]
    assert_told(case, reported)
    assert len(reported) == case.get("of", len(reported))
    if place == "decide":
        assert case["words"][0] in (tmp_path / "new" / "component.toml").read_text()


@cases(__file__, "component")
def test_what_a_deck_says_is_in_its_component(tmp_path, case):
    result = proposed(tmp_path, case)
    for place in ("left", "decide"):
        for words in case.get(place, ()):
            assert any(words in line for line in result[place]), (words, result[place])
        assert not any(
            words in line for words in case.get(f"no_{place}", ()) for line in result[place]
        )
        assert len(result[place]) == case.get(f"{place}_count", len(result[place]))
    setup = (tmp_path / "new" / "component.toml").read_text()
    assert all(words in setup for words in case.get("toml", ()))
    deck = "".join(path.read_text() for path in (tmp_path / "new").glob("*.inp"))
    assert all(words in deck for words in case.get("written", ()))
    problems = [
        f"{problem['where']}: {problem['message']}" for problem in result["check"]["problems"]
    ]
    for words in case.get("problems", ()):
        assert any(words in problem for problem in problems), (words, problems)
    if "problems" in case:
        return
    assert result["check"]["ok"], problems
    bundle = read_bundle(tmp_path / "new")
    if "holds" in case:
        tip = 100 * Solver(bundle).linear.compliance[2, 2]
        assert tip == pytest.approx(HELD_AT[case["holds"]], rel=1e-5)
    for load, force in case.get("high", {}).items():
        assert bundle.range.high[int(load)] == pytest.approx(force, rel=case.get("near", 1e-6))
    (material,) = bundle.materials
    for name in ("youngs_modulus", "poisson_ratio", "density"):
        assert getattr(material, name) == pytest.approx(case.get(name, getattr(material, name)))
    for name in ("integration", "nonlinear"):
        own = getattr(bundle.analysis, name)
        assert own == case.get(name, own)
    if "fixed" in case:
        assert list(bundle.supports.fixed) == case["fixed"]


def test_a_folder_with_a_component_is_not_overwritten(tmp_path):
    (tmp_path / "component.toml").write_text("mine")
    with pytest.raises(BundleError, match="name a new folder"):
        propose(cards.HERE / "calculix.inp", tmp_path)
    assert (tmp_path / "component.toml").read_text() == "mine"


def test_another_deck_in_the_folder_is_left_as_it_is(tmp_path):
    (tmp_path / "calculix.inp").write_text("** mine\n")
    with pytest.raises(BundleError, match=r"has another calculix\.inp, which is left as it is"):
        propose(cards.HERE / "calculix.inp", tmp_path)
    assert (tmp_path / "calculix.inp").read_text() == "** mine\n"


def test_an_archive_without_elements_is_refused_without_an_empty_list(tmp_path):
    (tmp_path / "e.cdb").write_text("/PREP7\n")
    with pytest.raises(BundleError, match="has no solid elements; export the volume mesh"):
        propose(tmp_path / "e.cdb", tmp_path / "e", "mm")


@pytest.mark.parametrize(
    "change", [("*ELEMENT, TYPE=C3D20", "*ELEMENT, TYPE=C3D99"), ("--case", "none")]
)
def test_a_deck_or_case_that_is_refused_leaves_no_folder(tmp_path, change):
    (tmp_path / "steps.inp").write_text(HELD.replace(*change))
    case = change[1] if change[0] == "--case" else None
    with pytest.raises(BundleError, match=r"C3D99R|no case"):
        propose(tmp_path / "steps.inp", tmp_path / "new", "mm", case)
    assert [path.name for path in tmp_path.iterdir()] == ["steps.inp"]


def test_a_folder_that_cannot_be_made_and_a_deck_that_cannot_be_read_are_named(tmp_path, capsys):
    (tmp_path / "file").write_text("no folder")
    assert main(["new", str(cards.HERE / "calculix.inp"), str(tmp_path / "file")]) == 1
    assert "cannot be written (File exists); name a new folder" in capsys.readouterr().out
    for deck in (tmp_path / "none.inp", tmp_path):
        assert main(["new", str(deck), str(tmp_path / "new")]) == 1
        assert f"{deck}: cannot be read" in capsys.readouterr().out


def test_the_command_ends_with_one_where_something_is_left_to_decide(tmp_path, capsys):
    text = DECKS["abaqus.inp"].replace("Set-Foot, ENCASTRE\n", "")
    (tmp_path / "a.inp").write_text(text)
    assert main(["new", "--json", str(tmp_path / "a.inp"), str(tmp_path / "new")]) == 1
    assert json.loads(capsys.readouterr().out)["decide"]


COLLAPSED = {  # each node of a SOLID186 by the nodes of the cell
    "wedge15": [0, 1, 2, 2, 3, 4, 5, 5, 6, 7, 2, 8, 9, 10, 5, 11, 12, 13, 14, 14],
    "tet10": [0, 1, 2, 2, 3, 3, 3, 3, 4, 5, 2, 6, 3, 3, 3, 3, 7, 8, 9, 9],
}


@pytest.mark.parametrize("kind", COLLAPSED)
def test_collapsed_hexahedra_of_an_archive_are_wedges_and_tetrahedra(tmp_path, kind):
    source = box(kind, (1, 1, 2), (20.0, 20.0, 60.0))
    (tmp_path / "a.cdb").write_text(cards.archive(source, "", COLLAPSED[kind]))
    propose(tmp_path / "a.cdb", tmp_path / "new", "mm")
    mesh = read_mesh(tmp_path / "new" / "a.inp", "mm")
    assert mesh.cell_counts == source.cell_counts
    assert volumes(mesh.points, mesh.blocks[0]).sum() == pytest.approx(24e-6, rel=1e-9)
    assert not folded_cells(mesh.points, mesh.blocks[0]).size


def test_a_hexahedron_of_an_archive_with_an_edge_in_place_of_its_top_is_refused(tmp_path):
    source = box("wedge15", (1, 1, 2), (20.0, 20.0, 60.0))
    ridge = [0, 1, 4, 3, 2, 2, 5, 5, 6, 10, 9, 11, 2, 14, 5, 14, 8, 7, 10, 11]
    (tmp_path / "a.cdb").write_text(cards.archive(source, "", ridge))
    with pytest.raises(BundleError, match="has element 1 with a corner twice; repeat corner 3"):
        propose(tmp_path / "a.cdb", tmp_path / "new", "mm")


def test_a_wedge_of_nastran_keeps_its_midside_nodes(tmp_path):
    source = box("wedge15", (1, 1, 2), (20.0, 20.0, 60.0))
    lines = ["BEGIN BULK"]
    lines += [f"GRID,{i},,{x},{y},{z}" for i, (x, y, z) in enumerate(source.points.tolist(), 1)]
    for i, cell in enumerate((source.blocks[0].nodes + 1).tolist(), 1):
        order = [*cell[:9], *cell[12:15], *cell[9:12]]
        first, second, third = order[:6], order[6:14], order[14:]
        lines.append(f"CPENTA,{i},1,{','.join(map(str, first))}")
        lines += [f"+,{','.join(map(str, part))}" for part in (second, third)]
    (tmp_path / "a.bdf").write_text("\n".join([*lines, "ENDDATA", ""]))
    propose(tmp_path / "a.bdf", tmp_path / "new", "mm")
    mesh = read_mesh(tmp_path / "new" / "a.inp", "mm")
    assert mesh.cell_counts == source.cell_counts
    assert volumes(mesh.points, mesh.blocks[0]).sum() == pytest.approx(24e-6, rel=1e-9)
    assert not folded_cells(mesh.points, mesh.blocks[0]).size


TWO_PARTS = """*Part, name=Bolt
*Node
{nodes}
*Element, type=C3D20R
{cells}
*Elset, elset=Set-1, generate
1, 16
*Solid Section, elset=Set-1, material=Steel
*End Part
"""


def test_instances_of_two_parts_have_each_their_section_and_a_tie_is_named(tmp_path):
    nodes, cells = "\n".join(cards.nodes(cards.HEX)), "\n".join(cards.cells(cards.HEX))
    text = DECKS["abaqus.inp"].replace(
        "*Assembly,", TWO_PARTS.format(nodes=nodes, cells=cells) + "*Assembly,"
    )
    placed = "*Instance, name=Bolt-1, part=Bolt\n 5., 0., -60.\n*End Instance\n"
    text = text.replace("*End Instance\n", f"*End Instance\n{placed}", 1)
    text = text.replace("*Density", "*Elastic\n210000., 0.3\n*Material, name=Aluminium\n*Density")
    text = text.replace("*Material, name=Aluminium", "*Material, name=Steel", 1)
    tie = "*Tie, name=Tie-1\nFoot, Head\n"
    (tmp_path / "a.inp").write_text(text.replace("*Step,", f"{tie}*Step,"))
    result = propose(tmp_path / "a.inp", tmp_path / "new", "mm")
    moduli = {
        material.region: material.youngs_modulus
        for material in read_bundle(tmp_path / "new").materials
    }
    assert moduli == {"Block-1.Set-1": 70e9, "Bolt-1.Set-1": 210e9}
    assert ["TIE" in item for item in result["left"]] == [True]
    assert "part 2 of 2" in result["check"]["problems"][0]["message"]


def test_first_order_cells_are_proposed_with_midside_nodes(tmp_path):
    text = head(box("hex8", (10, 2, 2), (100.0, 10.0, 10.0)), "C3D8R") + HELD[len(head()) :]
    (tmp_path / "a.inp").write_text(text)
    result = propose(tmp_path / "a.inp", tmp_path / "new", "mm")
    assert result["check"]["ok"], result["check"]["problems"]
    assert result["check"]["cells"] == {"hex20": 40}
    assert any("midside" in item for item in result["decide"])
