"""What the check says of mass and natural frequency."""

import json
import shutil

import pytest

from wrenchbook.fea.bundle.read import read_bundle
from wrenchbook.fea.bundle.shipped import SHIPPED
from wrenchbook.fea.check import report
from wrenchbook.fea.check.commands import main
from wrenchbook.fea.solver.vibration import Riding

WITH_DENSITY = "poisson_ratio = 0.3\ndensity = 7850.0\nyield_strength = 250e6\n"


@pytest.fixture
def bar(tmp_path):
    folder = tmp_path / "bar"
    shutil.copytree(SHIPPED / "bar", folder)
    return folder


def with_density(folder):
    path = folder / "component.toml"
    text = "\n".join(
        line
        for line in path.read_text("utf-8").splitlines()
        if not line.startswith(("density", "yield_strength"))
    )
    path.write_text(text.replace("poisson_ratio = 0.3\n", WITH_DENSITY), "utf-8")
    return folder


def test_neither_density_nor_yield_strength_changes_the_fingerprint(bar):
    before = read_bundle(bar).fingerprint
    bundle = read_bundle(with_density(bar))
    assert bundle.fingerprint == before
    assert (bundle.materials[0].density, bundle.materials[0].yield_strength) == (7850.0, 250e6)


def test_the_report_tells_mass_and_frequency(bar):
    told = report(with_density(bar), Riding.of(2.0))["vibration"]
    assert told["mass"] == pytest.approx(7850 * 0.02 * 0.02, rel=1e-9)
    beam = (3 * 210e9 * 0.02**4 / 12 / (2.0 + 33 / 140 * told["mass"])) ** 0.5
    assert told["first_frequency"] == pytest.approx(beam / 6.283185307, rel=5e-3)
    assert told["riding_mass"] == 2.0


def test_the_program_takes_the_mass_as_arguments(bar, capsys):
    words = ["check", "--json", "--mass", "2", "--inertia=1,1,2", "--centre=0,0,0.1"]
    assert main([*words, str(with_density(bar))]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["vibration"]["riding_mass"] == 2.0


def test_the_text_says_the_frequency(bar, capsys):
    assert main(["check", "--mass", "2", str(with_density(bar))]) == 0
    assert "first natural frequency" in capsys.readouterr().out


def test_a_mass_on_a_deck_is_said_to_count_for_nothing():
    warnings = report(SHIPPED / "plate_ccx", Riding.of(5.0))["warnings"]
    assert "no natural frequency: its solver gives none" in warnings[-1]["message"]


def test_a_bundle_without_density_tells_a_frequency_only_with_a_mass(bar):
    path = with_density(bar) / "component.toml"
    path.write_text(path.read_text("utf-8").replace("density = 7850.0\n", ""), "utf-8")
    assert report(bar)["vibration"] == {}
    told = report(bar, Riding.of(2.0))
    assert told["vibration"]["mass"] is None
    assert any("weightless" in one["message"] for one in told["warnings"])
