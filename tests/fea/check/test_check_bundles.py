"""Whole bundles: what the report and its text say of them."""

import copy
import json
import subprocess
import sys

import numpy as np
import pytest

from tests.fea.boxes import box
from tests.fea.check.test_check_findings import cubes
from tests.fea.geometry import draw_two_bars
from tests.fea.mesh.test_geometry import BRACKET, toml_of
from wrenchbook.fea.check import as_text, report
from wrenchbook.fea.check.trial import largest


def write_inp(folder, mesh, *, supports='["root"]', section="tip", young="2e11", extra=""):
    """A bundle with the mesh as a deck: nodes of `root` at the least x, of `tip` at the most."""
    lines = ["*NODE"]
    lines += [f"{i + 1}, {x!r}, {y!r}, {z!r}" for i, (x, y, z) in enumerate(mesh.points.tolist())]
    lines.append("*ELEMENT, TYPE=C3D20R, ELSET=solid")
    cells = (mesh.blocks[0].nodes + 1).tolist()  # the order of nodes is that of VTK
    lines += [f"{i + 1}, " + ", ".join(map(str, cell)) for i, cell in enumerate(cells)]
    for name, end in (("root", mesh.points[:, 0].min()), ("tip", mesh.points[:, 0].max())):
        ids = np.flatnonzero(np.abs(mesh.points[:, 0] - end) < 1e-12) + 1
        lines += [f"*NSET, NSET={name}", *map(str, ids)]
    (folder / "mesh.inp").write_text("\n".join(lines) + "\n" + extra)
    (folder / "component.toml").write_text(
        f"""
name = "part"
title = "P"
[mesh]
file = "mesh.inp"
unit = "m"
[[material]]
region = "all"
youngs_modulus = {young}
poisson_ratio = 0.3
[supports]
fixed = {supports}
[interface]
section = "{section}"
coupling = "distributed"
[analysis]
nonlinear = false
[range]
force = [1, 1, 1]
moment = [1, 1, 1]
"""
    )
    return folder


def messages(told, kind):
    return [entry["message"] for entry in told[kind]]


def test_a_good_bundle_has_no_warnings_and_an_estimate(tmp_path):
    told = report(write_inp(tmp_path, box("hex20", (4, 2, 2), (4, 1, 1))))
    assert (told["ok"], told["problems"], told["warnings"]) == (True, [], [])
    assert told["cells"] == {"hex20": 16}
    assert told["quality"]["scaled_jacobian"]["worst"] == pytest.approx(1.0)
    assert [part["size"] for part in told["parts"]] == [pytest.approx([4, 1, 1])]
    assert told["coincident_nodes"] == 0
    assert told["section"]["area"] == pytest.approx(1.0)
    one = told["estimate"]
    assert one["unknowns"] == told["unknowns"] - 3 * told["supports"]["nodes"]
    assert 0 < one["linear_seconds"] < one["nonlinear_seconds"] < 60
    assert 1e8 < one["memory_bytes"] < 1e9
    assert as_text(told).endswith("ready to solve")


def test_two_parts_that_only_look_joined_are_an_error_that_says_merge(tmp_path):
    told = report(write_inp(tmp_path, cubes()))
    (problem,) = messages(told, "problems")
    assert problem.startswith("part 2 of 2 (8 cells, 1000 x 1000 x 1000 mm, middle at (1.5, 0.5")
    assert "it can move in all six ways" in problem
    assert "has 21 nodes in the places of another part's nodes: merge them" in problem
    (warning,) = messages(told, "warnings")
    assert warning.startswith("21 pairs of nodes of part 1 and part 2, which touch")
    assert told["coincident_nodes"] == 21
    assert "part 2: 8 cells, 1000 x 1000 x 1000 mm" in as_text(told)


def test_a_part_beside_the_others_is_named_with_its_distance(tmp_path):
    told = report(write_inp(tmp_path, cubes(offset=(1.25, 0, 0))))
    (problem,) = messages(told, "problems")
    assert "nearest is part 1, 250 mm away" in problem


def test_a_hinge_is_an_error_that_names_its_axis(tmp_path):
    told = report(write_inp(tmp_path, cubes(merge=lambda x: x[2] == 0)))
    (problem,) = messages(told, "problems")
    assert "turn about the line through (1, 0.5, 0) m along (0, 1, 0)" in problem
    assert "a hinge" in problem


def test_supports_that_hold_points_only_are_a_warning(tmp_path):
    mesh = box("hex20", (4, 2, 2), (4, 1, 1))
    corner = [
        np.flatnonzero((mesh.points == p).all(axis=1))[0] + 1
        for p in ([0, 0, 0], [0, 1, 0], [0, 0, 1])
    ]
    pins = "*NSET, NSET=pins\n" + "\n".join(map(str, corner)) + "\n"
    told = report(write_inp(tmp_path, mesh, supports='["pins"]', extra=pins))
    assert told["ok"]
    (warning,) = messages(told, "warnings")
    assert warning.startswith("holds 3 nodes and no whole face")


def test_steel_in_megapascals_and_a_point_in_millimetres_are_warnings(tmp_path):
    folder = write_inp(tmp_path, box("hex20", (4, 2, 2), (0.4, 0.1, 0.1)), young="2.1e5")
    setup = folder / "component.toml"
    text = setup.read_text()
    setup.write_text(text.replace("[interface]", "[interface]\npoint = [400, 50, 50]"))
    told = report(folder)
    assert told["ok"]
    modulus, point, turned = messages(told, "warnings")
    assert "degrees at the full range" in turned
    assert "write it in Pa" in modulus
    assert "write it in m" in point


def test_supports_that_touch_the_section_are_an_error(tmp_path):
    told = report(write_inp(tmp_path, box("hex20", (4, 2, 2), (4, 1, 1)), section="root"))
    assert any("are fixed by [supports]" in text for text in messages(told, "problems"))
    assert "quality" in told  # the mesh is reported all the same


def test_one_layer_between_section_and_supports_is_a_warning(tmp_path):
    told = report(write_inp(tmp_path, box("hex20", (1, 2, 2), (0.2, 1, 1))))
    assert told["ok"]
    assert not told["warnings"]  # midside nodes are free
    pinned = "*NSET, NSET=most\n" + "\n".join(
        str(i + 1) for i, x in enumerate(box("hex20", (2, 2, 2)).points[:, 0]) if x < 0.9
    )
    folder = tmp_path / "held"
    folder.mkdir()
    told = report(write_inp(folder, box("hex20", (2, 2, 2)), supports='["most"]', extra=pinned))
    assert any("8 cells have every node fixed" in text for text in messages(told, "warnings"))


def test_badly_shaped_cells_are_a_warning_with_their_place(tmp_path):
    mesh = box("hex20", (4, 2, 2), (4, 0.01, 1))
    told = report(write_inp(tmp_path, mesh))
    (warning,) = messages(told, "warnings")
    assert "16 cells are long and thin (aspect ratio over 50; the worst, a hex20 near (" in warning


def test_a_geometry_lists_its_faces_even_where_the_bundle_has_mistakes(tmp_path):
    draw_two_bars(tmp_path / "bars.step")
    table = copy.deepcopy(BRACKET)
    table["mesh"] |= {"file": "bars.step", "groups": {"wall": {"plane": "x", "at": 7}}}
    (tmp_path / "component.toml").write_text(toml_of(table))
    told = report(tmp_path)
    assert [entry["where"] for entry in told["problems"]] == ["mesh.groups.wall.plane"]
    assert len(told["faces"]) == 11
    assert len(told["bodies"]) == 2
    (tmp_path / "component.toml").write_text('[mesh]\nfile = "bars.step"\n')
    told = report(tmp_path)
    assert "mesh.size" in {entry["where"] for entry in told["problems"]}
    text = as_text(told)
    assert "plane, normal (-1, 0, 0)" in text
    assert text.endswith("errors")


def test_bodies_that_do_not_touch_are_told_by_the_check(tmp_path):
    draw_two_bars(tmp_path / "bars.step", space=1.0)
    table = copy.deepcopy(BRACKET)
    groups = {"wall": {"plane": "x", "at": 0}, "hole": {"plane": "x", "at": 0.101}}
    table["mesh"] |= {"file": "bars.step", "size": 0.01, "groups": groups}
    (tmp_path / "component.toml").write_text(toml_of(table))
    told = report(tmp_path)
    (problem,) = messages(told, "problems")
    assert "is free: it can move in all six ways" in problem
    assert "1 mm away" in problem


def test_the_text_is_printed_by_the_program(tmp_path):
    write_inp(tmp_path, box("hex20", (4, 2, 2), (4, 1, 1)), young="-1")
    command = [sys.executable, "-m", "wrenchbook.fea.check", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == 1
    assert done.stdout.splitlines()[-1] == "1 error"
    assert "error: material[0].youngs_modulus: must be above 0 (Pa), not -1" in done.stdout


def test_every_report_is_json(tmp_path):
    told = report(write_inp(tmp_path, cubes()))
    assert json.loads(json.dumps(told)) == told


def test_a_cell_that_names_a_node_twice_is_refused(tmp_path):
    mesh = box("hex20", (4, 2, 2), (4, 1, 1))
    mesh.blocks[0].nodes[5, 1] = mesh.blocks[0].nodes[5, 0]
    told = report(write_inp(tmp_path, mesh))
    assert not told["ok"]
    assert messages(told, "problems")


def test_the_largest_displacement_over_a_range_is_that_of_its_worst_corner():
    chance = np.random.default_rng(3)
    matrix, low, high = chance.normal(size=(6, 6)), -chance.random(6), chance.random(6)
    ends = np.array(np.meshgrid(*zip(low, high, strict=True))).reshape(6, -1)
    np.testing.assert_allclose(largest(matrix, low, high), np.abs(matrix @ ends).max(axis=1))
