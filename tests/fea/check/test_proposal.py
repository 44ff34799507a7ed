"""Decks of five CAE tools become components that answer, and say what they leave open."""

import json
from dataclasses import replace

import numpy as np
import pytest

from tests.fea.boxes import box
from tests.fea.cae import make
from tests.fea.check.test_load_cases import HELD, LISTED, archive, bulk
from tests.fea.written_deck import deck_lines
from tests.refusals import assert_told, cases, changed
from wrenchbook.fea.bundle.read import BundleError, bundle_of, read_bundle
from wrenchbook.fea.bundle.shipped import SHIPPED
from wrenchbook.fea.check.commands import main
from wrenchbook.fea.check.proposal import propose
from wrenchbook.fea.mesh.io.read import read_mesh
from wrenchbook.fea.mesh.mapping import folded_cells, volumes
from wrenchbook.fea.solve import Solver

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


CASES = {
    "abaqus_part.inp": (make.HEX, {"point": [0.01, 0.01, 0.08]}),
    "orphan_mesh.inp": (make.TET, {"point": [0.01, 0.01, 0.08], "coupling": "distributed"}),
    "calculix.inp": (make.HEX, {"point": [0.01, 0.01, 0.08], "integration": "full"}),
    "patran.bdf": (make.HEX, {"point": [0.01, 0.01, 0.08]}),
    "archive.cdb": (make.HEX, {"coupling": "distributed"}),
}


@pytest.mark.parametrize("name", CASES)
def test_a_deck_goes_from_file_to_the_answer_of_a_component_written_by_hand(tmp_path, name):
    mesh, options = CASES[name]
    found = propose(make.HERE / name, tmp_path / "new")
    assert found["check"]["ok"], found["check"]["problems"]
    answer = Solver(read_bundle(tmp_path / "new")).linear.compliance @ LOAD
    expected = reference(tmp_path / "hand", mesh, **options) @ LOAD
    np.testing.assert_allclose(answer, expected, rtol=1e-6, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("name", CASES)
def test_a_shipped_deck_is_what_its_generator_writes(name):
    assert (make.HERE / name).read_text() == make.DECKS[name]()


def test_loads_of_the_deck_are_the_range_and_its_points_loads(tmp_path):
    propose(make.HERE / "abaqus_part.inp", tmp_path / "new")
    range_ = read_bundle(tmp_path / "new").range
    np.testing.assert_allclose(range_.high, [50, 50, 50, 0.8, 0.8, 0.8])


DECKS = {name: (make.HERE / name).read_text("utf-8") for name in ("patran.bdf", "archive.cdb")}
DECKS |= {"abaqus.inp": make.abaqus(), "cube.inp": (make.HERE / "cube.inp").read_text("utf-8")}
DECKS |= {"steps.inp": HELD, "bulk.bdf": bulk(), "listed.cdb": archive(LISTED["all"])}
DECKS |= {"link.inp": (SHIPPED / "link" / "link.inp").read_text("utf-8")}


@cases(__file__, "proposed")
def test_what_a_deck_lacks_or_cannot_say_is_named(tmp_path, capsys, case):
    deck = tmp_path / case["deck"]
    deck.write_text(changed(DECKS[deck.name], case), "utf-8")
    place = case["place"]
    if place == "refused":
        with pytest.raises(BundleError) as caught:
            propose(deck, tmp_path / "new", "mm", case.get("case"))
        told = [str(problem) for problem in caught.value.problems]
    elif place == "printed":
        assert main(["new", str(deck), str(tmp_path / "new")]) == 1
        told = capsys.readouterr().out.splitlines()
    else:
        told = propose(deck, tmp_path / "new", "mm")[place]
    assert_told(case, told)
    assert len(told) == case.get("of", len(told))
    if place == "decide":
        assert case["words"][0] in (tmp_path / "new" / "component.toml").read_text()


def test_a_proposal_without_supports_is_not_ready_and_its_check_lists_the_groups(tmp_path):
    text = make.abaqus().replace("Set-Foot, ENCASTRE\n", "")
    (tmp_path / "a.inp").write_text(text)
    (problem,) = propose(tmp_path / "a.inp", tmp_path / "new", "mm")["check"]["problems"]
    assert problem["where"] == "supports.fixed[0]"
    assert "Set-Foot" in problem["message"]


def test_what_is_not_taken_over_is_named_with_its_line(tmp_path):
    text = make.abaqus().replace("*Step,", "*Equation\n2\n1,1,1.,2,1,-1.\n*Step,")
    (tmp_path / "a.inp").write_text(text)
    (left,) = propose(tmp_path / "a.inp", tmp_path / "new", "mm")["left"]
    assert left.startswith(f"line {text[: text.index('*Equation')].count(chr(10)) + 1}: *EQUATION")


def test_lengths_in_inches_go_with_pounds(tmp_path):
    text = make.abaqus().replace("70000., 0.33", "1e7, 0.33")
    (tmp_path / "a.inp").write_text(text)
    propose(tmp_path / "a.inp", tmp_path / "new", "in")
    bundle = read_bundle(tmp_path / "new")
    assert bundle.materials[0].youngs_modulus == pytest.approx(68.947573e9, rel=1e-8)
    assert bundle.range.high[3] == pytest.approx(800 * 4.4482216 * 0.0254, rel=1e-4)


def test_two_free_couplings_are_two_interfaces(tmp_path):
    text = make.abaqus().replace("Set-Foot, ENCASTRE\n", "1, ENCASTRE\n")
    coupling = (
        "*Nset, nset=Ref-2\n2\n*Surface, type=NODE, name=Foot\nSet-Foot\n"
        "*Coupling, constraint name=C-2, ref node=Ref-2, surface=Foot\n*Distributing\n"
    )
    text = text.replace("*End Assembly", f"{coupling}*End Assembly")
    text = text.replace(" 80.\n*Nset", " 80.\n2, 15., 10., 0.\n*Nset").replace("1, ENCASTRE\n", "")
    (tmp_path / "a.inp").write_text(text)
    propose(tmp_path / "a.inp", tmp_path / "new", "mm")
    written = (tmp_path / "new" / "component.toml").read_text()
    assert written.count("[[interface]]") == 2
    assert 'section = "Foot"' in written
    assert 'section = "Surf-1"' in written


def test_a_held_reference_point_makes_its_section_a_support(tmp_path):
    coupling = (
        "*Surface, type=NODE, name=Foot\nSet-Foot\n"
        "*Coupling, constraint name=C-2, ref node=2, surface=Foot\n*Kinematic\n"
    )
    text = make.abaqus().replace("*End Assembly", f"{coupling}*End Assembly")
    text = text.replace(" 80.\n*Nset", " 80.\n2, 15., 10., 0.\n*Nset")
    (tmp_path / "a.inp").write_text(text.replace("Set-Foot, ENCASTRE", "2, ENCASTRE"))
    assert propose(tmp_path / "a.inp", tmp_path / "new", "mm")["check"]["ok"]
    supports = read_bundle(tmp_path / "new").supports
    assert supports is not None
    assert supports.fixed == ("Foot",)


def test_a_folder_with_a_component_is_not_overwritten(tmp_path):
    (tmp_path / "component.toml").write_text("mine")
    with pytest.raises(BundleError, match="name a new folder"):
        propose(make.HERE / "calculix.inp", tmp_path)
    assert (tmp_path / "component.toml").read_text() == "mine"


def test_a_folder_that_cannot_be_made_and_a_deck_that_cannot_be_read_are_named(tmp_path, capsys):
    (tmp_path / "file").write_text("no folder")
    assert main(["new", str(make.HERE / "calculix.inp"), str(tmp_path / "file")]) == 1
    assert "cannot be written (File exists); name a new folder" in capsys.readouterr().out
    for deck in (tmp_path / "none.inp", tmp_path):
        assert main(["new", str(deck), str(tmp_path / "new")]) == 1
        assert f"{deck}: cannot be read" in capsys.readouterr().out


def test_the_command_ends_with_one_where_something_is_left_to_decide(tmp_path, capsys):
    text = make.abaqus().replace("Set-Foot, ENCASTRE\n", "")
    (tmp_path / "a.inp").write_text(text)
    assert main(["new", "--json", str(tmp_path / "a.inp"), str(tmp_path / "new")]) == 1
    assert json.loads(capsys.readouterr().out)["decide"]


def test_an_archive_with_its_types_in_a_block_is_read_with_their_integration(tmp_path):
    text = make.ansys().replace("ET,        1,186\nKEYOP,        1, 2,        0\n", "")
    options = "".join(f"{n:9d}" for n in [0, 1, *[0] * 17])
    block = f"ETBLOCK,        1,        1\n(2i9,19a9)\n{1:9d}{186:9d}{options}\n{-1:9d}\n"
    (tmp_path / "a.cdb").write_text(text.replace("NBLOCK", f"{block}NBLOCK", 1))
    assert propose(tmp_path / "a.cdb", tmp_path / "new", "mm")["check"]["ok"]
    assert read_bundle(tmp_path / "new").analysis.integration == "full"


COLLAPSED = {  # each node of a SOLID186 by the nodes of the cell
    "wedge15": [0, 1, 2, 2, 3, 4, 5, 5, 6, 7, 2, 8, 9, 10, 5, 11, 12, 13, 14, 14],
    "tet10": [0, 1, 2, 2, 3, 3, 3, 3, 4, 5, 2, 6, 3, 3, 3, 3, 7, 8, 9, 9],
}


@pytest.mark.parametrize("kind", COLLAPSED)
def test_collapsed_hexahedra_of_an_archive_are_wedges_and_tetrahedra(tmp_path, kind):
    source = box(kind, (1, 1, 2), (20.0, 20.0, 60.0))
    lines = ["/PREP7", "ET,1,SOLID186", "NBLOCK,6,SOLID", "(3i9,6e21.13e3)"]
    for i, point in enumerate(source.points.tolist(), 1):
        lines.append(f"{i:9d}{0:9d}{0:9d}" + "".join(f"{x:21.13E}" for x in point))
    lines += ["N,R5.3,LOC,       -1,", "EBLOCK,19,SOLID,1,1", "(19i9)"]
    for i, cell in enumerate((source.blocks[0].nodes + 1).tolist(), 1):
        own = [cell[j] for j in COLLAPSED[kind]]
        fields = [1, 1, 1, 1, 0, 0, 0, 0, 20, 0, i, *own]
        lines += ["".join(f"{n:9d}" for n in part) for part in (fields[:19], fields[19:])]
    (tmp_path / "a.cdb").write_text("\n".join([*lines, f"{-1:9d}", "FINISH", ""]))
    propose(tmp_path / "a.cdb", tmp_path / "new", "mm")
    mesh = read_mesh(tmp_path / "new" / "a.inp", "mm")
    assert mesh.cell_counts == source.cell_counts
    assert volumes(mesh.points, mesh.blocks[0]).sum() == pytest.approx(24e-6, rel=1e-9)
    assert not folded_cells(mesh.points, mesh.blocks[0]).size


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


def test_a_mean_of_several_nastran_weights_is_named_and_one_of_equal_weights_taken(tmp_path):
    text = make.nastran()
    start, end = text.index("RBE2"), text.index("SPC1")
    head = make.at(make.HEX, 60.0)
    taken = make.card("RBE3", 900, "", len(make.HEX.points) + 1, 123456, "1.", 123, *head)
    (tmp_path / "a.bdf").write_text(text[:start] + "\n".join(taken) + "\n" + text[end:])
    assert propose(tmp_path / "a.bdf", tmp_path / "new", "mm")["left"] == []
    (interface,) = read_bundle(tmp_path / "new").interfaces
    assert (interface.section, interface.coupling) == ("RBE3_900", "distributed")
    mixed = make.card("RBE3", 900, "", 1, 123456, "1.", 123, *head[:5], "2.", 123, *head[5:])
    (tmp_path / "b.bdf").write_text(text[:start] + "\n".join(mixed) + "\n" + text[end:])
    (left,) = propose(tmp_path / "b.bdf", tmp_path / "other", "mm")["left"]
    assert "several weights" in left


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
    nodes, cells = "\n".join(make.nodes(make.HEX)), "\n".join(make.cells(make.HEX))
    text = make.abaqus().replace(
        "*Assembly,", TWO_PARTS.format(nodes=nodes, cells=cells) + "*Assembly,"
    )
    placed = "*Instance, name=Bolt-1, part=Bolt\n 5., 0., -60.\n*End Instance\n"
    text = text.replace("*End Instance\n", f"*End Instance\n{placed}", 1)
    text = text.replace("*Density", "*Elastic\n210000., 0.3\n*Material, name=Aluminium\n*Density")
    text = text.replace("*Material, name=Aluminium", "*Material, name=Steel", 1)
    tie = "*Tie, name=Tie-1\nFoot, Head\n"
    (tmp_path / "a.inp").write_text(text.replace("*Step,", f"{tie}*Step,"))
    found = propose(tmp_path / "a.inp", tmp_path / "new", "mm")
    moduli = {one.region: one.youngs_modulus for one in read_bundle(tmp_path / "new").materials}
    assert moduli == {"Block-1.Set-1": 70e9, "Bolt-1.Set-1": 210e9}
    assert ["TIE" in one for one in found["left"]] == [True]
    assert "part 2 of 2" in found["check"]["problems"][0]["message"]


def test_cells_without_a_section_get_no_material_of_others(tmp_path):
    text = make.abaqus().replace("  1,  16,   1", "  1,  12,   1")
    (tmp_path / "a.inp").write_text(text)
    (problem,) = propose(tmp_path / "a.inp", tmp_path / "new", "mm")["check"]["problems"]
    assert "4 cells have no material" in problem["message"]


def test_first_order_cells_are_proposed_with_midside_nodes(tmp_path, monkeypatch):
    monkeypatch.setattr(make, "HEX", box("hex8", (2, 2, 6), (20.0, 20.0, 60.0)))
    text = make.abaqus().replace("C3D20R", "C3D8R").replace("1,  16,", "1,  24,")
    (tmp_path / "a.inp").write_text(text)
    found = propose(tmp_path / "a.inp", tmp_path / "new", "mm")
    assert found["check"]["ok"], found["check"]["problems"]
    assert found["check"]["cells"] == {"hex20": 24}
    assert any("midside" in one for one in found["decide"])


def test_large_field_cards_and_continuations_with_names_are_read(tmp_path):
    text = make.nastran()
    short = "\n".join(make.card("MAT1", 4, "70000.", "", ".33", "2.7-9"))
    assert short in text
    wide = f"MAT1*   {4:16d}{'70000.':>16}{'':16}{'.33':>16}*M1\n*M1     {'2.7-9':>16}"
    (tmp_path / "a.bdf").write_text(text.replace(short, wide))
    propose(tmp_path / "a.bdf", tmp_path / "new", "mm")
    (material,) = read_bundle(tmp_path / "new").materials
    assert (material.youngs_modulus, material.poisson_ratio) == (70e9, 0.33)
    assert material.density == pytest.approx(2700)
