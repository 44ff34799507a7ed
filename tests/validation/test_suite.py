"""The verification suite: what it measures, how it tells, and the page that holds its table."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from tests.validation import __main__ as validate
from tests.validation import calculix, plate, spring, supports
from tests.validation.clamped import shipped
from tests.validation.finding import CASES, TOPICS, Case, Finding, case
from tests.validation.spring import PRINTED_14, rod_of

PAGE = Path(__file__).parents[2] / "data/docs/reference/validation.md"
REFERENCE = (
    (0.5, 0.114644, 0.121148, 0.29113),
    (1, 0.231012, 0.244179, 0.581903),
    (2, 0.468932, 0.495875, 1.162387),
    (4, 0.965555, 1.021714, 2.319152),
    (6, 1.49, 1.577319, 3.470404),
    (8, 2.042393, 2.1625, 4.616252),
    (10, 2.622861, 2.777071, 5.756801),
    (12, 3.231529, 3.420856, 6.892155),
    (14, 3.868521, 4.093685, 8.022419),
    (16, 4.533959, 4.795395, 9.147694),
    (17, 4.877383, 5.157032, 9.708492),
)
"""Shortening (mm), turn by equation 14 as printed and by rod theory (degrees), force (N).

Computed apart from this project, from the formulas that `tests/validation.spring` names.
"""


def told(topic, capsys):
    status = validate.main([topic, "--json"])
    return status, json.loads(capsys.readouterr().out)


@pytest.mark.parametrize("topic", ["patch", "bar", "curved_beam", "vibration"])
def test_every_finding_of_a_topic_is_within_its_tolerance(topic, capsys):
    status, rows = told(topic, capsys)
    assert status == 0
    assert {row["verdict"] for row in rows} == {"pass"}
    assert {row["topic"] for row in rows} == {topic}
    for row in rows:
        assert row["error"] <= row["tolerance"] < 0.5
        assert row["source"]


def test_every_topic_has_cases_each_with_a_title_of_its_own():
    assert {item.topic for item in CASES} == set(TOPICS)
    titles = [item.title for item in CASES]
    assert len(set(titles)) == len(titles)
    assert all(titles)


@pytest.mark.parametrize(
    "check",
    [
        plate.annular_plate,
        spring.small_load,
        spring.pressed,
        supports.sliding_stretch,
        supports.bushing_adds,
    ],
)
def test_a_case_that_needs_no_calculix_passes(check):
    findings = list(check())
    verdicts = [finding.verdict for finding in findings]
    assert "pass" in verdicts
    assert "FAIL" not in verdicts, findings


@pytest.mark.parametrize(
    ("comparison", "computed", "error"),
    [("relative", 11.0, 0.1), ("absolute", 11.0, 1.0), ("at least", 9.0, 1.0), ("at least", 12, 0)],
)
def test_an_error_is_measured_as_the_comparison_says(comparison, computed, error):
    finding = Finding("q", "s", 10.0, computed, error + 1e-9, comparison)
    assert finding.error == pytest.approx(error)
    assert finding.verdict == "pass"


@pytest.mark.parametrize("computed", [10.2, float("nan"), float("inf")])
def test_one_finding_beyond_its_tolerance_fails_the_run(computed, monkeypatch, capsys):
    def wrong():
        """A case that is wrong."""
        yield Finding("fine", "s", 10.0, 10.0, 1e-2)
        yield Finding("wrong", "s", 10.0, computed, 1e-2)
        yield Finding("for the record", "s", 10.0, 12.0)

    monkeypatch.setattr(validate, "CASES", [Case("bar", "A case that is wrong", wrong)])
    assert validate.main(["bar"]) == 1
    printed = capsys.readouterr().out
    assert "1 pass, 1 FAIL, 1 reported" in printed
    status, rows = told("all", capsys)
    assert (status, [row["verdict"] for row in rows]) == (1, ["pass", "FAIL", "reported"])


def test_without_calculix_its_lines_say_so_and_nothing_fails(monkeypatch, capsys):
    monkeypatch.setattr(shutil, "which", lambda name: None)
    monkeypatch.setattr(validate, "CASES", [c for c in CASES if c.check is plate.calculix])
    assert validate.main(["plate"]) == 0
    printed = capsys.readouterr().out
    assert printed.count("not run: ccx is not installed") == 3
    _, rows = told("plate", capsys)
    assert {row["computed"] for row in rows} == {None}


def test_a_calculix_that_gives_no_answer_is_an_error(monkeypatch):
    monkeypatch.setattr(calculix, "PROGRAM", "true")
    part = shipped("spring", cells_per_turn=6)
    with pytest.raises(RuntimeError, match="without an answer"):
        calculix.solve_rigid(part, [0, 0, -1, 0, 0, 0])


def test_the_page_holds_the_cases_that_there_are_and_no_other():
    page = PAGE.read_text(encoding="utf-8")
    table = page.split(validate.BEGIN)[1].split(validate.END)[0]
    titles = [line.strip("*") for line in table.splitlines() if line.startswith("**")]
    assert titles == [item.title for item in validate.ordered()], "run: make validate-table"
    assert "FAIL" not in table
    assert "not run" not in table


def test_the_headline_names_the_error_nearest_to_its_tolerance():
    near = Finding("near", "", 1.0, 1.01, 0.02)
    results = [(CASES[0], one) for one in (Finding("far", "", 1.0, 1.01, 0.1), near)]
    assert validate.headline(results, 7.2) == (
        "2 quantities: 2 pass. The largest error is 50% of its tolerance (near). The run took 7 s "
        "of processor time."
    )


def test_a_pages_table_is_replaced_between_its_markers_and_the_rest_is_kept():
    page = f"# Title\n\n{validate.BEGIN}\nold\n{validate.END}\n\nThe end.\n"
    new = validate.replace_table(page, "new")
    assert new == f"# Title\n\n{validate.BEGIN}\n\nnew\n\n{validate.END}\n\nThe end.\n"
    with pytest.raises(ValueError, match="not both markers"):
        validate.replace_table("# Title", "new")


def test_a_case_of_no_topic_is_refused():
    with pytest.raises(ValueError, match="no topic 'shell'"):
        case("shell")


def test_the_rod_and_the_printed_formula_are_those_of_the_reference():
    rod = rod_of(shipped("spring"))
    for row, millimetres, printed in zip(REFERENCE, *PRINTED_14, strict=True):
        shortening, printed_turn, rod_turn, rod_force = row
        assert (shortening, printed_turn) == (millimetres, printed)
        force, turn = rod.pressed(shortening * 1e-3)
        assert force == pytest.approx(rod_force, abs=1e-6)
        assert np.degrees(turn) == pytest.approx(rod_turn, abs=1e-6)
