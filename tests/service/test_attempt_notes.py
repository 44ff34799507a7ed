"""What an engineer should know about an answer goes with it into result.json."""

from importlib.metadata import version

from tests.service.test_runjob_evidence import attempt
from wrenchbook.service.files.program import code_digest


def test_the_warnings_of_the_check_reach_the_outcome_of_an_attempt(tmp_path):
    code, outcome, _ = attempt(tmp_path, [0, 0, 1e-3, 0, 0, 0], height=0.004)
    assert code == 0
    assert any("long and thin" in note for note in outcome.notes)


def test_an_attempt_without_warnings_has_no_notes(tmp_path):
    _, outcome, _ = attempt(tmp_path, [0, 0, 1e-3, 0, 0, 0])
    assert outcome.notes == []


def test_an_outcome_names_version_and_code_digest_of_its_solver(tmp_path):
    _, outcome, _ = attempt(tmp_path, [0, 0, 1e-3, 0, 0, 0])
    number, digest = outcome.program.split("+")
    assert number in (version("wrenchbook"), "unknown")
    assert digest == code_digest("fea", "service/jobs")[:12]
