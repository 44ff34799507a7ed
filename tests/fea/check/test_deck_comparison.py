"""What `check` tells of a deck: read, ignored, in contradiction to the component."""

import pytest

from tests.fea.boxes import box
from tests.fea.written_deck import deck_lines
from wrenchbook.fea.bundle.read import read_bundle
from wrenchbook.fea.check import as_text
from wrenchbook.fea.check import report as check

TOML = """name = "block"
title = "Block"
[mesh]
file = "block.inp"
unit = "mm"
[[material]]
region = "all"
youngs_modulus = 70e9
poisson_ratio = 0.33
density = 2700.0
[supports]
fixed = ["z0"]
[interface]
section = "z1"
point = [0.01, 0.01, 0.06]
coupling = "rigid"
[analysis]
nonlinear = false
[range]
force = [10, 10, 10]
moment = [1, 1, 1]
"""
AGREES = """*NODE, NSET=REF
9001, 10, 10, 60
*ELSET, ELSET=EALL, GENERATE
1, 16
*NSET, NSET=FOOT, ELSET=z0
*NSET, NSET=HEAD, ELSET=z1
*NSET, NSET=SIDE, ELSET=x0
*MATERIAL, NAME=ALU
*ELASTIC
70000., 0.33
*DENSITY
2.7e-9
*SOLID SECTION, ELSET=EALL, MATERIAL=ALU
*RIGID BODY, NSET=HEAD, REF NODE=9001
*BOUNDARY
FOOT, 1, 3
*STEP, NLGEOM
*STATIC
*CLOAD
9001, 3, -5.
*END STEP
"""


def block(folder, more=AGREES, toml=TOML, element=None):
    """Write a bundle of a block of 20 x 20 x 60 mm on a deck with `more` in it."""
    lines = list(deck_lines(box("hex20", (2, 2, 4), (0.02, 0.02, 0.06)), 1e-3))
    text = "\n".join(lines) + "\n" + more
    if element:
        text = text.replace("C3D20R", element)
    (folder / "block.inp").write_text(text)
    (folder / "component.toml").write_text(toml)
    return folder


def warnings(folder):
    report = check(folder)
    assert report["ok"], report["problems"]
    return [one["message"] for one in report["warnings"] if one["where"] == "mesh.file"]


def test_a_deck_that_agrees_with_its_component_gives_no_warning(tmp_path):
    assert warnings(block(tmp_path)) == []


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("70000., 0.33", "210000., 0.33", "youngs_modulus 210000, with lengths in mm 2.1e+11"),
        ("70000., 0.33", "70000., 0.3", "poisson_ratio 0.3"),
        ("2.7e-9", "2.7e-6", "density 2.7e-06, with lengths in mm 2.7e+06 in SI"),
        ("FOOT, 1, 3", "FOOT, 1, 3\nHEAD, 2", '"HEAD" along y; 21 of its nodes are free'),
        ("FOOT, 1, 3", "HEAD, XSYMM", '"HEAD" along x; 21 of its nodes are free'),
        ("FOOT, 1, 3", "33, 1, 3", "1 of its nodes are free"),
        ("NSET=HEAD, REF", "NSET=SIDE, REF", "no interface or bushing"),
        ("9001, 10, 10, 60", "9001, 10, 10, 90", "interface.point is (0.01, 0.01, 0.06)"),
        ("*STEP, NLGEOM", "*EQUATION\n2\n1, 1, 1., 2, 1, -1.\n*STEP", "*EQUATION ties nodes"),
        ("*STEP, NLGEOM", "*MPC\nBEAM, 1, 2\n*STEP", "*MPC ties nodes"),
        ("*STEP, NLGEOM", "*TRANSFORM, NSET=FOOT\n1,0,0,0,1,0\n*STEP", "*TRANSFORM turns"),
        ("*STEP, NLGEOM", "*SPRING, ELSET=E\n\n5.\n*STEP", "*SPRING is not solved"),
        ("*STEP, NLGEOM", "*ELEMENT, TYPE=MASS\n999, 5\n*STEP", "MASS is not solved"),
        ("*DENSITY", "*EXPANSION, TYPE=ORTHO\n1e-5\n*DENSITY", "of type ORTHO is not compared"),
        ("70000., 0.33", "seven, 0.33", "*ELASTIC is not understood"),
    ],
)
def test_what_a_deck_says_otherwise_is_a_warning_with_its_line(tmp_path, old, new, words):
    assert AGREES.count(old) == 1
    found = warnings(block(tmp_path, AGREES.replace(old, new)))
    assert len(found) == 1
    assert words in found[0]
    assert found[0].startswith("line ")


def test_a_coupling_of_another_kind_is_a_warning(tmp_path):
    coupling = "*COUPLING, REF NODE=9001, SURFACE=S, CONSTRAINT NAME=C\n*DISTRIBUTING\n1, 6\n"
    surface = "*SURFACE, NAME=S, TYPE=NODE\nHEAD\n"
    text = AGREES.replace("*RIGID BODY, NSET=HEAD, REF NODE=9001\n", surface + coupling)
    (found,) = warnings(block(tmp_path, text))
    assert 'as a "distributed" coupling; interface says "rigid"' in found


def test_thermal_expansion_is_compared_where_both_have_one(tmp_path):
    text = AGREES.replace("*DENSITY", "*EXPANSION\n12e-6\n*DENSITY")
    toml = TOML.replace("density", "thermal_expansion = 23e-6\ndensity")
    toml += "[inputs.temperature]\nrange = [0, 40]\nreference = 20\n"
    (found,) = warnings(block(tmp_path, text, toml))
    assert "thermal_expansion 1.2e-05" in found


@pytest.mark.parametrize(
    ("keyword", "without", "words"),
    [
        ("*EXPANSION\n12e-6\n*DENSITY", "", "thermal_expansion 1.2e-05"),
        ("*DENSITY", "density = 2700.0\n", "density 2.7e-09"),
    ],
)
def test_a_constant_that_the_component_lacks_is_a_warning(tmp_path, keyword, without, words):
    toml = TOML.replace(without, "") if without else TOML
    (found,) = warnings(block(tmp_path, AGREES.replace("*DENSITY", keyword), toml))
    assert words in found
    assert found.endswith("the component has none")


@pytest.mark.parametrize(
    ("law", "words"),
    [
        ('"neo-hookean"\nyoungs_modulus = 3e6\npoisson_ratio = 0.33', "has 3e+06"),
        (
            '"orthotropic"\nyoungs_modulus = [70e9, 9e9, 9e9]\npoisson_ratio = [0.3, 0.3, 0.3]\n'
            "shear_modulus = [4e9, 4e9, 4e9]",
            'isotropic; the component has law = "orthotropic"',
        ),
    ],
)
def test_another_law_than_the_decks_is_a_warning(tmp_path, law, words):
    toml = TOML.replace("youngs_modulus = 70e9\npoisson_ratio = 0.33", f"law = {law}")
    (found,) = warnings(block(tmp_path, toml=toml.replace("nonlinear = false", "nonlinear = true")))
    assert words in found


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
    toml = TOML.replace("[analysis]", '[analysis]\nintegration = "reduced"')
    (found,) = warnings(block(tmp_path, toml=toml, element="C3D20"))
    assert "has C3D20; [analysis] says" in found


def test_a_hybrid_element_is_named_with_what_is_solved_instead(tmp_path):
    report = check(block(tmp_path, element="C3D20H"))
    assert report["mesh_file"]["elements"]["C3D20H"]["count"] == 16
    assert "displacements alone" in as_text(report)


def test_held_reference_nodes_are_supports_of_what_they_move(tmp_path):
    text = AGREES.replace("FOOT, 1, 3", "9001, 1, 6")
    text = text.replace("*RIGID BODY, NSET=HEAD", "*RIGID BODY, NSET=FOOT")
    assert warnings(block(tmp_path, text)) == []
