import io
import json
import os
import re
import zipfile
from copy import deepcopy
from dataclasses import replace

import numpy as np
import pytest

from tests.until import until
from wrenchbook.fea.bundle.read import read_bundle
from wrenchbook.fea.failure import SolveFailed
from wrenchbook.fea.solve import Solver
from wrenchbook.service.library.component import component_of
from wrenchbook.service.library.library import SHIPPED
from wrenchbook.service.report.layout import (
    advice_of,
    as_markdown,
    as_page,
    sections_of,
    summary_of,
)
from wrenchbook.service.report.measure import errors, measure, pareto
from wrenchbook.service.report.queue import Reports
from wrenchbook.surrogate.table.rows import LoadRange, Rows


@pytest.fixture(scope="module")
def bar():
    shipped = read_bundle(SHIPPED / "bar")
    return replace(shipped, mesh=replace(shipped.mesh, cells_along=12))


@pytest.fixture(scope="module")
def report(bar):
    load_range = LoadRange(bar.range.low, bar.range.high)
    compliance = Solver(bar).compliance
    wrenches = np.vstack([np.zeros((1, 6)), np.diag(load_range.scale), -np.diag(load_range.scale)])
    rows = Rows.of(wrenches, wrenches @ compliance.T)
    figures = measure(bar, rows, load_range, 5, 3, lambda *_: None)
    return figures | {"summary": summary_of(figures), **advice_of(figures)}


def test_a_report_is_json_markdown_and_a_page_that_needs_nothing_from_elsewhere(report):
    assert json.loads(json.dumps(report))["component"] == "bar"
    for section in sections_of(report):
        # The table of methods named its outputs twice, so that coverage stood below `ux`.
        assert {len(line) for line in section.lines} <= {len(section.head)}
        assert "failed" not in section.note.lower()
    text = as_markdown(report)
    for word in ("griddata", "linear", "additive", "coarse", "own", "fine (reference)"):
        assert word in text
    page = as_page({**report, "title": "</script><b>"})
    assert page.startswith("<!doctype html>")
    assert "Error against run time" in page
    assert '<meta name="viewport" content="width=device-width, initial-scale=1">' in page
    assert len(page.encode()) < 1_500_000
    assert page.count("</script>") == 2
    assert "<script src=" not in page
    assert "<b>" not in page


def test_errors_of_a_report_have_units_and_no_powers_of_ten(report):
    figures = deepcopy(report)
    figures["tolerance"] = [3e-4, 1.234e-5, 5e-12, 1e-3, 2.0, 0.0]
    lines = [line for section in sections_of(figures) for line in section.lines]
    (tolerance,) = (line for line in lines if line[0] == "tolerance")
    assert tolerance[1:] == ("300 µm", "12.3 µm", "0 m", "1.00 mrad", "2.00 rad", "0 rad")
    assert not [cell for line in lines for cell in line if re.search(r"\de-\d", cell)]


@pytest.mark.parametrize(
    ("fraction", "text"),
    [(0.00999, "1 %"), (0.9949, "99 %"), (0.995, "100 %"), (0.9999, "100 %"), (1.234, "123 %")],
)
def test_a_percentage_of_a_report_has_no_power_of_ten(report, fraction, text):
    """0.995 was "1e+02 %"."""
    figures = deepcopy(report)
    figures["default"]["errors_left_out"] = {"kriging": fraction}
    assert sections_of(figures)[0].lines == (("kriging", text),)


def test_percentages_of_a_report_have_a_space(report):
    assert not re.search(r"\d%", as_markdown(report))


def test_meshes_and_tables_are_compared_with_the_finest_mesh(report):
    assert [level["level"] for level in report["fea"]] == ["coarse", "own", "fine"]
    assert report["fea"][-1]["error"]["rms"] == [0.0] * 6
    assert max(report["fea"][0]["error"]["rms_relative"]) > 0.0
    linear = next(e for e in report["tables"] if e["method"] == "linear" and e["rows"] == 13)
    assert max(linear["lookup_error"]["rms_relative"]) < 1e-9
    assert linear["query_us_p50"] > 0
    assert linear["largest_error"] == max(linear["error"]["rms_relative"])
    assert linear["largest_error"] == pytest.approx(report["mesh_error"], rel=1e-6)  # exact rows


def test_a_table_too_small_for_a_method_has_no_line_of_it(bar):
    load_range = LoadRange(bar.range.low, bar.range.high)
    wrenches = np.diag(load_range.scale)[:1]
    rows = Rows.of(wrenches, wrenches @ Solver(bar).compliance.T)
    bent = replace(bar, analysis=replace(bar.analysis, nonlinear=True))
    assert "kriging" not in {
        entry["method"]
        for entry in measure(bent, rows, load_range, 2, 3, lambda *_: None)["tables"]
    }


def test_the_times_of_a_report_are_processor_times(bar, monkeypatch):
    """Other work on the machine made the solves of a report look slow."""
    wall = iter(range(0, 10**9, 1000))
    monkeypatch.setattr("wrenchbook.service.report.measure.TIMED_SECONDS", 10**8)
    monkeypatch.setattr("wrenchbook.service.report.measure.time.perf_counter", lambda: next(wall))
    load_range = LoadRange(bar.range.low, bar.range.high)
    wrenches = np.diag(load_range.scale)
    rows = Rows.of(wrenches, wrenches @ Solver(bar).compliance.T)
    figures = measure(bar, rows, load_range, 2, 3, lambda *_: None)
    assert max(level["seconds_p95"] for level in figures["fea"]) < 1000
    assert max(entry["build_s"] for entry in figures["tables"]) < 1000


def test_a_report_says_which_solves_failed_and_why(bar, monkeypatch):
    """A mesh that is a mechanism left three rows of dashes, and no reason."""

    class Coarse(Solver):
        def solve(self, wrench):
            if self.unknowns < own:
                raise SolveFailed("mechanism", "The interface can move without any resistance.")
            return super().solve(wrench)

    own = Solver(bar).unknowns
    monkeypatch.setattr("wrenchbook.service.report.measure.Solver", Coarse)
    load_range = LoadRange(bar.range.low, bar.range.high)
    wrenches = np.diag(load_range.scale)
    rows = Rows.of(wrenches, wrenches @ Solver(bar).compliance.T)
    figures = measure(bar, rows, load_range, 3, 3, lambda *_: None)
    figures |= {"summary": summary_of(figures), **advice_of(figures)}
    reason = "On the coarse mesh 3 of 3 solves failed: 3 x mechanism (The interface can move"
    notes = {section.title: section.note for section in sections_of(figures)}
    assert reason in notes["Finite elements"]
    assert "Fix at least three points" in notes["Finite elements"]
    assert "own mesh" not in notes["Finite elements"]
    assert notes["Absolute errors against the tolerance"].endswith("see Finite elements.")
    assert reason in as_markdown(figures)
    assert reason in as_page(figures)


def test_the_advice_says_within_the_tolerance_of_the_interpolation_error_alone(report):
    figures = deepcopy(report)
    for table in figures["tables"]:
        table["largest_interpolation_error"] = 0.02
        table["lookup_error"]["p95"] = [1e-6] * 6
    figures["mesh_error"] = 0.01
    figures["tolerance"] = [1e-6] * 6  # the error of the mesh comes on top of it
    assert advice_of(figures)["advice"].endswith(
        "its mesh by 1 %; its interpolation error is within the tolerance: it needs no more rows."
    )


def test_the_advice_says_first_that_error_bars_were_too_small(report):
    figures = deepcopy(report)
    for table in figures["tables"]:
        table["beyond_error_bar"] = {"missed": 9, "of": 30}
        table["lookup_error"]["p95"] = [1e-6] * 6
    figures["mesh_error"], figures["tolerance"] = None, [1e-6] * 6
    assert advice_of(figures)["advice"].startswith(
        "The error bars of linear were too small for 9 of 30 answers"
    )
    assert "few wrenches were compared: 5" in advice_of(figures)["advice"]
    assert "needs no more rows" not in advice_of(figures)["advice"]


def test_error_bars_that_hold_exactly_nine_tenths_of_the_errors_are_accepted(report):
    """15 of 150 exceeded (1 - 0.9) * 150, which is 14.999999999999996."""
    figures = deepcopy(report)
    for table in figures["tables"]:
        table["beyond_error_bar"] = {"missed": 15, "of": 150}
    assert "too small" not in advice_of(figures)["advice"]


def test_the_advice_does_not_call_rows_useless_that_improve_the_error_bars(report):
    """One text said "fill the table further" and "more rows change nothing"."""
    figures = deepcopy(report)
    for table in figures["tables"]:
        table["beyond_error_bar"] = {"missed": 9, "of": 30}
        table["largest_interpolation_error"] = 0.001
    figures["mesh_error"] = 0.01
    assert "more rows lower no error, but improve the error bars" in advice_of(figures)["advice"]
    assert "change nothing" not in advice_of(figures)["advice"]


def test_the_covered_share_of_a_report_is_that_of_the_component_s_tolerance(bar):
    """The overview covered 100 %, and the report 50 %: it took 1 % of each output's range."""
    load_range = LoadRange(bar.range.low, bar.range.high)
    rng = np.random.default_rng(1)
    wrenches = rng.uniform(-1, 1, (20, 6)) * load_range.scale
    moved = wrenches @ Solver(bar).compliance.T
    noise = 0.05 * np.abs(moved).max(axis=0) * rng.normal(size=moved.shape)
    rows, shares = Rows.of(wrenches, moved + noise), []
    for size in (1e-9, 1.0):
        limited = replace(bar, tolerance=replace(bar.tolerance, translation=size, rotation=size))
        tables = measure(limited, rows, load_range, 3, 3, lambda *_: None)["tables"]
        whole = (entry for entry in tables if entry["rows"] == len(rows))
        shares.append(next(entry["covered"] for entry in whole if entry["method"] == "linear"))
    assert shares == [0.0, 1.0]


def test_the_advice_of_a_table_without_error_bars_is_more_rows(report):
    figures = deepcopy(report)
    for table in figures["tables"]:
        table["beyond_error_bar"] = {"missed": 0, "of": 0}
        table["lookup_error"]["p95"] = [1e-6] * 6
    figures["mesh_error"], figures["tolerance"] = None, [1e-6] * 6
    assert advice_of(figures)["advice"].endswith("for error bars fill the table further.")


@pytest.mark.parametrize(
    ("missed", "compared", "p95", "mesh", "result"),
    [
        (4, 30, 1e-7, None, (True, True)),
        (4, 30, 1e-7, 0.5, (True, True)),
        (1, 30, 1e-5, None, (False, True)),
        (1, 30, 1e-7, None, (False, False)),
        (1, 30, 1e-5, 0.5, (False, False)),
        (0, 0, 1e-7, None, (False, True)),
    ],
)
def test_a_report_says_whether_bars_are_too_small_and_rows_help(
    report, missed, compared, p95, mesh, result
):
    figures = deepcopy(report)
    for table in figures["tables"]:
        table["beyond_error_bar"] = {"missed": missed, "of": compared}
        table["lookup_error"]["p95"] = [p95] * 6
        table["largest_interpolation_error"] = 0.01
    figures["mesh_error"], figures["tolerance"] = mesh, [1e-6] * 6
    advice = advice_of(figures)
    assert (advice["bars_too_small"], advice["needs_rows"]) == result
    words = "More rows help", "fill the table further"
    assert any(word in advice["advice"] for word in words) == advice["needs_rows"]


def test_the_advice_has_the_error_that_the_plots_show(report):
    figures = deepcopy(report)
    for table in figures["tables"]:
        table["largest_error"], table["largest_interpolation_error"] = 0.0043, 0.0054
    assert "errs by 0.43 % of the range against the finest mesh" in advice_of(figures)["advice"]


def test_errors_are_rms_quantile_and_largest():
    result = errors(np.array([[1.0] * 6, [2.0] * 6, [np.nan] * 6]), np.full(6, 10.0))
    assert result["rms"] == pytest.approx([2.5**0.5] * 6)
    assert result["max"] == [2.0] * 6
    assert result["rms_relative"] == pytest.approx([0.25**0.5 * 10**0.5 / 10] * 6, rel=1e-12)


def test_the_pareto_front_leaves_out_what_is_slower_and_worse():
    entries = [("a", 1.0, 0.5), ("b", 2.0, 0.6), ("c", 3.0, 0.1), ("d", 4.0, None)]
    fields = "name", "seconds", "largest_error"
    assert pareto([dict(zip(fields, entry, strict=True)) for entry in entries]) == ["a", "c"]


def add_beam(http):
    """Upload the shipped bar with fewer cells."""
    text = (SHIPPED / "bar" / "component.toml").read_text().replace('"bar"', '"beam"', 1)
    content, buffer = text.replace("cells_along = 40", "cells_along = 8"), io.BytesIO()
    assert content != text
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr("component.toml", content)
    reply = http.post("/v1/components", files={"bundle": ("beam.zip", buffer.getvalue())})
    assert reply.status_code == 201, reply.text


def test_a_report_is_made_over_http(http, monkeypatch):
    monkeypatch.delenv("WRENCHBOOK_SOLVE")
    add_beam(http)
    call = "/v1/components/beam/report"
    assert http.post(call).status_code == 409
    assert http.get(call).status_code == 404
    solve = {"force": [1, 2, 3], "moment": [0, 0, 0], "wait_s": 60}
    assert http.post("/v1/components/beam/solve", json=solve).status_code == 200
    first = http.post(call, params={"wrenches": 3})
    assert first.status_code == 202, "right after a solve it said that there are no rows"
    until(lambda: http.get(call, params={"format": "state"}).json()["state"] != "running")
    body = http.get(call)
    assert body.status_code == 200, body.text
    assert body.json()["wrenches"]["compared"] == 3
    assert "text/html" in http.get(call, params={"format": "html"}).headers["content-type"]


def test_a_cancelled_report_is_not_a_failed_one(http, monkeypatch):
    monkeypatch.delenv("WRENCHBOOK_SOLVE")
    call = "/v1/components/plate_thin/report"
    solve = {"force": [0, 0, -900], "moment": [0, 0, 0], "wait_s": 60}
    assert http.post("/v1/components/plate_thin/solve", json=solve).status_code == 200
    assert http.post(call, params={"wrenches": 1000}).status_code == 202
    state = http.get(call, params={"format": "state"}).json()
    assert (state["state"], state["wrenches"]) == ("running", 1000)
    assert http.delete(call).json()["state"] == "none"
    assert http.delete(call).status_code == 200  # none is made


def test_a_report_whose_process_was_killed_has_failed_though_an_earlier_one_is_there(
    tmp_path, bar, monkeypatch
):
    """It was `done`, with the report before the one that was ordered."""
    reports = Reports(tmp_path, tmp_path)

    def make(command):
        child = ["sh", "-c", command]
        monkeypatch.setattr("wrenchbook.service.report.queue.child_command", lambda *_: child)
        reports.make(component_of(bar, shipped=True), 1, 3, 1)
        return until(lambda: (state := reports.state("bar")).state != "running" and state)

    assert make("kill -9 $$").state == "failed"
    assert make(f"echo {{}} > {tmp_path}/bar/report.json").state == "done"
    os.utime(tmp_path / "bar/report.json", (0, 0))  # the next order is newer by any clock
    killed = make("kill -9 $$")
    assert killed.state == "failed"
    assert "make the report again" in killed.message
