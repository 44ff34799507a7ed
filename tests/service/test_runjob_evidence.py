"""What a failed attempt of the embedded solver leaves in its folder, and what its log tells."""

import json
from dataclasses import replace
from importlib.metadata import version

import meshio
import pytest

from wrenchbook.fea.bundle.read import read_bundle
from wrenchbook.service.files.program import code_digest
from wrenchbook.service.jobs import solver as runjob
from wrenchbook.service.jobs.attempt import Attempt, prepare, read_outcome

BUNDLE = """
name = "block"
title = "Block"
[mesh]
generator = "bar"
length = 1.0
width = 0.1
height = {height}
cells_along = 4
cells_across = {across}
[[material]]
region = "all"
youngs_modulus = 1e9
poisson_ratio = {poisson}
[supports]
fixed = ["start"]
[interface]
section = "end"
coupling = "rigid"
[analysis]
nonlinear = true
[range]
force = [1, 1, 1]
moment = [1, 1, 1]
"""


def attempt(folder, wrench, **changes):
    options = {"height": 0.1, "across": 2, "poisson": 0.3, **changes}
    bundle = folder / "block"
    bundle.mkdir()
    (bundle / "component.toml").write_text(BUNDLE.format(**options), encoding="utf-8")
    spec = Attempt(1, 1, "block", str(bundle), read_bundle(bundle).fingerprint, wrench)
    prepare(replace(spec, folder=folder / "1" / "1"))
    code = runjob.run_attempt(folder / "1" / "1")
    return code, read_outcome(replace(spec, folder=folder / "1" / "1")), folder / "1" / "1"


def test_a_part_that_buckles_leaves_its_history_and_last_state(tmp_path):
    code, outcome, folder = attempt(tmp_path, (-1e6, 0.0, 0.0, 0.0, 0.0, 0.0))
    assert code == runjob.FAILED
    assert outcome.error["kind"] == "snap_through"
    assert "of this wrench" in outcome.error["message"]
    record = json.loads((folder / "history.json").read_text(encoding="utf-8"))
    assert 0 < record["last_load_factor"] <= record["critical_load_factor"] < 1
    assert record["iterations"]
    assert meshio.read(folder / "last_state.vtu").point_data["displacement"][:, 0].min() < -1e-3
    assert {"spec.json", "result.json"} < {path.name for path in folder.iterdir()}


def test_a_locking_material_is_refused_by_name(tmp_path):
    code, outcome, folder = attempt(tmp_path, (1.0, 0, 0, 0, 0, 0), poisson=0.4999)
    assert code == runjob.FAILED
    assert outcome.error["kind"] == "locking_material"
    assert "hex27" in outcome.error["remedy"]
    assert (folder / "last_state.vtu").exists()


@pytest.mark.parametrize(("height", "told"), [(0.1, False), (1e-3, True)])
def test_what_an_engineer_should_know_is_in_the_log(tmp_path, capsys, height, told):
    code, _, folder = attempt(tmp_path, (0, 0, 1e-9, 0, 0, 0), height=height)
    assert code == runjob.DONE
    assert ("scaled condition" in capsys.readouterr().out) is told
    assert not (folder / "history.json").exists()


def test_the_warnings_of_the_check_reach_the_outcome_of_an_attempt(tmp_path):
    code, outcome, _ = attempt(tmp_path, [0, 0, 1e-3, 0, 0, 0], height=0.004)
    assert code == 0
    assert any("long and thin" in note for note in outcome.notes)


def test_an_outcome_names_version_and_code_digest_of_its_solver(tmp_path):
    _, outcome, _ = attempt(tmp_path, [0, 0, 1e-3, 0, 0, 0])
    assert outcome.notes == []
    number, digest = outcome.program.split("+")
    assert number in (version("wrenchbook"), "unknown")
    assert digest == code_digest("fea", "service/jobs")[:12]
