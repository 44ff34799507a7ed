"""What every solve would refuse is refused before, and numbers tell a wrong unit."""

import numpy as np
import pytest

from tests.fea.boxes import box
from tests.fea.check.test_check_bundles import messages, write_inp
from wrenchbook.fea.check import as_text, report
from wrenchbook.fea.check.trial import largest

BAR = """name = "bar"
title = "B"
[mesh]
generator = "bar"
length = {length}
width = {width}
height = {width}
cells_along = 4
cells_across = {across}
[[material]]
region = "all"
youngs_modulus = {young}
poisson_ratio = {poisson}
density = 7850.0
[supports]
fixed = ["start"]
[interface]
section = "end"
coupling = "distributed"
[analysis]
nonlinear = false
[range]
force = [{force}, {force}, {force}]
moment = [1, 1, 1]
[tolerance]
translation = 1e-6
rotation = 1e-6
"""


def checked(folder, **changes):
    options = {"length": 1.0, "width": 0.1, "across": 2, "young": 2e11, "poisson": 0.3}
    (folder / "component.toml").write_text(BAR.format(**{**options, "force": 100.0, **changes}))
    return report(folder)


def test_one_layer_of_reduced_cells_is_refused_with_its_remedy_once(tmp_path):
    told = checked(tmp_path, across=1)
    (message,) = messages(told, "problems")
    assert not told["ok"]
    assert message.startswith("every solve would fail, mechanism: ")
    assert message.count("at least two reduced-integration hex20") == 1


def test_a_nearly_incompressible_material_in_cells_that_lock_is_refused(tmp_path):
    told = checked(tmp_path, poisson=0.4999)
    (entry,) = told["problems"]
    assert entry["where"] == "material"
    assert "locking_material" in entry["message"]


def test_a_cell_that_names_a_node_twice_is_refused(tmp_path):
    mesh = box("hex20", (4, 2, 2), (4, 1, 1))
    mesh.blocks[0].nodes[5, 1] = mesh.blocks[0].nodes[5, 0]
    told = report(write_inp(tmp_path, mesh))
    assert not told["ok"]
    assert messages(told, "problems")


def test_size_mass_and_deflection_are_those_of_the_beam(tmp_path):
    told = checked(tmp_path)
    one = told["trial"]
    assert one["size"] == pytest.approx([1.0, 0.1, 0.1])
    assert one["mass"] == pytest.approx(78.5)
    assert one["mass"] == pytest.approx(told["vibration"]["mass"])
    second = 0.1**4 / 12
    force_and_moment = 100.0 / 3 / (2e11 * second) + 1.0 / 2 / (2e11 * second)
    assert one["deflection"][2] == pytest.approx(force_and_moment, rel=0.03)
    assert "size: 1000 x 100 x 100 mm, 1e+04 cm^3, 78.5 kg" in as_text(told)


def test_a_part_that_its_range_does_not_move_is_a_warning(tmp_path):
    assert not about_range(checked(tmp_path))
    (warning,) = about_range(checked(tmp_path, width=1.0, force=1.0))
    assert "rigid for its users" in warning


def about_range(told):
    """Return the warnings but for that of the self-weight, 57 um here."""
    return [one["message"] for one in told["warnings"] if one["where"] != "analysis.gravity"]


def test_a_part_that_its_range_bends_double_is_a_warning_that_names_the_units(tmp_path):
    told = checked(tmp_path, width=0.01, force=1e4)
    (warning,) = (one["message"] for one in told["warnings"] if one["where"] == "range")
    assert "degrees at the full range" in warning
    assert "youngs_modulus in Pa" in warning


def test_metres_that_were_millimetres_are_told_by_the_modulus_and_the_point(tmp_path):
    told = report(write_inp(tmp_path, box("hex20", (4, 2, 2), (300, 10, 10)), young="7e4"))
    assert any("write it in Pa" in text for text in messages(told, "warnings"))


def test_the_largest_displacement_over_a_range_is_that_of_its_worst_corner():
    chance = np.random.default_rng(3)
    matrix, low, high = chance.normal(size=(6, 6)), -chance.random(6), chance.random(6)
    ends = np.array(np.meshgrid(*zip(low, high, strict=True))).reshape(6, -1)
    np.testing.assert_allclose(largest(matrix, low, high), np.abs(matrix @ ends).max(axis=1))


def test_a_mesh_that_is_off_by_more_than_the_tolerance_is_warned_of(tmp_path):
    told = checked(tmp_path, width=0.05)
    said = [one["message"] for one in told["warnings"] if one["where"] == "tolerance"]
    assert any("the mesh alone may be wrong by" in one and "cells about" in one for one in said)
    assert np.shape(told["solver_error"]["mesh"]) == (6, 6)


def test_a_linear_range_beyond_buckling_is_warned_of(tmp_path):
    said = " ".join(messages(checked(tmp_path, force=3e7), "warnings"))
    assert "buckles at" in said


def test_a_trial_that_fails_is_not_called_too_long(tmp_path):
    told = checked(tmp_path, across=1)
    assert not told["ok"]
    assert "takes too long" not in as_text(told)
