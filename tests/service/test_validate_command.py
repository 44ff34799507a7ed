"""``wrenchbook validate``: the suite in a process of its own, its status handed on."""

import subprocess
import sys

import pytest
import typer
from typer.testing import CliRunner

from wrenchbook.fea.bundle.shipped import SHIPPED
from wrenchbook.service.cli import local, main


def command(*words):
    return subprocess.run(
        [sys.executable, "-m", "wrenchbook.service.cli.main", "validate", *words],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


@pytest.mark.parametrize(("options", "told"), [((), "6 pass"), (("--markdown",), "| pass |")])
def test_a_topic_is_verified_and_printed(options, told):
    done = command("curved_beam", *options)
    assert done.returncode == 0, done.stderr
    assert told in done.stdout
    assert "MacNeal and Harder 1985" in done.stdout


def test_an_unknown_topic_is_refused_with_the_ones_there_are():
    done = command("shell")
    assert done.returncode == 2
    assert "curved_beam" in done.stderr


def test_a_component_is_found_by_name_in_the_data_directory_or_by_its_folder(tmp_path):
    own = tmp_path / "components" / "mine"
    own.mkdir(parents=True)
    (own / "component.toml").touch()
    assert local._bundle_named("mine", tmp_path) == own
    assert local._bundle_named("bar", tmp_path) == SHIPPED / "bar"
    assert local._bundle_named(str(own), tmp_path / "other") == own
    with pytest.raises(typer.BadParameter, match="neither a component"):
        local._bundle_named("nothing", tmp_path)


def test_wrenches_go_to_the_second_opinion_with_their_signs(monkeypatch):
    ran = []

    monkeypatch.setattr(local, "run_child", lambda *words: ran.extend(words) or 1)
    words = [
        "validate",
        "bar",
        "--with",
        "ccx",
        "--wrench",
        "-1,0,0,0,0,0",
        "--wrench",
        "2,0,0,0,0,0",
    ]
    assert CliRunner().invoke(main.app, words).exit_code == 1
    assert ran[-4:-1] == ["--wrench=-1,0,0,0,0,0", "--wrench=2,0,0,0,0,0", "--"]
    assert "wrenchbook.fea.validation.second_opinion" in ran


def test_a_wrench_without_a_second_solver_is_refused():
    done = CliRunner().invoke(main.app, ["validate", "bar", "--wrench", "1,0,0,0,0,0"])
    assert done.exit_code == 2
