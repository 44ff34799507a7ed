"""`python -m wrenchbook.fea.check FOLDER`: one line of JSON and an exit status."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.refusals import GOOD
from wrenchbook.fea.bundle.read import read_bundle
from wrenchbook.fea.check import report as check
from wrenchbook.fea.check.commands import main

SHIPPED = Path(__file__).parents[3] / "data" / "components"


def test_the_command_reports_a_good_bundle_and_ends_with_0():
    done = subprocess.run(
        [sys.executable, "-m", "wrenchbook.fea.check", "--json", str(SHIPPED / "plate_thin")],
        capture_output=True,
        text=True,
        check=False,
        timeout=600,
    )
    assert done.returncode == 0
    report = json.loads(done.stdout)
    assert report["ok"] is True
    assert report["unknowns"] == 3 * report["nodes"]
    assert list(report["cells"]) == ["hex20"]
    assert set(report["groups"]["facets"]) == {"patch", "corners", "rim", "top", "bottom"}


def test_the_command_reports_every_mistake_and_ends_with_1(tmp_path, capsys):
    text = (SHIPPED / "bar" / "component.toml").read_text()
    text = text.replace("210e9", "-210e9").replace('"distributed"', '"glued"')
    (tmp_path / "component.toml").write_text(text)
    assert main(["check", "--json", str(tmp_path)]) == 1
    report = json.loads(capsys.readouterr().out)
    assert report["ok"] is False
    assert [problem["where"] for problem in report["problems"]] == [
        "material[0].youngs_modulus",
        "interface.coupling",
    ]


def test_an_error_of_this_program_is_no_message_about_the_part(monkeypatch, tmp_path):
    def report(*_arguments):
        raise ValueError("a mistake in the code")

    monkeypatch.setattr("wrenchbook.fea.check.commands.report", report)
    with pytest.raises(ValueError, match="a mistake in the code"):
        main(["check", str(tmp_path)])


def test_reading_a_bundle_loads_neither_finite_elements_nor_mesh_readers(tmp_path):
    """One of a geometry neither: who has no gmsh reads it, and answers from its table."""
    program = "import wrenchbook.fea, sys; from wrenchbook.fea.bundle.read import read_bundle\n"
    program += "read_bundle(sys.argv[1]); print(*sys.modules)"
    text = (GOOD / "bracket" / "component.toml").read_text("utf-8")
    (tmp_path / "component.toml").write_text(text, "utf-8")
    (tmp_path / "bracket.step").touch()
    command = [sys.executable, "-c", program, str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=600)
    heavy = {"skfem", "meshio", "scipy", "gmsh"} | {
        f"wrenchbook.fea.{n}" for n in ("solve", "component")
    }
    assert not set(done.stdout.split()) & heavy


def test_a_missing_group_is_found_by_the_check(tmp_path):
    text = (SHIPPED / "bar" / "component.toml").read_text().replace('"start"', '"strat"')
    (tmp_path / "component.toml").write_text(text)
    (problem,) = check(tmp_path)["problems"]
    assert problem["where"] == "supports.fixed[0]"
    assert 'did you mean "start"' in problem["message"]


def test_a_table_only_bundle_is_fine_and_has_nothing_to_solve(tmp_path):
    text = 'name = "m"\ntitle = "M"\n[range]\nforce = [1,1,1]\nmoment = [1,1,1]\n'
    (tmp_path / "component.toml").write_text(text)
    report = check(tmp_path)
    assert report["ok"]
    assert not report["has_fea"]
    assert "unknowns" not in report


def test_the_program_takes_a_mass_that_rides_as_arguments(capsys):
    words = ["--mass", "2", "--inertia=1,1,2", "--centre=0,0,0.1", str(SHIPPED / "bar")]
    assert main(["check", "--json", *words]) == 0
    assert json.loads(capsys.readouterr().out)["vibration"]["riding_mass"] == 2.0
    assert main(["check", *words]) == 0
    assert "first natural frequency" in capsys.readouterr().out


def test_neither_density_nor_yield_strength_changes_the_fingerprint(tmp_path):
    text = (SHIPPED / "bar" / "component.toml").read_text("utf-8")
    (tmp_path / "component.toml").write_text(text.replace("7850.0", "1.0").replace("355e6", "1e6"))
    assert read_bundle(tmp_path).fingerprint == read_bundle(SHIPPED / "bar").fingerprint


def test_a_reader_that_stops_early_ends_the_command_without_a_traceback():
    """As ``| head -1``: nobody reads the pipe when the report is printed."""
    command = [sys.executable, "-m", "wrenchbook.fea.check.commands", "check", "--schema"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.close()
        assert process.stderr.read() == b""
    assert process.returncode == 0


def test_a_bundle_with_file_names_that_are_no_utf_8_is_checked(tmp_path, capsys):
    folder = Path(os.fsdecode(os.fsencode(tmp_path) + b"/tr\xe4ger"))
    folder.mkdir()
    (folder / os.fsdecode(b"m\xe4.msh")).touch()
    mesh = '[mesh]\nfile = "x.msh"\nunit = "mm"\n'
    (folder / "component.toml").write_text(f'name = "a"\ntitle = "A"\n{mesh}', "utf-8")
    assert main(["check", str(folder)]) == 1
    files = "component.toml, m\\udce4.msh"
    assert f'no file "x.msh" in the bundle, only {files}' in capsys.readouterr().out
