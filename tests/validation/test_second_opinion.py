"""A user's own component in CalculiX too: what is compared, printed and refused."""

import json
import shutil

import numpy as np
import pytest

from tests.fea.calculix import require_ccx
from tests.validation import calculix, second_opinion
from tests.validation.second_opinion import difference, main
from wrenchbook.fea.bundle.shipped import SHIPPED

WRENCH = "--wrench=100,50,-80,10,20,5"


def bar(tmp_path, *changes):
    folder = tmp_path / "bar"
    shutil.copytree(SHIPPED / "bar", folder)
    path = folder / "component.toml"
    text = path.read_text("utf-8")
    for old, new in (("cells_along = 40", "cells_along = 6"), *changes):
        assert old in text, old
        text = text.replace(old, new)
    path.write_text(text, "utf-8")
    return str(folder)


@pytest.mark.ccx
@pytest.mark.parametrize("coupling", ["rigid", "distributed"])
def test_a_linear_component_agrees_in_both_couplings(tmp_path, coupling, capsys):
    require_ccx()
    folder = bar(tmp_path, ('coupling = "distributed"', f'coupling = "{coupling}"'))
    assert main([WRENCH, "--wrench=0,0,-100,0,0,0", folder]) == 0
    reported = capsys.readouterr().out
    assert reported.count("agrees:") == 2
    assert "CalculiX does not print" not in reported
    assert all(f"  {name} " in reported for name in ("ux", "uy", "uz", "rx", "ry", "rz"))


@pytest.mark.ccx
def test_a_nonlinear_distributed_component_is_compared_rigid_and_says_so(tmp_path, capsys):
    require_ccx()
    folder = bar(tmp_path, ("nonlinear = false", "nonlinear = true"))
    assert main([WRENCH, folder]) == 0
    reported = capsys.readouterr().out
    assert 'with coupling = "rigid" in its place' in reported
    assert "at most 1e-04" in reported


@pytest.mark.ccx
def test_an_answer_that_differs_ends_with_1_and_says_by_how_much(tmp_path, capsys, monkeypatch):
    require_ccx()
    true = calculix.solve_distributed

    def off(*told, **named):
        reply = true(*told, **named)
        return reply._replace(displacement=reply.displacement * (1 + 1e-3))

    monkeypatch.setattr(calculix, "solve_distributed", off)
    assert main([WRENCH, bar(tmp_path)]) == 1
    assert "DIFFERS: 1.0e-03" in capsys.readouterr().out


@pytest.mark.ccx
def test_without_wrenches_half_the_range_is_taken_and_json_is_json(tmp_path, capsys):
    require_ccx()
    assert main(["--json", bar(tmp_path)]) == 0
    (row,) = json.loads(capsys.readouterr().out)
    assert row["agrees"] is True
    assert row["wrench"] == [500.0, 50.0, 50.0, 25.0, 25.0, 25.0]


@pytest.mark.ccx
def test_a_wrench_that_cannot_be_solved_does_not_stop_the_others(tmp_path, capsys):
    require_ccx()
    assert main(["--wrench=0,0,-1e6,0,0,0", WRENCH, bar(tmp_path)]) == 1
    reported = capsys.readouterr().out
    assert "not solved: " in reported
    assert "agrees:" in reported


@pytest.mark.parametrize("text", ["1,2", "1,2,3,4,5,x", "nan,0,0,0,0,0", "inf,0,0,0,0,0", ""])
def test_what_is_no_wrench_is_refused_with_an_example(tmp_path, text, capsys, monkeypatch):
    monkeypatch.setattr(calculix, "installed", lambda: True)
    assert main([f"--wrench={text}", bar(tmp_path)]) == 1
    assert "such as 0,0,-500,10,0,0" in capsys.readouterr().err


def test_without_ccx_it_says_what_to_install(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(calculix, "installed", lambda: False)
    assert main([bar(tmp_path)]) == 1
    assert "apt-get install calculix-ccx" in capsys.readouterr().err


def test_cells_that_calculix_has_not_are_named_before_anything_is_solved(
    tmp_path, capsys, monkeypatch
):
    monkeypatch.setattr(calculix, "installed", lambda: True)
    monkeypatch.setattr(second_opinion, "deck_of", _refused)
    assert main([bar(tmp_path)]) == 1
    assert "no element" in capsys.readouterr().err


def _refused(_part):
    raise second_opinion.BundleError(
        [second_opinion.BundleProblem("mesh", "CalculiX has no element")]
    )


def test_the_difference_is_relative_to_the_largest_of_its_kind():
    right = np.array([1e-3, 0, 1e-9, 0.1, 0, 0])
    assert difference(right + 1e-9 * np.eye(6)[1], right) == pytest.approx(1e-6)
    assert difference(right + 1e-3 * np.eye(6)[4], right) == pytest.approx(1e-2)
    assert difference(np.zeros(6), np.zeros(6)) == 0.0
    assert difference(right, np.zeros(6)) == np.inf
