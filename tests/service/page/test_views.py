"""Views of the page, each test named after what a visitor saw of it."""

import json
import re
import shutil
import zipfile
from functools import partial
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from selenium.webdriver import ActionChains
from selenium.webdriver.common.keys import Keys

from tests.service.page.test_browser import LOADS, PLATE, add, ask, bundle
from tests.service.test_import_findings import logs_of
from tests.slow import slow, slow_but
from tests.surrogate.findings.rigs import Rig
from tests.until import until
from wrenchbook.fea.check import reporting
from wrenchbook.fea.check.commands import main as check
from wrenchbook.service.client.errors import ProblemError

LIMIT_S = 1200
pytestmark = pytest.mark.browser
ROOT = Path(__file__).parents[3]
LOADED = [0, 0, -900.0], [0, 0, 900.0], [500.0, 0, 0]
REPORTED = "#/c/coarse_plate"
REPORT = "/v1/components/coarse_plate/report"
COLUMNS = [
    *((name, "N") for name in ("fx", "fy", "fz")),
    *((name, "N*m") for name in ("mx", "my", "mz")),
    *((name, "m") for name in ("ux", "uy", "uz")),
    *((name, "rad") for name in ("rx", "ry", "rz")),
]


@pytest.fixture(scope="module")
def strut(client):
    """A measured component with one load and one output: Fz and uz."""
    spans = {"force": [0, 0, 300], "moment": [0, 0, 0]}
    about = {"name": "pull_strut", "title": "Strut", "range": spans}
    client.call_json("POST", "/v1/components", about)
    noise = np.random.default_rng(1).normal(0, 5e-4, 61)
    lines = [f"{x},{x * 1e-3 + e}" for x, e in zip(range(-300, 301, 10), noise, strict=True)]
    text = "\n".join(["Fz [N],uz [mm]", *lines])
    path = "/v1/components/pull_strut/table?missing_loads=zero"
    client.call("POST", path, content=text.encode(), headers={"Content-Type": "text/csv"})
    client.component("pull_strut", wait_s=60)
    return client


@pytest.fixture(scope="module")
def plate(client):
    """`plate_thin` with a few rows."""
    for force in LOADED:
        client.solve("plate_thin", force, [0, 0, 0], wait_s=120)
    client.component("plate_thin", wait_s=60)  # until the table has the rows
    return client


@pytest.fixture(scope="module")
def rig(client):
    """A component for measured rows, without any."""
    spans = {"force": [600] * 3, "moment": [60] * 3}
    about = {"name": "unmeasured", "title": "A rig without rows", "range": spans}
    client.call_json("POST", "/v1/components", about)
    return client


def begun(client):
    """Begin a report, and return whether the table's file is there for it."""
    try:
        return client.call("POST", f"{REPORT}?wrenches=3")
    except ProblemError:  # 409: no rows yet
        return None


@pytest.fixture(scope="module")
def reported(client, tmp_path_factory):
    """A plate of few cells, each solve a tenth of `plate_thin`'s, whose report is made."""
    folder = tmp_path_factory.mktemp("bundle") / "coarse_plate"
    file = shutil.copytree(ROOT / "data/components/plate_thin", folder) / "component.toml"
    text = file.read_text().replace("plate_thin", "coarse_plate")
    for key, value in {"cells": 4, "rings": 2, "corner_cells": 1}.items():
        text = re.sub(f"(?m)^{key} = .*$", f"{key} = {value}", text)
    file.write_text(text)
    client.add_component(folder)
    for force in LOADED:
        client.solve("coarse_plate", force, [0, 0, 0], wait_s=120)
    until(lambda: begun(client))
    # Solves of a busy machine have no other limit than the test's own.
    until(lambda: client.call_json("GET", f"{REPORT}?format=state")["state"] != "running", LIMIT_S)
    assert client.call_json("GET", f"{REPORT}?format=state")["state"] == "done"
    return client


def test_tables_and_meshes_of_a_report_are_drawn_against_one_reference(browser, reported):
    told = reported.call_json("GET", REPORT)
    browser.visit(f"{REPORTED}/report")
    browser.named("strong", told["advice"])
    browser.one("#plot-front[data-drawn]")
    assert "all errors against the finest mesh" in browser.text("p", "random full wrenches")
    assert "mesh error: more rows approach it" in browser.text("#plot-front svg")
    named = browser.run("return document.querySelector('#plot-front path title').textContent")
    entry = next(e for e in told["tables"] if named.startswith(f"{e['method']}, {e['rows']} rows"))
    share = float(f"{100 * max(entry['error']['rms_relative']):.2g}")
    assert f": {share:g} %" in named
    assert browser.mistakes() == []


def test_the_90_and_95_percent_lines_of_a_report_have_names(browser, reported):
    browser.visit(f"{REPORTED}/report")
    browser.one("#plot-calibration[data-drawn]")
    told = browser.text("#plot-calibration svg")
    assert "95 % (nominal)" in told
    assert "90 % (accepted)" in told


def test_no_two_methods_of_a_report_have_two_browns(browser, reported):
    browser.visit(f"{REPORTED}/report")
    browser.one("#plot-calibration[data-drawn]")
    marks = browser.run(
        "return [...document.querySelectorAll('#plot-calibration .key-of-marks path')]"
        ".map((one) => getComputedStyle(one).fill)"
    )
    colours = np.array([re.findall(r"\d+", mark) for mark in marks], dtype=float)
    apart = np.abs(colours[:, None] - colours[None]).max(axis=2) + 255 * np.eye(len(colours))
    assert apart.min() > 60


def test_a_report_saved_as_html_draws_its_plots_without_a_server(browser, reported, tmp_path):
    file = tmp_path / "report.html"
    file.write_bytes(reported.call("GET", f"{REPORT}?format=html").content)
    browser.resize(390, 800)
    browser.driver.get(file.as_uri())
    browser.until(lambda: len(browser.all("[data-drawn]")) == 3)
    assert browser.run("return document.documentElement.scrollWidth") <= 390
    assert browser.mistakes() == []


def test_the_old_report_stays_while_a_new_one_is_made_which_can_be_cancelled(browser, reported):
    browser.visit(f"{REPORTED}/report")
    before = browser.one("#plot-front[data-drawn]")
    browser.type("input[type=number]", "1000")
    browser.click("button", "Make the report")
    browser.one("#cancel-report")
    assert before.is_displayed()
    browser.click("#cancel-report")
    browser.until(lambda: not browser.all("#cancel-report"), "the end of the report")
    assert browser.one("#plot-front[data-drawn]")
    assert reported.call_json("GET", f"{REPORT}?format=state")["state"] == "done"


def test_a_report_that_cannot_be_cancelled_says_so_and_can_be_cancelled_again(browser, plate):
    """The button stayed disabled, and no notice said why."""
    browser.visit("#/terms")
    browser.one("h1")
    running = {"state": "running", "fraction": 0.1, "message": "solving"}
    browser.run(STUB, json.dumps([["format=state", running]]))
    browser.run(REFUSED, "DELETE")
    browser.go(f"{PLATE}/report")
    browser.click("#cancel-report")
    browser.named("#notices", "The server is busy.")
    browser.until(lambda: browser.one("#cancel-report").is_enabled())


def test_a_report_that_cannot_be_saved_says_so(browser, reported):
    browser.visit(f"{REPORTED}/report")
    browser.one("#plot-front[data-drawn]")
    browser.run(REFUSED, "GET")
    browser.click("button", "Save MD")
    browser.named("#notices", "The server is busy.")


def test_cards_show_the_part_and_an_error_bar_with_its_discretisation_error(browser, plate):
    browser.visit("#/")
    card = browser.named(".card.library", "plate_thin")
    browser.until(lambda: card.find_elements("css selector", "canvas.part:not([hidden])"))
    seen = (
        "return arguments[0].querySelector('canvas').getContext('2d').getImageData(160, 75, 1, 1)"
    )
    assert browser.run(f"{seen}.data[3]", card) > 0
    browser.until(lambda: "within tolerance" in card.text, "the coverage of the table")


def card_of(browser, name):
    """The card of a component whose picture is drawn, and the label of the picture."""
    browser.visit("#/")
    card = browser.named(".card.library", name)
    browser.until(lambda: card.find_elements("css selector", "canvas.part:not([hidden])"))
    return card, card.find_element("css selector", "canvas").get_attribute("aria-label")


def test_a_card_shows_the_part_before_anything_was_asked_or_solved(browser, client):
    card, label = card_of(browser, "spring")
    assert client.component("spring")["rows"] == 0
    assert client.call_json("GET", "/v1/jobs?component=spring")["jobs"] == []
    assert label == "The part spring"
    browser.until(lambda: "empty table" in card.text, "the coverage of the table")


def test_the_card_of_a_table_without_a_mesh_has_a_symbol(browser, rig):
    card, label = card_of(browser, "unmeasured")
    assert label == "unmeasured: a table without a mesh"
    drawn = "getContext('2d').getImageData(0, 0, 320, 150).data.some((one) => one > 0)"
    assert browser.run(f"return arguments[0].querySelector('canvas').{drawn}", card)
    assert browser.mistakes() == []


def test_a_click_on_a_face_gives_the_lines_that_select_it(browser, client):
    browser.visit(f"{PLATE}/faces")
    browser.drawn("#faces")
    place = browser.one("#faces")
    assert "NAME = {plane" in browser.text("pre")

    def pressed():  # again: the drawing finds the face under the mouse a frame later
        mouse = ActionChains(browser.driver).move_to_element(place).move_by_offset(1, 1)
        mouse.click().move_by_offset(-1, -1).perform()
        return 'NAME = {plane = "z", at = 0.004}' in browser.text("pre")

    browser.until(pressed, "the lines of the upper face")
    browser.run("document.querySelector('#face').selectedIndex = 1")
    browser.run("document.querySelector('#face').dispatchEvent(new Event('change'))")
    browser.type("#faces-name", "held")
    assert "held = {plane" in browser.text("pre")
    assert browser.mistakes() == []


def test_a_new_visitor_is_led_through_three_steps_by_keyboard_once(browser, plate):
    browser.run("localStorage.clear()")
    browser.visit("#/")
    browser.named("dialog.tour h2", "New here?")
    for step in ("1 of 3: Ask", "2 of 3: See where", "3 of 3: Fill"):
        browser.press(Keys.ENTER)
        browser.named("dialog.tour h2", step)
        browser.one(".pointed")
    browser.press(Keys.ESCAPE)
    browser.until(lambda: not browser.all("dialog.tour, .pointed"), "the end of the tour")
    browser.visit("#/")
    browser.one(".card.library")
    assert not browser.all("dialog.tour")


def test_the_band_of_a_response_is_split_by_cause(browser, plate):
    browser.visit(f"{PLATE}/response")
    browser.drawn("#response")
    assert "interpolation error" in browser.text(".key-of-marks")
    assert "discretisation error" in browser.text(".key-of-marks")
    bands = browser.run(
        "return document.querySelector('#response').data.filter((one) => one.fill).length"
    )
    assert bands == 2


def test_the_last_cell_of_a_long_bad_line_is_seen(browser, rig):
    row = ",".join(["0.123456789012"] * 11 + ["minus 0.2"])
    header = f"{LOADS},ux [mm],uy [mm],uz [mm],rx [deg],ry [deg],rz [deg]"
    browser.resize(390, 800)
    browser.visit("#/c/unmeasured/table")
    browser.drop(".drop", "bad.csv", f"{header}\n{row}\n")
    line = browser.one("[aria-label='Line 2']")
    assert line.get_attribute("value") == row
    for size in ("Width", "Height"):
        hidden = f"return arguments[0].scroll{size} - arguments[0].client{size}"
        assert browser.run(hidden, line) <= 0


def test_a_mistake_of_six_columns_is_one_sentence(browser, rig):
    browser.visit("#/c/unmeasured/table")
    browser.drop(".drop", "bare.csv", "a,b,c,d,e,g\n1,2,3,4,5,6\n")
    told = browser.text("#mistakes")
    assert told.count("are not known columns") == 1
    assert "a, b, c, d, e, g" in told


def test_a_call_that_takes_long_shows_that_it_works(browser, plate):
    browser.visit(f"{PLATE}/query")
    browser.one("input[name=fx]")
    browser.run("window.fetch = () => new Promise((done) => { window.answer = done; })")
    ask(browser, fz=-900)
    bar = "return getComputedStyle(document.querySelector('.top'), '::after')"
    browser.until(lambda: browser.run(f"{bar}.opacity") == "1", "the bar")
    browser.run("window.answer(new Response('{}', {status: 500}))")
    browser.until(lambda: browser.run(f"{bar}.content") == "none", "the end of the bar")


def test_the_colour_bar_does_not_lie_over_the_part_on_a_telephone(browser, plate):
    browser.resize(390, 800)
    browser.visit(f"{PLATE}/shape")
    browser.drawn("#shape")
    bar, scene = browser.run(
        "const full = document.querySelector('#shape')._fullLayout;"
        "return [document.querySelector('#shape')._fullData[0].colorbar, full.scene.domain]"
    )
    assert (bar["orientation"], bar["y"], bar["yanchor"]) == ("h", 0, "bottom")
    assert scene["y"][0] >= 0.2


def job(number, status, **more):
    """Return a job as the server lists it."""
    about = {"id": number, "status": status, "component": "plate_thin", "attempt": 1}
    loads = {"force": [0, 0, float(number)], "moment": [0, 0, 0]}
    return {**about, **loads, "seconds": None, "started": None, "error": None, **more}


def test_jobs_that_run_are_above_waiting_ones_in_the_order_of_their_start(browser, plate):
    done = job(1, "done", seconds=600.0)
    running = job(2, "running", started="SOON", progress={"fraction": 0.5, "message": "step 3"})
    waiting = [job(number, "waiting") for number in (4, 3)]
    single = {**waiting[0], "waiting": {"ahead": 1, "expected_s": 540.0, "solve_s": 600.0}}
    lists = {
        "status=running": {"jobs": [running], "next": None},
        "status=done": {"jobs": [done], "next": None},
        "status=waiting": {"jobs": waiting, "next": None},
        "jobs/4": single,
        "jobs?": {"jobs": [*waiting, running, done], "next": None},
    }
    browser.visit("#/")
    browser.named(".card.library", "plate_thin")
    browser.run(
        "const lists = JSON.parse(arguments[0].replaceAll('SOON', new Date().toISOString()));"
        "const own = window.fetch; window.fetch = (to, how) => {"
        " const key = Object.keys(lists).find((one) => String(to).includes(one));"
        " return key ? Promise.resolve(new Response(JSON.stringify(lists[key]))) : own(to, how); }",
        json.dumps(lists),
    )
    browser.go("#/jobs")
    browser.one("#job-4")
    shown = [item.get_attribute("id") for item in browser.all("tr[id]")]
    assert shown == ["job-2", "job-3", "job-4", "job-1"]
    browser.named("#job-2", "about 10 min left")
    assert browser.text("#queue", "waiting") == "2 waiting; all are solved in about 19 min."


@pytest.mark.parametrize(("address", "place"), [("#/jobs", "#job-2"), ("#/jobs/2", ".head")])
def test_a_job_that_ended_before_the_page_listened_is_shown_as_done(browser, plate, address, place):
    """Its last event was over, and it stood as running for as long as the page was open."""
    jobs = [job(2, "running", created="2026-01-01T00:00:00Z"), job(2, "done", seconds=3.0)]
    browser.visit("#/terms")
    browser.one("h1")
    browser.run(
        "const jobs = JSON.parse(arguments[0]), own = window.fetch; let ended = false;"
        "window.fetch = async (to, how) => { const text = String(to), now = jobs[Number(ended)];"
        " if (text.includes('v1/events')) ended = true;"
        " if (!text.includes('v1/jobs')) return own(to, how);"
        " const page = text.includes('status=') && !text.includes(now.status) ? [] : [now];"
        " const reply = text.includes('jobs/2') ? now : {jobs: page, next: null};"
        " return new Response(JSON.stringify(reply)); };",
        json.dumps(jobs),
    )
    browser.go(address)
    browser.until(lambda: "done" in browser.text(place))


@pytest.mark.parametrize("view", ["overview", "rows", "coverage", "response", "checks"])
def test_an_empty_view_has_the_button_that_ends_it(browser, rig, view):
    browser.visit(f"#/c/unmeasured/{view}")
    link = browser.one("main a[href='#/c/unmeasured/table']:not(.tabs a)")
    assert "Import" in link.text


def test_a_measured_component_has_no_tabs_of_solves(browser, rig):
    seen = set()
    for view in ("query", "rows", "demand", "settings"):
        browser.visit(f"#/c/unmeasured/{view}")
        seen |= set(browser.text(".tabs").split("\n"))
    assert not {"Shape", "Report", "Jobs", "Faces"} & seen
    assert {"Query", "Checks", "Demand", "Settings"} <= seen


def test_a_component_has_at_most_six_groups_and_the_views_of_the_chosen_one(browser, client):
    browser.visit(f"{PLATE}/checks")
    browser.one(".views")
    groups, views = (
        [item.text for item in browser.all(f".tabs > {row} a")]
        for row in ("div:first-child", ".views")
    )
    assert groups == ["Overview", "Query", "Table", "Import & export", "Jobs & demand", "Part"]
    assert views == ["Rows", "Coverage", "Checks", "Compare", "Report"]


def test_the_faces_of_a_deck_are_those_of_its_mesh(browser, client):
    browser.visit("#/c/plate_ccx/faces")
    browser.drawn("#faces")
    assert "mesh in the deck" in browser.text("main")
    assert len(browser.all("#face option")) == 6
    assert browser.mistakes() == []


def test_a_click_on_the_page_of_check_gives_the_lines_of_the_face(browser, tmp_path, monkeypatch):
    monkeypatch.setattr(reporting, "_MAX_SECONDS", 0.0)  # no estimate, which takes 8 s
    folder, page = ROOT / "data/components/plate_thin", tmp_path / "faces.html"
    check(["check", str(folder), "--plot", str(page), "--json"])
    browser.driver.get(page.as_uri())
    place = browser.one(".plotly-graph-div")

    def pressed():
        mouse = ActionChains(browser.driver).move_to_element(place).move_by_offset(1, 1)
        mouse.click().move_by_offset(-1, -1).perform()
        return "NAME = {plane" in browser.text("pre")

    browser.until(pressed, "the lines of a face")


def test_the_audit_offers_each_action_that_the_service_writes(browser, client):
    browser.visit("#/audit")
    browser.one("select[name=action]")
    offered = {item.get_attribute("value") for item in browser.all("select option")}
    source = "".join(file.read_text("utf-8") for file in (ROOT / "service").rglob("*.py"))
    written = set(re.findall(r'(?:note|noted|_by_caller)\([^"()]*"([a-z]+\.[a-z]+)"', source))
    events = re.findall(r'_by_caller\([^"]*"([a-z]+)"', source)
    assert len(written) > 10
    assert written | {f"job.{event}" for event in events} <= offered
    browser.click("option[value='key.*']")  # no key was made
    browser.until(lambda: not browser.all("tbody tr"), "the entries of keys")


def test_two_logs_are_joined_and_the_lag_of_their_clocks_is_one_click(browser, client, tmp_path):
    rig = Rig(5206, ("motion",))
    span = {"force": rig.high[:3].tolist(), "moment": rig.high[3:].tolist()}
    client.call_json("POST", "/v1/components", {"name": "logs", "title": "Logs", "range": span})
    for name, text in logs_of(rig).values():
        (tmp_path / name).write_bytes(text)
    browser.visit("#/c/logs/table")
    browser.one("#file").send_keys(str(tmp_path / "loads.csv"))
    browser.named("#checked", "a log of loads")
    browser.click("summary", "Two logs")
    browser.one("#displacements").send_keys(str(tmp_path / "moved.csv"))
    button = browser.named(".note.thin button", "Use a lag of 0.3")
    assert "0 s added" in browser.text(".note", "Clocks")
    button.click()
    browser.gone(button)
    added = re.search(r"([\d.]+) s added", browser.text(".note", "Clocks"))
    assert added
    assert float(added[1]) == pytest.approx(0.35, abs=0.001)
    browser.click("#import")
    browser.named(".note", "rows are in the table")
    (kept,) = client.call_json("GET", "/v1/components/logs/imports")["imports"]
    assert kept["filename"] == "loads.csv, moved.csv"
    assert browser.mistakes() == []


def test_the_rows_of_a_finding_are_links_to_the_rows_of_the_table(browser, client, tmp_path):
    rng = np.random.default_rng(3)
    span = np.array([900, 900, 900, 90, 90, 90])
    client.add_component(
        {"name": "turned", "title": "One", "range": {"force": [900] * 3, "moment": [90] * 3}}
    )
    wrench = span * rng.uniform(-1, 1, (40, 6))
    moved = wrench * [1, 1, 1, 10, 10, 10] * 1e-6 + rng.normal(0, 1e-7, (40, 6))
    moved[7, 2] *= -1  # a row of the wrong sign
    header = ",".join(f"{name} [{unit}]" for name, unit in COLUMNS)
    np.savetxt(
        tmp_path / "one.csv", np.c_[wrench, moved], delimiter=",", header=header, comments=""
    )
    reply = client.import_table("turned", tmp_path / "one.csv")
    assert [finding["count"] for finding in reply["findings"]] == [1]
    browser.visit("#/c/turned")
    row = browser.until(
        lambda: re.search(r"Table row (\d+)\.", browser.text(".note", "Outlier")),
        "the row of the outlier",
    )[1]
    browser.click(".note a", row)
    browser.named("table.rows", row)


def test_a_field_left_after_the_check_keeps_the_import_button(browser, rig):
    browser.visit("#/c/unmeasured/table")
    browser.click("#rig-options summary")
    browser.type("#rig-load-point", "0,0,0.05")
    browser.drop(".drop", "one.csv", f"{LOADS},ux [mm]\n40,0,0,0,0,0,0.1\n")
    browser.one("#import")
    browser.run("document.querySelector('#import').kept = true")
    browser.click("#rig-displacement-point")
    assert browser.run("return document.querySelector('#import')?.kept")


def test_the_header_of_a_file_needs_decisions_in_the_words_of_the_page(browser, rig):
    browser.visit("#/c/unmeasured/table")
    browser.drop(".drop", "bare.csv", "Fz [N],uz [mm],strain\n1,0.1,3\n")
    browser.named(".note.outside", "the header needs 2 decisions")
    told = browser.text("#mistakes")
    assert "under Meaning of the columns" in told
    assert "--" not in told


def test_an_answer_for_other_loads_than_those_typed_says_so(browser, plate):
    browser.visit(f"{PLATE}/query")
    ask(browser, fz=-333.3)
    browser.named("p", "F (0, 0, −333.3) N")
    assert not browser.all(".stale")
    browser.type("input[name=fz]", "-500")
    browser.named(".stale .note", "This answer is for F (0, 0, −333.3) N")
    browser.type("input[name=fz]", "-333.3")
    browser.until(lambda: not browser.all(".stale"))


def test_a_load_of_a_scene_from_above_to_is_marked_at_its_field(browser, client):
    browser.visit("#/scene")
    browser.click("label", "spring")
    browser.type("input[aria-label='fz from']", "5")
    browser.type("input[aria-label='fz to']", "-5")
    field = browser.one("input[aria-label='fz to']")
    assert "must not be above" in browser.run("return arguments[0].validationMessage", field)


def test_a_range_that_is_not_symmetrical_stands_at_its_field(browser, client):
    span = {"force": [[-5, 5], [-5, 5], [-900, 100]], "moment": [2, 2, 2]}
    about = {"name": "pressed", "title": "Pressed more than pulled", "range": span}
    client.call_json("POST", "/v1/components", about)
    browser.visit("#/c/pressed/query")
    assert "\u2212900 to 100" in browser.named("form label", "F").find_element("xpath", "..").text


def test_an_unknown_error_bar_is_told_once(browser, client):
    about = {"name": "two_rows", "title": "Rows", "range": {"force": [900] * 3, "moment": [90] * 3}}
    client.add_component(about)
    rows = f"{LOADS},uz [mm]\n0,0,300,0,0,0,0.3\n0,0,600,0,0,0,0.6\n"
    client.import_table("two_rows", rows.encode())
    browser.visit("#/c/two_rows/query")
    browser.type("input[name=fz]", "450")
    browser.click("form button", "Ask")
    browser.named("section", "F (0, 0, 450) N")
    (note,) = browser.all("section[aria-live] .note")
    assert "do not show the error" in note.text


def test_the_page_of_a_job_shows_its_displacement_and_leads_to_its_query(browser, plate):
    (done, *_) = plate.call_json("GET", "/v1/jobs?component=plate_thin&status=done")["jobs"]
    browser.visit(f"#/jobs/{done['id']}")
    browser.named("section", "Displacement of this solve")
    browser.click("a.button", "Query this wrench")
    typed = browser.attribute("input[name=fz]", "value")
    assert float(typed) == done["force"][2]


def test_a_view_without_a_connection_says_so_and_offers_a_retry(browser, client):
    browser.visit("#/")
    browser.one(".card.library")
    browser.run("window.fetch = () => Promise.reject(new TypeError('Failed to fetch'))")
    browser.go("#/jobs")
    browser.named(".note.outside", "No connection")
    browser.one(".note button")
    assert browser.text("#state") == "no answer"


@pytest.mark.parametrize("number", ["999999", "none"])
def test_an_unknown_job_leads_to_the_jobs(browser, client, number):
    browser.visit(f"#/jobs/{number}")
    browser.click("main a[href='#/jobs']", "Go to the jobs")
    browser.named("h1", "Jobs")


def test_a_direct_link_to_an_absent_view_is_explained(browser, client):
    browser.visit("#/c/link/response")
    browser.named(".note", "no view Response: it needs a component with one interface")


def measured(client, name, *pulls):
    """Add a component for measured rows, and import a row for each pull, N."""
    spans = {"force": [600] * 3, "moment": [60] * 3}
    about = {"name": name, "title": "Measured", "range": spans}
    if not any(component["name"] == name for component in client.components()):
        client.call_json("POST", "/v1/components", about)
    lines = [f"0,0,{pull},0,0,0,{pull * 1e-3}" for pull in pulls]
    text = "\n".join([f"{LOADS},uz [mm]", *lines])
    if pulls:
        kind = {"Content-Type": "text/csv"}
        client.call("POST", f"/v1/components/{name}/table", content=text.encode(), headers=kind)
        client.component(name, wait_s=60)  # until the table has the rows


def test_an_open_view_shows_the_first_rows_and_offers_to_draw_later_ones(browser, client):
    measured(client, "followed")
    browser.visit("#/c/followed/response")
    browser.one("main .empty")
    measured(client, "followed", 100, 200, 300)
    browser.named("main p", "3 rows lie on this line")
    measured(client, "followed", 400)
    browser.click("#draw-again")
    browser.named("main p", "4 rows lie on this line")


def test_an_open_overview_counts_the_rows_that_arrive(browser, client):
    measured(client, "counted")
    browser.visit("#/c/counted")
    browser.named("main p", "The table has no rows yet")
    measured(client, "counted", 100, 200)
    browser.named("dl", "2 measured")


def test_the_overview_tells_how_far_the_rows_reach_in_each_load(browser, client):
    measured(client, "reaching")
    measured(client, "reaching", 100, 200)
    browser.visit("#/c/reaching")
    browser.named("td", "100 to 200")


def test_the_band_of_a_response_has_a_gap_where_its_error_is_not_known(browser, plate):
    known = [0.001] * 6
    sweep = {
        "at": [0, 1, 2, 3, 4],
        "displacement": [[0.01] * 6] * 5,
        "error": [known, known, [None] * 6, known, known],
        "interpolation": [known, known, [None] * 6, known, known],
        "coverage": [0, 0, 1, 0, 0],
        "method": "kriging",
        "bars_are_whole": True,
    }
    browser.visit(f"{PLATE}/overview")
    browser.one("main h2")
    browser.run(
        "const own = window.fetch; window.fetch = (to, how) => String(to).includes('/response?')"
        " ? Promise.resolve(new Response(arguments[0])) : own(to, how);",
        json.dumps(sweep),
    )
    browser.go(f"{PLATE}/response")
    browser.drawn("#response")
    bands = browser.run(
        "return document.querySelector('#response').data.filter((one) => one.fill)"
        ".map((one) => one.x)"
    )
    assert bands == [[0, 1, 1, 0, None, 3, 4, 4, 3, None]] * 2


def test_a_shape_without_a_surface_is_solved_by_its_button(browser, client):
    browser.visit("#/c/bar/shape")
    browser.click("button", "Solve this wrench")
    browser.drawn("#shape")
    assert browser.mistakes() == []


def test_a_component_without_a_report_has_a_button_that_makes_one(browser, client):
    client.solve("bar", [0, 0, -50.0], [0, 0, 0], wait_s=120)
    browser.visit("#/c/bar/report")
    browser.click("form button", "Make the report")
    browser.click("#cancel-report")
    browser.until(lambda: not browser.all("#cancel-report"), "the end of the report")


def test_a_job_that_ends_while_it_is_watched_shows_how_long_it_took(browser, plate):
    browser.visit("#/jobs")
    browser.one("table.jobs tr[id]")
    plate.solve("plate_thin", [0, 300.0, 0], [0, 0, 0], wait_s=120)
    newest = plate.call_json("GET", "/v1/jobs?limit=1")["jobs"][0]
    seconds = f"{newest['seconds']:.{2 if newest['seconds'] < 10 else 1}f} s"
    browser.named(f"#job-{newest['id']}", seconds)
    assert browser.all("table.jobs tr[id]")[0].get_attribute("id") == f"job-{newest['id']}"
    browser.until(lambda: not browser.run("return document.querySelector('#queue').textContent"))


def test_a_refused_cancellation_of_all_waiting_jobs_is_named(browser, client):
    waiting = job(2, "waiting", created="2026-01-01T00:00:00Z")
    browser.visit("#/terms")
    browser.one("h1")
    browser.run(STUB, json.dumps([["v1/jobs?", {"jobs": [waiting], "next": None}]]))
    browser.run(REFUSED, "DELETE")
    browser.go("#/jobs")
    browser.click("main button", "Cancel all waiting jobs")
    browser.named("#notices", "The server is busy.")


def test_a_slow_reply_of_an_earlier_filter_does_not_replace_the_jobs_of_a_later_one(
    browser, client
):
    about = {"created": "2026-01-01T00:00:00Z", "seconds": 1.0}
    pages = {"failed": job(1, "failed", **about), "done": job(2, "done", **about)}
    replies = [[f"status={name}", {"jobs": [one], "next": None}] for name, one in pages.items()]
    browser.visit("#/terms")
    browser.one("h1")
    browser.run(STUB, json.dumps([*replies, ["v1/jobs?", {"jobs": [], "next": None}]]))
    browser.run(
        "const stub = window.fetch; window.fetch = (to, how) => String(to).includes('failed') ?"
        " new Promise((go) => { window.release = () => go(stub(to, how)); }) : stub(to, how);"
    )
    browser.go("#/jobs")
    browser.one("main select")
    for name in pages:
        browser.run(
            "const filter = document.querySelector('main select'); filter.value = arguments[0];"
            "filter.dispatchEvent(new Event('change'));",
            name,
        )
    browser.one("#job-2")
    browser.run("window.release(); await new Promise((go) => setTimeout(go, 0));")
    assert browser.all("#job-2")
    assert not browser.all("#job-1")


# -- components with several interfaces, and with a temperature ----------------------------------

VIEWS = ("overview", "query", "rows", "jobs", "table", "settings")


def drawn(browser):
    browser.drawn("#loads")


def test_loads_by_interface_are_asked_and_each_interface_has_its_displacement(browser):
    browser.visit("#/c/link/query")
    drawn(browser)
    for name in ("right.fx", "right.fy", "right.mx", "right.my", "right.mz"):
        browser.type(f"input[name='{name}']", "0")
    browser.type("input[name='right.fz']", "-150")
    browser.click("form button", "Ask")
    browser.until(lambda: browser.all("table.answer"))
    captions = [item.text for item in browser.all("table.answer caption")]
    assert captions == ["right"]
    assert "uz −3.887 mm" in browser.text("table.answer").replace("\u2007", "")
    assert "left: no displacement" in browser.text("main")
    assert "No loads at left" in browser.text("main")
    assert "covered" in browser.text("main")


def test_a_temperature_is_asked_beside_the_wrench(browser):
    browser.visit("#/c/hot_bracket/query")
    drawn(browser)
    assert browser.attribute("input[name='temperature']", "value") == "20"
    browser.type("input[name='temperature']", "80")
    browser.click("form button", "Ask")
    browser.until(lambda: browser.all("table.answer"))
    assert "temperature 80" in browser.text("main")


def test_a_unit_that_could_not_be_read_is_requested_for_the_next_list_of_jobs(browser):
    """A failed request left a job's temperature without its unit until the page was loaded anew."""
    heated = job(2, "done", component="hot_bracket", created="2026-01-01T00:00:00Z")
    heated["inputs"] = {"temperature": 80.0}
    browser.visit("#/terms")
    browser.one("h1")
    browser.run(STUB, json.dumps([["v1/jobs?", {"jobs": [heated], "next": None}]]))
    browser.run("window.served = window.fetch;" + REFUSED, "GET", "v1/components/hot_bracket")
    browser.go("#/jobs")
    assert "temperature 80" in browser.text("#job-2")
    browser.go("#/terms")
    browser.named("h1", "Terms")
    browser.run("window.fetch = window.served;")
    browser.go("#/jobs")
    browser.until(lambda: "80\u00a0°C" in browser.text("#job-2").replace(" ", "\u00a0"))


def test_arrows_follow_the_loads_that_are_typed(browser):
    browser.visit("#/c/link/query")
    drawn(browser)
    before = browser.run("return document.querySelector('#loads').dataset.drawn")
    browser.type("input[name='right.fy']", "100")
    arrows = "return document.querySelector('#loads').data.filter((one) => one.type === 'cone')"
    browser.until(
        lambda: browser.run("return document.querySelector('#loads').dataset.drawn") != before
    )
    browser.until(lambda: any(item["v"][0] > 0.1 for item in browser.run(arrows)))


@pytest.mark.parametrize(
    ("name", "view"),
    slow_but(
        {("hot_bracket", "query"), *(("link", view) for view in VIEWS)},
        product(("link", "hot_bracket"), VIEWS),
    ),
)
def test_each_view_of_such_a_component_is_drawn_without_a_mistake(browser, name, view):
    browser.visit(f"#/c/{name}/{view}")
    browser.one("nav.tabs [aria-current]")
    browser.one("main .card")
    assert browser.mistakes() == []


def test_the_key_of_the_loads_names_those_that_are_drawn(browser, plate):
    browser.visit(f"{PLATE}/query")
    browser.drawn("#loads")
    assert browser.text(".key-of-marks") == "force"


def test_the_scene_plan_takes_loads_by_interface(browser):
    browser.visit("#/scene")
    browser.until(lambda: browser.all("fieldset input[type=checkbox]"))
    boxes = browser.all("fieldset.card label.check")
    next(box for box in boxes if box.text == "link").click()
    browser.click("form button", "Plan")
    browser.until(lambda: browser.all(".cards section.card"))
    assert "right Fx" in browser.text("main")


def test_measured_rows_are_drawn_beside_the_solves_and_beside_another_import(browser, client):
    client.solve("bar", [0, 0, 50.0], wait_s=120)
    ask = partial(client.displacements, "bar", [[0, 0, 60.0, 0, 0, 0]], on_thin="estimate")
    until(lambda: ask().coverage[0] == "covered")  # the row's table is packed
    rng = np.random.default_rng(0)
    force = rng.uniform(-95, 95, (2, 40))
    for loads, softer in zip(force, (1.0, 1.1), strict=True):
        wrenches = np.zeros((40, 6))
        wrenches[:, 2] = loads
        moved = client.displacements("bar", wrenches, on_thin="estimate").displacements
        pairs = zip(loads.tolist(), (softer * moved[:, 2]).tolist(), strict=True)
        rows = [{"fz [N]": one, "uz [m]": other} for one, other in pairs]
        options = {"missing_loads": "zero", "load_cell": "moving", "wait_s": 60}
        number = client.append("bar", f"rig {softer}", rows, **options)["import"]
    browser.visit("#/c/bar/compare")
    for plot in ("over-load", "over-order", "over-expected"):
        browser.drawn(f"#{plot}")
    assert "answer of the solves alone" in browser.text("p", "measured rows")
    assert "80 of 80 measured rows" in browser.text("p", "measured rows")
    browser.run(
        "const choose = (id, to) => { const one = document.getElementById(id); one.value = to;"
        " one.dispatchEvent(new Event('change')); }; choose('compared', arguments[0]);"
        " choose('reference', arguments[1]);",
        *(str(number), str(number - 1)),
    )
    browser.named("p", f"rows of import {number - 1}")
    browser.named("td", "1.1")
    means, rms = (
        [cell.text for cell in browser.all(f"td[data-head='{head} residual']")]
        for head in ("Mean", "RMS")
    )
    assert all(re.fullmatch(r"(0|\d{2}|\d\.\d|0\.\d{2}|\d{2}0) \S+m", text) for text in rms)
    assert [text.split()[1] for text in means] == [text.split()[1] for text in rms]
    browser.resize(390, 900)
    assert not overflow(browser)


def overflow(browser):
    """The width, px, of a table that a telephone does not show."""
    wide = browser.one("table.folds.named").find_element("xpath", "..")
    return browser.run("return arguments[0].scrollWidth - arguments[0].clientWidth", wide)


def test_imports_are_cards_with_their_headings_on_a_telephone(browser, client):
    measured(client, "folded", 100, 200)
    browser.resize(390, 900)
    browser.visit("#/c/folded/table")
    browser.one("table.imports a")
    assert not overflow(browser)
    heading = "return getComputedStyle(arguments[0], '::before').content"
    cell = browser.named("table.imports td", "2")
    assert browser.run(heading, cell) == '"Rows"'


LOW_LINKS = """return [...document.querySelectorAll('.brand, main :is(.crumb, td, dd) a')]
  .filter((one) => one.getBoundingClientRect().height < 24).map((one) => one.textContent)"""


def test_links_of_lists_and_of_the_way_back_are_24_px_high_on_a_telephone(browser, plate):
    browser.resize(390, 900)
    for address in ("#/jobs", "#/audit", PLATE, "#/jobs/1"):
        browser.visit(address)
        browser.one("main .crumb a" if address in (PLATE, "#/jobs/1") else "main td a")
        assert browser.run(LOW_LINKS) == []


def test_an_empty_table_in_the_library_links_to_its_query_and_its_fill(browser, client):
    browser.visit("#/")
    card = browser.named(".card.library", "plate_ccx")
    browser.until(lambda: "empty table" in card.text)
    links = {a.text: a.get_attribute("hash") for a in card.find_elements("tag name", "a")}
    assert links["ask a query"] == "#/c/plate_ccx/query"
    assert links["fill it"] == "#/c/plate_ccx/overview?fill"
    card.find_element("link text", "ask a query").click()
    browser.named("h1", "plate_ccx")
    browser.one("input[name='fx']")


def test_the_link_of_a_fill_leads_to_its_button(browser, client):
    browser.visit("#/c/plate_ccx/rows")
    browser.click("main a", "Go to Fill the table")
    browser.until(lambda: browser.run("return document.activeElement?.id === 'fill'"))


def test_a_gap_of_the_coverage_leads_to_its_query(browser, plate):
    gaps = plate.call_json("GET", "/v1/components/plate_thin/coverage")["gaps"]
    (gap,) = (one for one in gaps if one["axis"] == "z")
    browser.resize(390, 900)
    browser.visit(f"{PLATE}/coverage")
    browser.one("section td a")
    assert not overflow(browser)
    browser.click("section td a", "Query")
    typed = browser.attribute("input[name=fz]", "value")
    assert float(typed) == gap["worst"][0]["loads"]["fz"]


def test_the_key_of_the_coverage_names_what_is_drawn_alone(browser, plate):
    drawing = plate.call_json("GET", "/v1/components/plate_thin/drawing?axis=z")
    drawing["grid"]["coverage"] = [0] * len(drawing["grid"]["coverage"])
    browser.visit("#/terms")
    browser.one("h1")
    browser.run(STUB, json.dumps([["/drawing", drawing], ["/demand", {"latest": []}]]))
    browser.go(f"{PLATE}/coverage")
    key = browser.text(".key-of-marks")
    assert "row with" in key
    assert not re.search("thin|outside|queries", key)


def test_the_coverage_is_drawn_again_where_rows_arrived_between_its_two_calls(browser, plate):
    browser.visit("#/terms")
    browser.one("h1")
    browser.run(
        "const own = window.fetch; window.drawn = 0; window.fetch = async (to, how) => {"
        " const reply = await own(to, how); if (!String(to).includes('/drawing')) return reply;"
        " const body = await reply.json(); window.drawn += 1;"
        " if (window.drawn === 1) body.table_version -= 1;"
        " return new Response(JSON.stringify(body)); }"
    )
    browser.go(f"{PLATE}/coverage")
    browser.named("h2", "Coverage of this axis")
    assert browser.run("return window.drawn") == 2
    assert "Rows arrive" not in browser.text("main")


def test_an_import_is_withdrawn_and_restored_after_a_confirmation(browser, client):
    measured(client, "edited", 100, 200)
    browser.visit("#/c/edited/table")
    for verb, rows in (("Withdraw", 0), ("Restore", 2)):
        browser.click("table.imports button", verb)
        browser.click("dialog button", verb)
        browser.until(lambda: not browser.all("dialog"), "the end of the dialog")
        assert client.component("edited", wait_s=60)["rows"] == rows
        browser.click("#notices button")
    assert "anonymous" in browser.text("table.imports tr", "Withdraw")
    assert browser.mistakes() == []


def numbers(browser):
    """Return the numbers of the rows that are listed."""
    return [int(item.get_attribute("id")[4:]) for item in browser.all("table.rows tr[id]")]


def test_a_row_is_withdrawn_found_by_its_state_and_restored_in_the_list_of_rows(browser, client):
    measured(client, "listed", 100, 200, 300)
    browser.visit("#/c/listed/rows")
    browser.click("table.rows button", "Withdraw")
    browser.named("table.rows .pill", "withdrawn")
    assert client.component("listed", wait_s=60)["rows"] == 2
    browser.click("option[value='withdrawn']")
    browser.until(lambda: len(numbers(browser)) == 1)
    browser.click("table.rows button", "Restore")
    browser.named("table.rows .pill", "in the table")
    assert client.component("listed", wait_s=60)["rows"] == 3


def test_the_list_of_rows_is_paged_over_solves_and_imports_newest_first(browser, client):
    client.solve("spring", [0, 0, -5.0], wait_s=120)
    header = {"Content-Type": "text/csv"}
    text = "\n".join([f"{LOADS},uz [mm]", *(f"0,0,{-k / 10},0,0,0,{-k}" for k in range(1, 31))])
    client.call("POST", "/v1/components/spring/table", content=text.encode(), headers=header)
    client.solve("spring", [0, 0, -6.0], wait_s=120)
    rows = client.call_json("GET", "/v1/components/spring/table")["rows"]
    present = sorted((row["row"] for row in rows), reverse=True)
    browser.visit("#/c/spring/rows")
    browser.until(lambda: numbers(browser) == present[:25])
    browser.click("button", "Older rows")
    browser.until(lambda: numbers(browser) == present)


def test_a_link_to_an_import_lists_its_rows_alone(browser, client):
    measured(client, "twice", 100, 200)
    measured(client, "twice", 300)
    browser.visit("#/c/twice/table")
    browser.named("table.imports tr", "2")
    browser.click("table.imports tr:last-child a")
    browser.until(lambda: len(numbers(browser)) == 2)


def test_the_audit_leads_to_the_row_that_was_withdrawn(browser, client):
    measured(client, "audited", 100, 200)
    row = client.call_json("GET", "/v1/components/audited/table")["rows"][0]["row"]
    client.call("DELETE", f"/v1/components/audited/table/{row}")
    browser.visit("#/audit")
    browser.click("table.audit a", f"row {row}")
    browser.until(lambda: numbers(browser) == [row])


def test_settings_in_the_audit_have_units(browser, client):
    settings = {"table_memory": 700, "backup_every": 0.0, "keep_days": 30.0}
    entry = {"id": 1, "time": "2026-01-01T00:00:00Z", "actor": "(server)", "action": "settings"}
    entry |= {"component": "", "object": "serve", "before": None, "after": settings}
    changed = entry | {"id": 2, "before": settings, "after": settings | {"table_memory": 900}}
    browser.visit("#/terms")
    browser.one("h1")
    browser.run(STUB, json.dumps([["v1/audit", {"entries": [changed, entry], "next": None}]]))
    browser.go("#/audit")
    assert browser.text("#entry-2 td:last-child") == "table memory 700 MB → 900 MB"
    first = browser.text("#entry-1 td:last-child")
    assert first == "table memory 700 MB, backup every 0 h, keep days 30"


def audit_of(browser, **entry):
    """The last cell of an audit of one entry, and the entry's words."""
    whole = {"id": 1, "time": "2026-01-01T00:00:00Z", "actor": "ann", "component": "plate_thin"}
    whole |= {"before": None, "after": None} | entry
    browser.visit("#/terms")
    browser.one("h1")
    browser.run(STUB, json.dumps([["v1/audit", {"entries": [whole], "next": None}]]))
    browser.go("#/audit")
    return browser.text("#entry-1")


def test_the_audit_says_that_a_report_was_begun(browser, client):
    entry = {"action": "report.make", "object": "plate_thin", "after": {"wrenches": 24}}
    assert "ann report begun plate_thin report wrenches 24" in audit_of(browser, **entry)


def test_the_kind_of_a_failure_in_the_audit_has_no_underscores(browser, client):
    shown = audit_of(browser, action="job.fail", object="7", after={"kind": "rotation_too_large"})
    assert shown.endswith("kind rotation too large")


def test_the_end_of_a_key_in_the_audit_is_a_date(browser, client):
    after = {"scope": "read", "expires": 1798761600.0}
    shown = audit_of(browser, action="key.add", object="lab", component="", after=after)
    assert "expires 1 Jan 2027, 00:00 UTC" in shown


def test_the_list_of_jobs_says_who_asked_when_and_why_a_solve_failed(browser, plate):
    error = {"kind": "snap_through", "message": "It buckles.", "remedy": "Keep below."}
    asked = {"actor": "ann", "created": "2026-01-01T00:00:00Z"}
    failed = job(7, "failed", seconds=2.0, **asked) | {"error": error}
    browser.visit("#/terms")
    browser.one("h1")
    browser.run(STUB, json.dumps([["v1/jobs?", {"jobs": [failed], "next": None}]]))
    browser.go("#/jobs")
    shown = " ".join(browser.text("#job-7").replace("\u00a0", " ").split())
    assert shown.startswith("7 plate_thin failed F (0, 0, 7) N, M (0, 0, 0) N·m It buckles.")
    assert shown.endswith("1 Jan 2026, 00:00 UTC by ann 2.00 s Retry Log")


def test_the_log_of_a_failed_job_has_the_message_first_and_the_traceback_folded(
    browser, client, tmp_path
):
    changed = {"nonlinear": "true", "force": "[40000, 100, 100]"}
    client.add_component(bundle(tmp_path, "strut", **changed))
    with pytest.raises(ProblemError, match="buckles"):
        client.solve("strut", [-10_000, 0, 0], [0, 0, 0], wait_s=120)
    browser.visit("#/c/strut/jobs")
    browser.click("button", "Log")
    folded = browser.one("dialog summary")
    assert "Traceback" not in browser.text("dialog")
    assert "Keep the load range below that load" in browser.text("dialog .note")
    folded.click()
    browser.named("dialog pre", "Traceback")


def doubtful(plate):
    """A report in which 2 of 6 errors lay inside the bars."""
    rows = plate.component("plate_thin")["rows"]
    table = {"method": "kriging", "rows": rows, "beyond_error_bar": {"missed": 4, "of": 6}}
    report = {"tables": [table], "default": {"method": "kriging"}, "rows": rows}
    report |= {"made": "2026-01-01T00:00:00Z", "table_version": 1}
    report["advice"] = "The error bars of kriging were too small for 4 of 6 answers."
    report |= {"bars_too_small": True, "needs_rows": True}
    return report


def test_the_overview_shows_that_the_error_bars_were_too_small_in_the_report(browser, plate):
    """The report found 2 of 6 errors inside the bars, and the overview called all fine."""
    report = doubtful(plate)
    browser.visit("#/terms")
    browser.one("h1")
    browser.run(STUB, json.dumps([["format=state", {"state": "done"}], ["/report", report]]))
    browser.go(PLATE)
    warned = browser.text(".note", "warns of the error bars")
    assert report["advice"] in warned
    assert "Made 1 Jan 2026, 00:00 UTC with table version 1" in warned
    assert "33 % of 6 true errors lay within" in browser.text("section", "Method and rows")


@pytest.mark.parametrize("missed", [4, 0])
def test_an_answer_says_that_the_error_bars_were_too_small_in_the_report(browser, plate, missed):
    report = doubtful(plate)
    report["tables"][0]["beyond_error_bar"]["missed"] = missed
    report["bars_too_small"] = missed > 0
    browser.visit("#/terms")
    browser.one("h1")
    browser.run(STUB, json.dumps([["format=state", {"state": "done"}], ["/report", report]]))
    browser.go(f"{PLATE}/query")
    ask(browser, fz=-900)
    browser.one("table.answer")
    if missed:
        doubt = browser.named(".note.outside", "only 33 % of 6 true errors lay within")
        link = doubt.find_element("css selector", "a").get_attribute("href")
        assert link.endswith("#/c/plate_thin/report")
    else:
        assert "In the latest report" not in browser.text("main")


def test_the_overview_names_the_files_and_dates_of_measured_rows(browser, client, tmp_path):
    """It had "measured, rig b83e6161", the digest of a profile without a name."""
    measured(client, "benched")
    file, profile = tmp_path / "monday.csv", tmp_path / "profile.toml"
    file.write_text(f"{LOADS},ux [mm],uy [mm],uz [mm],rx [deg],ry [deg],rz [deg]\n1{',0' * 11}")
    profile.write_text('frame = "x=-y,y=x,z=z"')
    client.import_table("benched", file, rig=profile)
    browser.visit("#/c/benched")
    browser.named("section", "1 measured")
    shown = browser.text("section", "Method and rows")
    assert re.search(r"monday\.csv \(1 row, \d+ \w+ \d{4}, \d\d:\d\d UTC\)", shown)
    assert ", rig " not in shown


def unbuilt(browser):
    """The card of a component whose mesh is never there."""
    browser.visit("#/terms")
    browser.one("h1")
    browser.run(
        "const own = window.fetch; window.fetch = (to, how) => String(to).includes('/surface')"
        " ? new Promise(() => {}) : own(to, how);"
    )
    browser.go("#/")
    return browser.named(".card.library", "spring")


def test_a_card_says_that_the_mesh_of_its_picture_is_being_built(browser, client):
    assert "The mesh is being built" in unbuilt(browser).text


def test_a_card_keeps_its_height_when_its_picture_is_drawn(browser, client):
    before = unbuilt(browser).find_element("css selector", ".picture").size
    card, _ = card_of(browser, "spring")
    assert card.find_element("css selector", ".picture").size == before


def test_thin_and_outside_queries_of_the_demand_have_different_marks(browser, plate):
    cells = [
        {"wrench": [0, 0, load, 0, 0, 0], "count": 1, "coverage": kind, "thin": 1, "outside": 0}
        for load, kind in ((100, "thin"), (3000, "outside"))
    ]
    reply = {"cells": cells, "asked": 2, "cell_size": [1] * 6, "elsewhere": 0, "latest": []}
    browser.visit("#/terms")
    browser.one("h1")
    browser.run(STUB, json.dumps([["/demand", reply]]))
    browser.go(f"{PLATE}/demand")
    browser.drawn("#demand")
    symbols = browser.run("return document.querySelector('#demand').data[0].marker.symbol")
    assert symbols == ["circle", "diamond"]


def test_thin_and_outside_loads_of_the_coverage_have_different_marks(browser, plate):
    """They were squares of two browns."""
    drawing = plate.call_json("GET", "/v1/components/plate_thin/drawing?axis=z")
    cells = drawing["grid"]["coverage"]
    drawing["grid"]["coverage"] = [1 + place % 2 for place in range(len(cells))]
    browser.visit("#/terms")
    browser.one("h1")
    browser.run(STUB, json.dumps([["/drawing", drawing]]))
    browser.go(f"{PLATE}/coverage")
    browser.drawn("#coverage")
    marks = browser.run(
        "return document.querySelector('#coverage').data.filter((one) => one.hovertemplate?.match("
        "/^(thin|outside)/)).map((one) => [one.marker.symbol, one.marker.color])"
    )
    assert [symbol for symbol, _ in marks] == ["square", "diamond-open"]
    colours = np.array([re.findall(r"\d+", colour) for _, colour in marks], dtype=float)
    assert np.ptp(colours[1]) < 40  # grey
    assert np.ptp(colours[0]) > 100
    browser.one(".key-of-marks .hollow.diamond")


def show_demand_outside(browser):
    """Open the demand of one query outside."""
    cell = {"wrench": [0] * 6, "count": 1, "coverage": "outside", "thin": 0, "outside": 1}
    reply = {"cells": [cell], "asked": 1, "cell_size": [1] * 6, "elsewhere": 0, "latest": []}
    browser.visit("#/terms")
    browser.one("h1")
    browser.run(STUB, json.dumps([["/demand", reply]]))
    browser.go(f"{PLATE}/demand")


def test_outside_queries_of_the_demand_are_grey_in_the_key_too(browser, plate):
    show_demand_outside(browser)
    browser.drawn("#demand")
    drawn, key = browser.run(
        "const key = document.querySelector('.key-of-marks .diamond'); return ["
        "document.querySelector('#demand').data[0].marker.color[0], getComputedStyle(key)."
        "backgroundColor]"
    )
    assert drawn == key
    assert np.ptp(np.array(re.findall(r"\d+", drawn), dtype=float)) < 40


# Pixels between the box of the axes and its part of the drawing, beside, and above and below it.
FREE = """const place = document.querySelector(arguments[0]), scene = place._fullLayout.scene;
const {view, projection} = scene._scene.glplot.cameraParams;
const by = (m, v) => [0, 1, 2, 3].map((k) => v.reduce((sum, x, j) => sum + m[4*j+k]*x, 0));
const {x, y, z} = scene.aspectratio, halves = [-0.5, 0.5];
const corners = halves.flatMap((a) => halves.flatMap((b) => halves.map((c) =>
  by(projection, by(view, [a * x, b * y, c * z, 1])))));
const spans = [scene.domain.x, scene.domain.y].map(([low, high]) => high - low);
return [place.clientWidth, place.clientHeight].map((length, k) =>
  spans[k] * length / 2 * (1 - Math.max(...corners.map((one) => Math.abs(one[k] / one[3])))));"""


@pytest.mark.parametrize("width", [390, slow(1400)])
@pytest.mark.parametrize(
    ("view", "place", "names"),
    [
        ("query", "#loads", (60, 36)),
        ("coverage", "#coverage", (60, 36)),
        ("faces", "#faces", (60, 36)),
        ("shape", "#shape", (26, 18)),
    ],
)
def test_a_drawing_in_space_fills_its_frame(browser, plate, view, place, names, width):
    """All but that of the loads were small on a telephone."""
    browser.resize(width, 900)
    browser.visit(f"{PLATE}/{view}")
    browser.drawn(place)
    beside, above = browser.run(FREE, place)
    assert beside > names[0] - 10  # px for the names and ticks of the axes
    assert above > names[1] - 6
    assert beside < names[0] + 5 or above < names[1] + 4


def test_a_drawing_is_fitted_again_to_a_smaller_width(browser, plate):
    """Titles of its axes were cut off."""
    browser.resize(1400, 900)
    browser.visit(f"{PLATE}/coverage")
    browser.drawn("#coverage")
    browser.resize(390, 900)
    browser.until(lambda: browser.run(FREE, "#coverage")[0] > 50)


def test_the_names_of_axes_in_space_are_smaller_on_a_telephone(browser, plate):
    """The left edge cut the name of the vertical axis."""
    browser.resize(390, 844)
    browser.visit(f"{PLATE}/coverage")
    browser.drawn("#coverage")
    axis = "document.querySelector('#coverage')._fullLayout.scene.zaxis"
    assert browser.run(f"return {axis}.title.font.size") <= 11
    assert browser.run(f"return {axis}.tickfont.size") <= 10


def test_the_mark_of_the_largest_displacement_is_not_in_the_surface(browser, plate):
    """The surface hid half of the marker."""
    browser.visit(f"{PLATE}/shape")
    browser.drawn("#shape")
    marks = "return document.querySelector('#shape').layout.scene.annotations"
    (mark,) = browser.run(marks)
    assert "largest" in mark["hovertext"]
    assert "markers" not in browser.run(
        "return document.querySelector('#shape').data.map((one) => one.mode)"
    )
    browser.click("button", "True scale")
    browser.until(lambda: browser.run(marks)[0]["z"] != mark["z"], "a mark at true scale")


def test_a_stress_is_rounded_to_the_last_digit_of_its_error(browser, plate):
    reply = plate.call_json("GET", "/v1/components/plate_thin/deformed?fz=-900")
    stress = {"largest": 68.7612e6, "error": 1.34e6, "at": [0, 0, 0], "yields": False}
    reply["stress"] = {**stress, "yield_strength": 240e6}
    browser.visit("#/terms")
    browser.one("h1")
    browser.run(STUB, json.dumps([["/deformed", reply]]))
    browser.go(f"{PLATE}/shape")
    assert "68.8 MPa ± 1.3 MPa" in browser.text("dl.facts")


def test_a_shape_has_0_for_a_displacement_within_its_error_bar(browser, plate):
    """A plate pressed at its centre moved 1.445·10⁻⁵ mm aside."""
    small = {"translation": [1.4e-8, -1.2e-8, -2.653e-3], "rotation": [0] * 3}
    error = {"translation": [1e-7, 1e-7, 1e-4], "rotation": [0] * 3}
    browser.visit("#/terms")
    browser.one("h1")
    browser.run(STUB, json.dumps([["/displacement", {**small, "error": error}]]))
    browser.go(f"{PLATE}/shape")
    shown = browser.text("dl.facts").replace("\u00a0", " ")
    assert "u (0, 0, −2.65) mm" in shown


def test_strokes_of_the_picture_of_a_part_have_no_spikes(browser, client):
    """Mitred corners of thin triangles made a saw of the far edge of a plate."""
    browser.visit("#/terms")
    browser.one("h1")
    browser.run(
        "window.joins = new Set(); const own = CanvasRenderingContext2D.prototype.stroke;"
        "CanvasRenderingContext2D.prototype.stroke = function () {"
        " window.joins.add(this.lineJoin); return own.call(this); }"
    )
    browser.go("#/c/plate_thin")
    browser.one(".picture canvas:not([hidden])")
    assert browser.until(lambda: browser.run("return [...window.joins]")) == ["round"]


def test_the_time_left_of_a_job_takes_at_most_two_lines(browser, plate):
    """Its mean took five lines of the column of the solve times."""
    done = job(1, "done", seconds=1.0)
    running = job(2, "running", started="2026-01-01T00:00:00Z")
    running["progress"] = {"fraction": 0.5, "message": "step 3"}
    lists = [
        ["status=running", {"jobs": [running], "next": None}],
        ["status=done", {"jobs": [done], "next": None}],
        ["jobs?", {"jobs": [running, done], "next": None}],
    ]
    browser.resize(1400, 900)
    browser.visit("#/terms")
    browser.one("h1")
    browser.run(STUB, json.dumps(lists))
    browser.go("#/jobs")
    words = browser.named("#job-2 span", "longer than the mean")
    assert words.size["height"] < 45  # px: two lines


def test_the_key_of_the_demand_names_what_is_drawn_alone(browser, plate):
    show_demand_outside(browser)
    assert "thin" not in browser.text(".key-of-marks")


def test_a_response_can_be_drawn_as_its_deviation_from_a_straight_line(browser, gauge):
    """The band of a good rig was thinner than its line."""
    browser.visit("#/c/gauge/response")
    browser.drawn("#response")
    browser.click("label", "deviation from a straight line")
    shown = browser.text("main p", "less the straight line")
    slope = float(re.search(r"\+ (\d+) nm/N · Fz", shown.replace("\u00a0", " "))[1])
    assert slope == pytest.approx(500, rel=0.01)
    title = "return document.querySelector('#response').layout.yaxis.title.text"
    assert "less a line" in browser.run(title)
    line = "return document.querySelector('#response').data[2].y"
    assert max(map(abs, browser.run(line))) < 1000  # nm, of 150,000 nm


def test_an_overview_leaves_out_axes_and_tolerances_without_loads_and_outputs(browser, strut):
    """A strut with one load had bars of three axes, and the tolerance r (–, –, –) rad."""
    browser.visit("#/c/pull_strut")
    browser.named(".shares", "axis z")
    assert "axis x" not in browser.text("main")
    shown = browser.text("section", "Method and rows")
    assert "1 % of each output's range: u (–, –, " in shown.replace("\u00a0", " ")
    assert "r (" not in shown


def test_all_columns_of_a_compliance_have_one_width(browser, plate):
    browser.resize(1400, 900)
    browser.visit(f"{PLATE}/checks")
    browser.one("table.matrix")
    widths = {round(item.size["width"]) for item in browser.all("table.matrix thead th")[:7]}
    assert max(widths) - min(widths) <= 1


def test_the_buttons_of_an_import_are_below_its_facts_on_a_telephone(browser, strut):
    """They were between the number of its rows and its date."""
    browser.resize(390, 844)
    browser.visit("#/c/pull_strut/table")
    button = browser.one(".imports td button").location["y"]
    cells = browser.all(".imports tbody tr:first-child td[data-head]")
    assert button > max(cell.location["y"] for cell in cells)


def test_rows_that_all_have_loads_of_other_axes_are_called_all(browser, plate):
    """It said that 90 of 90 have them."""
    reply = plate.call_json("GET", "/v1/components/plate_thin/coverage")
    for entry in reply["axes"]:
        entry.update(rows=90, corrected=90)
    browser.visit("#/terms")
    browser.one("h1")
    browser.run(STUB, json.dumps([["/coverage", reply]]))
    browser.go(f"{PLATE}/coverage")
    browser.named("p", "all of them with loads of other axes too")


def test_a_finding_has_no_options_of_commands(browser):
    browser.visit("#/terms")
    script = """return import('/page/js/findings.js').then(({ findingNote }) =>
      findingNote('rig', { cause: 'hysteresis', message: arguments[0] }, 1).textContent)"""
    shown = browser.run(script, "import again with branch=loading (--branch loading)")
    assert "branch=loading." in shown
    assert "--" not in shown


def test_the_wrench_of_a_job_stays_in_a_line_beside_one_that_runs(browser, plate):
    """A wide column of the states took its place."""
    progress = {"fraction": 0.4, "message": "increment 4 of 10, iteration 3, residual 2.1e-5"}
    about = {"created": "2026-01-01T00:00:00Z", "started": "2026-01-01T00:00:00Z"}
    running = job(3, "running", progress=progress, **about)
    done = job(2, "done", created=about["created"])
    done |= {"force": [169.05, 306.75, 1994.9], "moment": [96.892, -92.209, 29.702]}
    pages = [["status=running", [running]], ["status=waiting", []], ["v1/jobs?", [done]]]
    browser.resize(1400, 900)
    browser.visit("#/terms")
    browser.one("h1")
    browser.run(STUB, json.dumps([[text, {"jobs": jobs, "next": None}] for text, jobs in pages]))
    browser.go("#/jobs")
    browser.one("#job-3 progress")
    lines = browser.run(
        "const range = document.createRange(); range.selectNodeContents("
        "document.querySelector('#job-2 td.small.whole')); return new Set([...range."
        "getClientRects()].map((one) => Math.round(one.top))).size"
    )
    assert lines == 1


def test_the_bottom_of_a_view_can_be_scrolled_from_below_the_tour(browser, plate):
    browser.run("localStorage.clear()")
    browser.resize(390, 900)
    browser.visit("#/")
    browser.named("dialog.tour h2", "New here?")
    browser.one(".card.library")
    ends = browser.run(
        "scrollTo(0, document.documentElement.scrollHeight); const bottom = (one) =>"
        " one.getBoundingClientRect().bottom; return [Math.max(...[...document.querySelectorAll("
        "'main .card')].map(bottom)), document.querySelector('dialog').getBoundingClientRect().top]"
    )
    assert ends[0] <= ends[1]


def test_stretches_of_a_response_that_are_thin_and_outside_have_their_words(browser, plate):
    """Their colours were two tans."""
    known, codes = [[0.001] * 6] * 9, [2, 2, 2, 0, 0, 0, 1, 1, 1]
    sweep = {"at": list(range(9)), "displacement": known, "error": known, "interpolation": known}
    sweep |= {"coverage": codes, "method": "kriging", "bars_are_whole": True}
    browser.visit("#/terms")
    browser.one("h1")
    browser.run(STUB, json.dumps([["/response?", sweep]]))
    browser.go(f"{PLATE}/response")
    browser.drawn("#response")
    shapes = browser.run("return document.querySelector('#response').layout.shapes")
    assert [shape["label"]["text"] for shape in shapes] == ["outside", "thin"]
    assert "thin" in browser.text(".key-of-marks")
    colours = [re.findall(r"[\d.]+", shape["fillcolor"]) for shape in shapes]
    assert np.ptp(np.array(colours, dtype=float), axis=0)[:3].max() > 60


def test_the_parts_of_the_band_of_a_measured_table_have_the_names_of_its_errors(browser, gauge):
    """The key counted noise as an error beside the interpolation error, which contains it."""
    browser.visit("#/c/gauge/response")
    browser.drawn("#response")
    key = browser.text(".key-of-marks")
    assert "interpolation and noise: more readings lower them" in key
    assert "hysteresis" not in key  # this rig has none, and the key names what is drawn alone
    caption = browser.text("main p", "lie on this line")
    assert "(interpolation and noise" in caption
    assert ", hysteresis" not in caption


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        (
            "the error of rz, 0.0012 rad, is over 6e-05 rad",
            "The error of rz, 1.2\u00a0mrad, is over 60\u00a0µrad",
        ),
        ("self-weight moves it by 0.0014 m", "Self-weight moves it by 1.4\u00a0mm"),
        ("analysis.gravity is missing", "analysis.gravity is missing"),
        ("under [0, 0.0849, -9.77] m/s^2", "Under [0, 0.0849, −9.77] m/s²"),
    ],
)
def test_a_text_of_the_server_has_the_units_of_the_page(browser, text, shown):
    """One sentence compared 0.0012 rad with 60 µrad."""
    browser.visit("#/terms")
    script = "return (await import('/page/js/format.js')).sentence(arguments[0])"
    assert browser.run(script, text) == shown


def test_the_measured_stiffness_is_offered_once_rows_are_measured(browser, client):
    measured(client, "stiff")
    browser.visit("#/c/stiff/table")
    browser.named("h2", "Export the table")
    assert "Measured stiffness" not in browser.text("main")
    measured(client, "stiff", 100, 200)
    browser.named("h2", "Measured stiffness")


def test_a_measured_component_has_no_line_of_jobs(browser, client):
    measured(client, "jobless", 100)
    browser.visit("#/c/jobless")
    names = browser.named("section", "Method and rows").find_elements("css selector", "dt")
    assert "Jobs" not in [name.text for name in names]


def test_the_check_at_zero_load_says_how_far_the_part_moves(browser, client):
    measured(client, "moved", 0, 100)
    reply = client.call_json("GET", "/v1/components/moved/compliance")
    names = ("ux", "uy", "uz", "rx", "ry", "rz")
    zero = {"ok": False, "rows": [1], "displacement": dict.fromkeys(names, 2e-5)}
    reply |= {"rows_checked": 2, "checks": {"zero_at_zero_load": zero}}
    browser.visit("#/terms")
    browser.one("h1")
    browser.run(STUB, json.dumps([["/compliance", reply]]))
    browser.go("#/c/moved/checks")
    shown = browser.text("tr", "zero load").replace("\u00a0", " ")
    assert "Largest displacement u (20, 20, 20) µm, r (20, 20, 20) µrad" in shown


def test_a_displacement_at_zero_load_within_the_noise_is_not_called_broken(browser, client):
    measured(client, "noisy", 0, 100)
    reply = client.call_json("GET", "/v1/components/noisy/compliance")
    names = ("ux", "uy", "uz", "rx", "ry", "rz")
    zero = {"ok": None, "rows": [], "displacement": dict.fromkeys(names, 2e-5)}
    zero["reason"] = "within the noise of the readings"
    reply |= {"rows_checked": 2, "checks": {"zero_at_zero_load": zero}}
    browser.visit("#/terms")
    browser.one("h1")
    browser.run(STUB, json.dumps([["/compliance", reply]]))
    browser.go("#/c/noisy/checks")
    shown = browser.text("tr", "zero load")
    assert shown.startswith("not known yet")
    assert "20) µrad; within the noise of the readings" in shown


def test_rows_of_one_wrench_that_disagree_are_links_in_the_overview(browser, client):
    measured(client, "disputed", 100, 300)
    header = f"{LOADS},uz [mm]"
    kind = {"Content-Type": "text/csv"}
    again = f"{header}\n0,0,100,0,0,0,0.2".encode()
    client.call("POST", "/v1/components/disputed/table", content=again, headers=kind)
    browser.visit("#/c/disputed")
    browser.until(
        lambda: len(browser.named("dd", "rows that disagree").find_elements("tag name", "a")) == 2
    )


def test_missing_loads_are_counted_as_zero_by_a_button(browser, rig):
    browser.visit("#/c/unmeasured/table")
    browser.drop(".drop", "pull.csv", "fz [N],uz [mm]\n100,0.1\n")
    browser.click("#zero-loads")
    browser.named(".note", "1 row read without mistakes")


def test_a_row_outside_the_load_range_is_told_before_the_import(browser, rig):
    browser.visit("#/c/unmeasured/table")
    browser.drop(".drop", "far.csv", f"{LOADS},uz [mm]\n0,0,100,0,0,0,0.1\n0,0,700,0,0,0,0.7\n")
    browser.named(".note.thin", "1 row is outside the load range")
    assert browser.text("#import") == "Import 2 rows"


def test_the_error_of_a_bad_name_stands_at_its_field(browser, client):
    browser.visit("#/add")
    browser.type("#new-name", "Bad Name!")
    for size in browser.all("form input[type=number]"):
        size.send_keys("10")
    browser.click("form button", "Add the table")
    assert "cannot be used" in browser.text("#name-error")
    assert browser.run("return document.activeElement.id") == "new-name"


def test_a_component_is_filled_for_a_planned_scene(browser, client):
    browser.visit("#/scene")
    browser.click("label", "spring")
    browser.click("form button", "Plan")
    browser.click(".cards button", "Fill for this scene")
    browser.named("#notices", "queued")
    assert client.call_json("GET", "/v1/jobs?component=spring")["jobs"]


def test_the_example_of_a_bundle_is_added_as_it_stands(browser, client, tmp_path):
    browser.visit("#/add")
    browser.click("summary", "An example")
    path = tmp_path / "cantilever.zip"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("component.toml", browser.text("details pre"))
    add(browser, path)
    assert client.component("cantilever")["warnings"] == []


def test_the_terms_of_an_answer_are_explained(browser):
    browser.visit("#/terms")
    browser.named("h1", "Terms")
    terms = {item.text for item in browser.all("dl.terms dt")}
    assert {"Wrench", "Interface", "Error bar", "Covered", "Thin", "Outside"} <= terms
    assert {"Table version", "Packed table", "Axis x, y, z", "Demand"} <= terms


def test_a_compliance_has_one_power_of_ten_and_no_entry_is_cut_on_a_telephone(browser, plate):
    browser.resize(390, 900)
    browser.visit(f"{PLATE}/checks")
    browser.named("p", "m or rad per N or N·m")
    wide = browser.one(".wide")
    assert browser.run("return arguments[0].scrollWidth - arguments[0].clientWidth", wide) <= 0
    assert "·10" not in wide.text


def test_entries_and_eigenvalues_that_the_rows_do_not_determine_are_question_marks(browser, plate):
    reply = plate.call_json("GET", "/v1/components/plate_thin/compliance")
    reply["matrix"] = np.eye(6).tolist()
    reply["matrix"][0][0] = -1.0
    reply["matrix"][1][5], reply["matrix"][5][1] = 0.85, 1.0
    reply["matrix"][2][4], reply["matrix"][4][2] = 0.95, 1.0
    reply["checks"]["positive"] |= {"ok": True, "smallest_over_largest_eigenvalue": -0.01}
    browser.visit("#/terms")
    browser.one("h1")
    browser.run(STUB, json.dumps([["/compliance", reply]]))
    browser.go(f"{PLATE}/checks")
    mean = browser.named("section", "Mean compliance")
    cells = mean.find_elements("css selector", "td")
    unknown = {
        divmod(k, 6): cell.get_attribute("title")
        for k, cell in enumerate(cells)
        if cell.text == "?"
    }
    assert set(unknown) == {(0, 0), (1, 5), (5, 1)}
    assert all("the rows do not determine it yet" in title for title in unknown.values())
    assert browser.text("tr", "positive work").startswith("not known yet")


def test_an_asymmetry_that_the_rows_cannot_tell_is_not_called_broken(browser, plate):
    reply = plate.call_json("GET", "/v1/components/plate_thin/compliance")
    reason = "within the uncertainty of the fit"
    reply["checks"]["symmetric"] |= {"ok": None, "asymmetry": 0.2, "reason": reason}
    browser.visit("#/terms")
    browser.one("h1")
    browser.run(STUB, json.dumps([["/compliance", reply]]))
    browser.go(f"{PLATE}/checks")
    shown = browser.text("tr", "symmetric")
    assert shown.startswith("not known yet")
    assert "asymmetry 20 %, allowed 5 %; within the uncertainty of the fit" in shown.lower()


def test_a_wrench_beyond_the_load_range_says_so_first_and_can_be_solved(browser, client):
    browser.visit("#/c/plate/shape")
    browser.type("input[name=fx]", "1500")
    browser.click("form button", "Show")
    browser.named(".note", "Fx = 1500 N is outside the load range, −1000 to 1000 N.")
    browser.click("button", "Solve it nevertheless")
    browser.drawn("#shape")


def test_a_file_that_is_no_table_offers_no_mending(browser, rig):
    browser.visit("#/c/unmeasured/table")
    browser.drop(".drop", "notes.csv", "")
    browser.named(".note", "notes.csv is not read as a table; nothing was loaded.")
    assert browser.all("#check-again") == []


def test_a_drawing_has_the_layout_of_a_turned_telephone(browser, plate):
    browser.resize(390, 740)
    browser.visit(f"{PLATE}/shape")
    browser.drawn("#shape")
    bar = "return document.querySelector('#shape')._fullData[0].colorbar.orientation"
    assert browser.run(bar) == "h"
    browser.resize(740, 390)
    browser.until(lambda: browser.run(bar) == "v")
    size = "return document.querySelector('#shape')._fullLayout.width"
    browser.until(lambda: browser.run(size) > 600)


def test_numbers_of_faces_at_one_place_are_one_text(browser, client):
    browser.visit(f"{PLATE}/faces")
    browser.drawn("#faces")
    texts = browser.run(
        "return document.querySelector('#faces').data.filter((one) => one.type !== 'mesh3d')"
        ".map((one) => one.text[0])"
    )
    numbers = [number for text in texts for number in re.findall(r"\d+", text)]
    assert sorted(map(int, numbers)) == list(range(1, len(texts) + 1))
    assert any(", " in text for text in texts)  # both sides of the thin plate


# Answers calls whose address has a text, and keeps their bodies; all others go to the server.
STUB = """const own = window.fetch; window.sent = [];
window.fetch = (to, how) => {
  const [, reply] = JSON.parse(arguments[0]).find(([text]) => String(to).includes(text)) || [];
  if (reply === undefined) return own(to, how);
  if (how.body) window.sent.push(JSON.parse(how.body));
  return Promise.resolve(new Response(JSON.stringify(reply)));
};"""

# Refuses the calls of a method, all or those whose address has a text.
REFUSED = """const before = window.fetch, [method, text = ""] = arguments;
window.fetch = (to, how) => {
  if (how.method !== method || !String(to).includes(text)) return before(to, how);
  const problem = { title: "Busy", detail: "The server is busy." };
  return Promise.resolve(new Response(JSON.stringify(problem), { status: 503 }));
};"""


def test_a_fill_goes_on_round_by_round_to_the_number_of_solves_that_was_given(browser, client):
    browser.visit("#/c/plate")
    browser.one("#fill")
    replies = [
        ["/fill", {"jobs": [{"id": 1}, {"id": 2}], "reason": "the largest errors first"}],
        ["v1/jobs/", {"status": "done"}],
    ]
    browser.run(STUB, json.dumps(replies))
    browser.type("form input[type=number]", "5")
    browser.click("#fill")
    browser.named("span", "The budget is spent.")
    assert browser.run("return window.sent") == [{"budget": 5}, {"budget": 3}, {"budget": 1}]


def test_the_first_bar_of_the_coverage_has_its_own_legend(browser, plate):
    browser.visit(PLATE)
    browser.until(lambda: len(browser.all(".legend")) == 2)
    first, second = (item.text for item in browser.all(".legend"))
    assert "over it or not known" in first
    assert "thin" in second


def test_a_component_toml_alone_is_dropped_and_added(browser, client):
    text = (ROOT / "data/components/bar/component.toml").read_text()
    text = text.replace('name = "bar"', 'name = "alone"')
    browser.visit("#/add")
    browser.drop(".drop", "component.toml", text)
    browser.click("button", "Add the bundle")
    browser.named("h1", "alone")
    assert client.component("alone")["has_fea"]


def test_a_refused_key_leaves_the_one_that_worked(browser, client):
    browser.visit("#/")
    browser.one(".card.library")
    before = browser.run("return sessionStorage.getItem('wrenchbook-key')")
    browser.run(
        "const own = window.fetch; window.fetch = (to, how) => how.headers.Authorization === "
        "arguments[0] ? own(to, how) : Promise.resolve(new Response('{}', {status: 401}))",
        f"Bearer {before}",
    )
    browser.click("#key")
    browser.type("dialog input", "wb_wrong")
    browser.click("dialog button", "Use this key")
    browser.named("dialog .note", "refuses this key")
    assert browser.run("return sessionStorage.getItem('wrenchbook-key')") == before


def test_the_preview_of_an_import_names_the_units_of_the_file(browser, rig):
    browser.visit("#/c/unmeasured/table")
    header = LOADS.replace("Fz [N]", "Fz [kN]")
    browser.drop(".drop", "kilo.csv", f"{header},uz [mm]\n0,0,0.1,0,0,0,0.1\n")
    head = browser.text("#preview thead")
    assert "Fz, N (file: kN)" in head
    assert "uz, m (file: mm)" in head
    assert "Fx, N (file" not in head


def test_one_import_of_a_table_without_solves_has_nothing_to_be_compared_with(browser, client):
    measured(client, "singly_imported", 100, 200)
    browser.visit("#/c/singly_imported/compare")
    browser.named(".empty", "Compare needs two imports")


FEW_ROWS = """return import('/page/js/shares.js').then(({ wholeError }) => wholeError(
  { whole: [0, 1, 0], within_tolerance: 0, error: Array(6).fill(null) },
  { name: 'plate', has_fea: true, jobs: arguments[0] }).innerHTML)"""


def test_a_table_without_error_bars_names_its_open_solves_and_links_to_them(browser):
    browser.visit("#/terms")
    at_work = browser.run(FEW_ROWS, {"waiting": 3, "running": 2, "done": 4})
    assert '<a href="#/c/plate/jobs">3 waiting, 2 running</a>' in at_work
    assert "Fill the table" not in at_work
    assert "Fill the table" in browser.run(FEW_ROWS, {"waiting": 0, "done": 4})


def test_a_query_beyond_the_range_names_the_range_once(browser, client):
    browser.visit("#/c/plate/query")
    # No other test solves this wrench.
    browser.type("input[name=fx]", "-1800")
    browser.click("form button", "Ask")
    browser.named(".note", "no solve is queued for it")
    assert browser.text("main").count("is outside the load range") == 1


def test_loads_of_the_outermost_cell_of_the_demand_are_bounds(browser, client):
    client.call_json(
        "POST",
        "/v1/components/plate/displacement",
        {"force": [-3000, 0, 0], "on_thin": "estimate"},
    )
    browser.visit("#/c/plate/demand")
    browser.named("td", "F (≤ −1900, 0, 0) N")


def test_a_load_of_the_demand_is_the_interval_that_its_cell_counts(browser, client):
    client.call_json(
        "POST",
        "/v1/components/plate/displacement",
        {"force": [0, 0, -1000], "on_thin": "estimate"},
    )
    browser.visit("#/c/plate/demand")
    browser.named("td", "F (0, 0, −1500 to −500) N")


@pytest.fixture(scope="module")
def beyond(client):
    """A component for measured rows with one row outside its load range."""
    measured(client, "beyond", 100, 200, 300, 6000)
    return "#/c/beyond"


@pytest.mark.parametrize("view", ["rows", "overview"])
def test_a_row_outside_the_load_range_has_one_word_in_all_views(browser, beyond, view):
    browser.visit(f"{beyond}/{view}")
    browser.named(".pill", "outside the range, not used")


@pytest.mark.parametrize(("view", "place"), [("response", "#response"), ("coverage", "#coverage")])
def test_a_drawing_leaves_a_row_outside_the_load_range_out_and_says_so(
    browser, beyond, view, place
):
    browser.visit(f"{beyond}/{view}")
    browser.drawn(place)
    browser.named("main", "1 row outside the range, not used and not drawn")
    script = f"return document.querySelector('{place}').data.flatMap((one) => [...(one.x || [])])"
    assert max(map(abs, filter(None, browser.run(script)))) <= 700


def test_the_checks_do_not_count_a_row_outside_the_load_range(browser, beyond, client):
    assert client.call_json("GET", "/v1/components/beyond/compliance")["rows_checked"] == 0
    browser.visit(f"{beyond}/checks")
    browser.named("main", "outside the range, not used")


ROUNDED = """return import('/page/js/format.js').then(({ withBar }) => {
  const { value, bar } = withBar(...arguments[0]);
  return `${value} ${bar}`; })"""


@pytest.mark.parametrize(
    ("pair", "text"),
    [
        ([1.62345e-3, 1.1e-4, "m"], "1.62 mm ± 0.11 mm"),
        ([0.287e-3, 11e-6, "m"], "287 µm ± 11 µm"),
        ([543e-3, 120e-3, "m"], "540 mm ± 120 mm"),
        ([3e-9, 1.2e-6, "m"], "0.0 µm ± 1.2 µm"),
    ],
)
def test_a_value_is_rounded_to_the_last_digit_of_its_bar(browser, pair, text):
    browser.visit("#/terms")
    assert browser.run(ROUNDED, pair) == text


ALIGNED = """return import('/page/js/format.js').then(({ aligned, withBar }) =>
  aligned(arguments[0].map(([value, bar]) => withBar(value, bar, "m", 2.4e-3).value)))"""


def test_displacements_of_one_kind_have_one_unit_and_their_points_below_each_other(browser):
    browser.visit("#/terms")
    pairs = [[-2.4e-3, 1e-5], [3e-8, 2e-6], [0, 0], [None, None]]
    texts = browser.run(ALIGNED, pairs)
    assert texts == ["−2.400\u2007 mm", "0.0000 mm", "0\u2008\u2007\u2007\u2007\u2007 mm", "–"]


def test_a_bar_below_the_last_digit_of_a_column_is_rounded_up(browser):
    browser.visit("#/terms")
    assert browser.run(ROUNDED, [0, 2e-9, "m", 2.4e-3]) == "0.0000 mm ± 0.0001 mm"


def test_all_rows_have_their_displacements_in_one_unit(browser, plate):
    browser.visit("#/c/plate_thin/rows")
    browser.one("tbody .six")
    units = "return [...document.querySelectorAll('tbody td:nth-child(4) .six > :nth-child(5)')]"
    assert set(browser.run(f"{units}.map((one) => one.textContent)")) == {"mm"}


def test_a_load_that_no_row_varies_is_outside_the_rows_in_an_answer(browser, strut):
    lines = "".join(f"0,0,{force},{force * 1e-6}\n" for force in range(-250, 251, 50))
    about = {"name": "one_load", "title": "Rig", "range": {"force": [300] * 3, "moment": [0] * 3}}
    strut.call_json("POST", "/v1/components", about)
    path = "/v1/components/one_load/table?missing_loads=zero"
    content = f"Fx [N],Fy [N],Fz [N],uz [m]\n{lines}".encode()
    strut.call("POST", path, content=content, headers={"Content-Type": "text/csv"})
    strut.component("one_load", wait_s=60)
    browser.visit("#/c/one_load/query")
    browser.type("input[name=fx]", "100")
    browser.click("form button", "Ask")
    browser.named(".pill", "outside the rows")
    browser.named(".note", "No row shows the influence of Fx")


def test_a_view_that_the_server_did_not_answer_is_shown_when_it_is_back(browser, client):
    browser.visit("#/terms")
    browser.one("main h1")
    browser.run("window.own = fetch; window.fetch = () => Promise.reject(new TypeError('gone'))")
    browser.run("location.hash = '#/c/plate/checks'")
    browser.named(".note", "No connection")
    browser.run("window.fetch = window.own")
    browser.named("h1", "plate")


def test_a_missing_key_can_be_entered_where_the_view_would_be(browser, client):
    browser.visit("#/terms")
    browser.one("main h1")
    browser.run("window.fetch = () => Promise.resolve(new Response('{}', {status: 401}))")
    browser.run("location.hash = '#/c/plate'")
    browser.click("dialog button", "Cancel")
    browser.click(".note button", "Enter a key")
    browser.one("dialog input")


def test_a_wrench_beyond_the_range_is_solved_nevertheless_by_a_button(browser, client):
    browser.visit("#/c/plate/query")
    browser.type("input[name=fx]", "-1700")
    browser.click("form button", "Ask")
    browser.click("button", "Solve it nevertheless")
    browser.one("#watched")


def test_a_job_outside_the_load_range_says_how_far_and_that_the_part_yields(browser, plate):
    told = job(7, "done", translation=[0, 0, 0.05], rotation=[0, 0, 0], created=None)
    told |= {"force": [0, 0, -25000.0], "actor": None, "finished": None}
    told["notes"] = ["3 % of the part's volume is above its yield strength, up to 22.9 times"]
    browser.visit("#/terms")
    browser.one("h1")
    browser.run(STUB, json.dumps([["v1/jobs/7", told]]))
    browser.go("#/jobs/7")
    browser.named(".pill", "outside the load range")
    browser.named(".note.outside", "times the load range")
    browser.named(".note.thin", "The part yields")


def test_a_response_runs_along_a_load_with_a_range_alone(browser, strut):
    browser.visit("#/c/pull_strut/response")
    browser.drawn("#response")
    assert browser.text(".choice") == "Fz"
    key = browser.text(".key-of-marks")
    assert "row of the table" in key
    assert "thin" not in key  # all is covered
    assert "outside" not in key


def test_the_other_loads_of_a_response_leave_the_drawn_one_out(browser, client):
    measured(client, "others", 100, 200)
    browser.visit("#/c/others/response")
    browser.drawn("#response")
    browser.click("#other-loads summary", "Other loads: 0")
    assert not browser.one("#other-loads").find_element("name", "fz").is_displayed()
    browser.type("#other-loads input[name=fx]", "50")
    browser.click("#other-loads button", "Apply")
    browser.named("#other-loads summary", "Other loads: Fx 50 N")


def test_the_coverage_of_one_load_has_no_picture_in_space(browser, strut):
    browser.visit("#/c/pull_strut/coverage")
    text = browser.text("section", "Coverage of this axis")
    assert "none of them with loads of other axes too, span 1 dimension." in text
    assert not browser.all("#coverage")
    assert browser.text(".choice") == "axis z"
    browser.click("a.button", "Show the response")
    browser.drawn("#response")


def test_a_compliance_of_one_load_has_the_measured_entry_alone(browser, strut):
    browser.visit("#/c/pull_strut/checks")
    mean = browser.named("section", "Mean compliance")
    assert len(mean.find_elements("css selector", "td")) == 1
    assert "fitted from 61 rows" in mean.text
    assert "?" not in mean.text
    assert "Not in the rows: ux, uy, rx, ry, rz, Fx, Fy, Mx, My, Mz." in mean.text


def test_a_measured_stiffness_is_rounded_to_its_bar_and_has_units(browser, strut):
    browser.visit("#/c/pull_strut/table")
    browser.type("#stiffness-low", "-200")
    browser.type("#stiffness-high", "200")
    browser.click("#stiffness-ask")
    table = browser.one("#stiffness table")
    heads = [item.text for item in table.find_elements("css selector", "th")]
    assert heads[2:5] == ["Slope, N/m", "± 95 %, N/m", "Residual, N"]
    cells = [item.text for item in table.find_elements("css selector", "tbody tr:first-child td")]
    assert re.fullmatch(r"\d+00", cells[2])
    assert re.fullmatch(r"\d\d00", cells[3])


def test_an_answer_with_unmeasured_outputs_says_how_many_and_has_a_tolerance(browser, strut):
    """Its pill said that the error bar is unknown, although that of uz is known."""
    browser.visit("#/c/pull_strut/query")
    ask(browser, fz=-150)
    browser.named(".pill", "covered; 5 outputs not measured")
    assert "Of the tolerance" in browser.text("table.answer")
    uz = browser.text("table.answer tbody tr:nth-child(3)")
    assert re.search(r"± 0\.\d+ µm \d+(\.\d+)? %", uz)
    assert "The error bar is unknown" not in browser.text("main")


def test_a_query_beyond_the_range_has_one_note_with_its_button(browser, plate):
    browser.visit(f"{PLATE}/query")
    ask(browser, fz=-2600)
    note = browser.named(".note.outside", "outside the load range, −2000 to 2000 N; no solve is")
    assert note.find_element("css selector", "button").text == "Solve it nevertheless"
    assert len(browser.all(".note.outside")) == 1


def test_a_header_without_known_columns_counts_its_decisions_in_words_of_the_page(browser, rig):
    browser.visit("#/c/unmeasured/table")
    browser.drop(".drop", "pull.csv", "Load [N],Gauge [mm]\n1,0.1\n")
    browser.named(".note.outside", "the header needs 3 decisions")
    told = browser.text("#mistakes")
    assert len(browser.all("#mistakes li")) == 3
    assert "Load [N], Gauge [mm]: are not known columns" in told
    assert "add the log of the displacements under “Two logs”" in told
    assert "displacements=FILE" not in told


def test_a_table_without_rows_has_no_version(browser, rig):
    browser.visit("#/c/unmeasured/table")
    browser.named("#imports", "Nothing was imported yet.")
    assert "table version" not in browser.text("#imports")


def test_the_audit_has_seconds_and_names_a_failure_as_the_jobs_do(browser, client):
    shown = audit_of(browser, action="job.fail", object="7", after={"kind": "snap_through"})
    assert "00:00:00 UTC" in shown
    assert shown.endswith("kind buckling or snap-through")


def test_no_name_of_a_component_is_broken_in_the_audit(browser, client):
    audit_of(browser, action="component.add", object="unmeasured_rig", component="unmeasured_rig")
    link = browser.one("#entry-1 td:nth-child(4) a")
    assert len(browser.run("return arguments[0].getClientRects()", link)) == 1


@pytest.mark.parametrize("width", [762, 800])
def test_the_list_of_jobs_fits_a_narrow_window(browser, plate, width):
    browser.resize(width, 900)
    browser.visit("#/jobs")
    browser.one("table.jobs tr[id]")
    assert browser.run("return document.documentElement.scrollWidth") <= width


def test_the_overview_says_what_a_report_of_few_wrenches_proves(browser, plate):
    report = doubtful(plate) | {"wrenches": {"compared": 5}}
    report["tables"][0]["beyond_error_bar"]["missed"] = 0
    browser.visit("#/terms")
    browser.one("h1")
    browser.run(STUB, json.dumps([["format=state", {"state": "done"}], ["/report", report]]))
    browser.go(PLATE)
    browser.named(
        "section", "with 5 wrenches, at least 55 % of each output's true errors do so with 95 %"
    )


def test_the_field_of_a_running_report_has_its_number_of_wrenches(browser, reported):
    browser.visit("#/terms")
    browser.one("h1")
    state = {"state": "running", "fraction": 0.2, "message": "solves", "wrenches": 5}
    browser.run(STUB, json.dumps([["format=state", state]]))
    browser.go(f"{REPORTED}/report")
    browser.one("#cancel-report")
    assert browser.attribute("form input[type=number]", "value") == "5"


def test_triangles_without_an_area_draw_no_edges_on_a_flat_face(browser, client):
    """The simplified surface of a plate had dashes and doubled rings."""
    points = [[0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0], [1, 0, 0], [1, -1, 0]]
    triangles = [[0, 1, 2], [0, 2, 3], [0, 5, 4], [4, 5, 1], [0, 4, 1]]  # the last one is a line
    browser.visit("#/terms")
    script = "return (await import('/page/js/surface.js')).outline(...arguments[0])"
    edges = browser.run(script, [points, triangles])
    assert {tuple(edge) for edge in edges} == {(0, 3), (0, 5), (1, 2), (1, 5), (2, 3)}


def test_a_message_that_names_the_first_of_equal_mistakes_is_not_cut_before_it(browser, client):
    errors = [{"loc": f"range.force.{k}", "msg": "must be 0 or more"} for k in range(2)]
    detail = "Nothing was changed. 2 mistakes; the first is range.force.0: must be 0 or more."
    browser.visit("#/terms")
    script = """const { Problem, trouble } = await import("/page/js/api.js");
    return trouble(new Problem(422, arguments[0])).querySelector("span").textContent"""
    assert browser.run(script, {"detail": detail, "errors": errors}) == detail


# -- outputs that no row has ----------------------------------------------------------------------


@pytest.fixture(scope="module")
def gauge(client):
    """A measured component with one load and one gauge, whose readings have noise."""
    about = {"name": "gauge", "title": "Strut", "range": {"force": [0, 0, 300], "moment": [0] * 3}}
    client.call_json("POST", "/v1/components", about)
    force = np.round(300 * np.sin(2 * np.pi * np.arange(80) / 40), 2)
    noise = np.random.default_rng(2).normal(0, 5e-4, len(force))
    lines = [f"0,0,{f},0,0,0,{f / 2000 + e:.6f}" for f, e in zip(force, noise, strict=True)]
    client.import_table("gauge", "\n".join([f"{LOADS},uz [mm]", *lines]).encode())
    client.component("gauge", wait_s=60)
    return client


def test_an_output_that_no_row_has_is_not_measured_in_an_answer(browser, gauge):
    """The answer printed 0 m for null."""
    browser.visit("#/c/gauge/query")
    ask(browser, fz=-150)
    shown = browser.text("table.answer")
    assert shown.count("not measured") == 5
    assert "0 m" not in shown.split("not measured")[0]
    pill = browser.text("section .pill")
    assert pill.startswith("covered")
    assert "unknown" not in pill


def test_an_output_that_no_row_has_cannot_be_chosen_for_a_response(browser, gauge):
    browser.visit("#/c/gauge/response")
    browser.drawn("#response")
    disabled = "input[name=output]:disabled"
    assert [one.get_attribute("value") for one in browser.all(disabled)] == [
        "ux",
        "uy",
        "rx",
        "ry",
        "rz",
    ]


def test_a_response_draws_and_counts_only_the_rows_that_have_its_output(browser, client):
    """Rows without ux were circles at ux = 0."""
    measured(client, "halves", 100, 200, 300)
    rows = "\n".join([f"{LOADS},ux [mm]", *(f"0,0,{f},0,0,0,{f}e-3" for f in (150, 250))])
    client.import_table("halves", rows.encode())
    browser.visit("#/c/halves/response")
    browser.named("main p", "3 rows lie on this line")
    drawn = browser.run("return document.querySelector('#response').data.at(-1).y")
    assert sorted(value is None for value in drawn) == [False] * 3 + [True] * 2


@pytest.mark.parametrize(("address", "title"), [("#/", "gauge"), ("#/c/gauge", "Coverage")])
def test_a_bar_that_no_tolerance_was_compared_with_is_called_covered(
    browser, gauge, address, title
):
    """Library and overview printed "within tolerance 100 %"; the reply had null."""
    browser.visit(address)

    def text_with_the_bar():
        text = browser.text(".card", title)
        return "Median error bar" in text and text

    shown = browser.until(text_with_the_bar)
    assert "covered" in shown
    assert "within tolerance" not in shown
    assert re.search(r"interpolation and noise \d+ nm$", shown, re.MULTILINE)


def test_the_overview_names_the_outputs_that_no_row_has(browser, gauge):
    browser.visit("#/c/gauge")
    browser.named("main", "Not measured")
    shown = browser.text("section", "Not measured").replace("\u00a0", " ")
    assert "ux, uy, rx, ry, rz" in shown
    tolerance = browser.named("dd", "of each output's range: u")
    assert "u (–, –, " in tolerance.text.replace("\u00a0", " ")
    assert "Contradictions" not in browser.text("main")


def test_an_answer_beyond_few_rows_is_muted_and_called_extrapolated(browser, client):
    """One row answered a wrench within the load range in full ink, with "outside" alone."""
    measured(client, "single", 100)
    browser.visit("#/c/single/query")
    ask(browser, fz=200)
    browser.named(".note", "Extrapolated from 1 row; its error is not known.")
    assert browser.text("section .pill") == "outside the rows"
    assert browser.all("table.answer.guess")
    ask(browser, fz=700)
    browser.until(lambda: browser.text("section .pill") == "outside the load range")


def test_a_reason_of_two_sentences_has_two_capital_letters(browser, client):
    measured(client, "capital", 100)
    browser.visit("#/c/capital/query")
    ask(browser, fz=100)
    assert "exactly this wrench. The rows" in browser.text(".note", "exactly this wrench")


def test_the_gaps_of_the_coverage_are_called_those_within_the_hull(browser, plate):
    browser.visit(f"{PLATE}/coverage")
    browser.named("h2", "Largest gaps within the hull")


# -- solves at work -------------------------------------------------------------------------------


def test_an_answer_and_its_queued_solve_are_there_again_after_another_view(browser, plate):
    answer = {"translation": None, "rotation": None, "error": None, "coverage": "thin"}
    answer |= {"within_tolerance": None, "source": None, "method": "", "table_version": 1}
    answer |= {"elapsed_us": 1.0, "job": {"id": 77, "status": "waiting"}}
    browser.visit("#/terms")
    browser.one("h1")
    browser.run(STUB, json.dumps([["/displacement", answer]]))
    browser.run(
        "const stub = window.fetch; window.fetch = (to, how) =>"
        " String(to).includes('v1/jobs/77') ? new Promise(() => {}) : stub(to, how);"
    )
    browser.go(f"{PLATE}/query")
    ask(browser, fz=-987)
    browser.named("#watched", "Job 77")
    browser.go(PLATE)
    browser.named("h2", "Coverage")
    browser.go(f"{PLATE}/query")
    browser.named("#watched", "Job 77")
    assert len(browser.run("return window.sent")) == 1


def test_an_open_overview_follows_the_states_of_jobs(browser, client):
    """It showed the jobs of its first moment until rows arrived."""
    browser.visit("#/c/plate")
    browser.named("section", "Method and rows")
    browser.one("main .shares, main .halves p")
    cancelled = client.component("plate")["jobs"].get("cancelled", 0)
    order = {"force": [0, 0, -20.0], "moment": [0, 0, 0]}
    job = client.call_json("POST", "/v1/components/plate/solve", order)["job"]
    client.call("DELETE", f"/v1/jobs/{job['id']}")
    browser.named("dd .pill", f"{cancelled + 1} cancelled")


def test_a_fill_counts_its_solves_in_one_sentence_and_links_to_them(browser, client):
    browser.visit("#/c/plate")
    browser.one("#fill")
    queued = {"jobs": [{"id": 1}, {"id": 2}], "reason": "2 of at most 24 solves: the largest first"}
    browser.run(STUB, json.dumps([["/fill", queued], ["v1/jobs/", {"status": "done"}]]))
    browser.type("form input[type=number]", "2")
    browser.click("#fill")
    browser.named("span", "2 solves queued (at most 2): 2 done. The budget is spent.")
    browser.named("span", "The largest first")
    assert browser.attribute("main a", "href", "Show the jobs").endswith("#/c/plate/jobs")


def test_a_fill_that_queues_nothing_has_no_bar_and_says_why(browser, client):
    browser.visit("#/c/plate")
    browser.one("#fill")
    reason = "the interpolation error of 100 % of the range is within the tolerance"
    browser.run(STUB, json.dumps([["/fill", {"jobs": [], "reason": reason}]]))
    browser.click("#fill")
    browser.named("p", "No solve is queued: The interpolation error of 100 %")
    assert not browser.all("main section progress")


def test_a_card_has_the_open_solves_and_the_verdict_of_the_report(browser, plate):
    """While a fill ran, its card advised to fill the table."""
    glance = {"whole": [0, 1, 0], "error": [None] * 6, "interpolation": [None] * 6}
    glance |= {"within_tolerance": 0, "bars_are_whole": True, "axes": {}}
    about = plate.component("plate_thin") | {"jobs": {"running": 2}}
    browser.visit("#/terms")
    browser.one("h1")
    replies = [["/plate_thin/glance", glance], ["format=state", {"state": "done"}]]
    surface = plate.call_json("GET", "/v1/components/plate_thin/surface")
    replies += [["/report", doubtful(plate)], ["/surface", surface]]
    replies += [["components/plate_thin", about]]
    browser.run(STUB, json.dumps(replies))
    browser.go("#/")
    card = browser.named(".card.library", "2 running")
    assert "Fill the table" not in card.text
    browser.until(lambda: "The latest report warns of the error bars" in card.text)


def test_a_shape_names_its_frame_and_the_displacement_of_its_interface(browser, plate):
    """The points are in the interface frame; the text named the axes of the mesh."""
    browser.visit(f"{PLATE}/shape")
    browser.drawn("#shape")
    shown = browser.text("dl.facts")
    assert "In the interface frame" in shown
    assert re.search(r"Interface\s+u \(.*mm \(Query\)", shown.replace("\u00a0", " "))


# Answers the list of components, and nothing else.
LISTED = """const own = window.fetch; window.fetch = (to, how) =>
  String(to).endsWith('v1/components') ? Promise.resolve(new Response(arguments[0])) : own(to, how);
"""


def show_earlier(browser, gauge, **changed):
    """Open the library whose list was read before the present table; return the component."""
    about = gauge.component("gauge")
    earlier = {"components": [about | {"table_version": 0, **changed}], "next": None, "broken": []}
    browser.run(LISTED, json.dumps(earlier))
    browser.go("#/")
    return about


def test_a_card_shows_the_rows_that_arrived_before_the_page_listened(browser, gauge):
    """It said "empty table" until the next row."""
    browser.visit("#/terms")
    browser.one("h1")
    about = show_earlier(browser, gauge, rows=0)
    browser.named(".card.library", f"{about['rows']} rows")
    browser.named(".card.library", "Median error bar")


def test_a_slow_reply_on_an_earlier_table_does_not_replace_that_on_a_later_one(browser, gauge):
    browser.visit("#/terms")
    browser.one("h1")
    # The first glance is of a table without a covered wrench, and comes after the second.
    browser.run(
        "const own = window.fetch; window.glances = 0; window.fetch = async (to, how) => {"
        " const reply = await own(to, how); if (!String(to).includes('/glance')) return reply;"
        " window.glances += 1; if (window.glances > 1) return reply;"
        " const body = await reply.json(); body.whole = [0, 0, 1]; body.within_tolerance = 0;"
        " await new Promise((go) => { window.release = go; });"
        " return new Response(JSON.stringify(body)); }"
    )
    show_earlier(browser, gauge)
    browser.named(".card.library", "Median error bar")
    shown = browser.text(".card.library")
    assert "\n0 %" not in shown
    browser.run("window.release(); await new Promise((go) => setTimeout(go, 100));")
    assert browser.text(".card.library") == shown
