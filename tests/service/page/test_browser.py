"""What people do with the page, in headless Chromium, on a real server with a real solver."""

import re
import zipfile
from pathlib import Path

import pytest
from selenium.webdriver.common.keys import Keys

pytestmark = pytest.mark.browser

BAR = Path(__file__).parents[3] / "data" / "components" / "bar" / "component.toml"
VIEWS = (
    "overview",
    "query",
    "shape",
    "rows",
    "coverage",
    "response",
    "checks",
    "report",
    "jobs",
    "table",
    "demand",
    "settings",
)
PLATE = "#/c/plate_thin"
LOADS = "Fx [N],Fy [N],Fz [N],Mx [Nm],My [Nm],Mz [Nm]"
MEASURED = f"""{LOADS},ux [mm],uy [mm],uz [mm],rx [deg],ry [deg],rz [deg]
0,0,0,0,0,0,0,0,0,0,0,0
0,0,-100,0,0,0,0,0,-0.1,0,0,0
0,0,-200,0,0,0,0,0,minus 0.2,0,0,0
0,0,-300,0,0,0,0,0,-0.3,0,0,0
0,0,-400,0,0,0,0,0,,0,0,190
0,0,-500,0,0,0,0,0,-0.5,0,0,0
"""


@pytest.fixture(scope="module")
def plate(client):
    """`plate_thin` with one row, and so with a surface."""
    client.solve("plate_thin", [0, 0, -900.0], [0, 0, 0], wait_s=120)
    assert client.component("plate_thin", wait_s=60)["rows"] == 1
    return client


def bundle(folder, name, **changed):
    """Zip the bundle of a coarse bar, solved in a moment, some of its keys changed."""
    text = BAR.read_text().replace('name = "bar"', f'name = "{name}"')
    for key, value in {"cells_along": 4, "cells_across": 2, **changed}.items():
        text = re.sub(f"(?m)^{key} = .*$", f"{key} = {value}", text)
    path = folder / f"{name}.zip"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("component.toml", text)
    return path


def add(browser, path):
    """Upload a bundle, and wait for its page."""
    browser.visit("#/add")
    browser.one("#bundle").send_keys(str(path))
    browser.click("button", "Add the bundle")
    browser.named("h1", path.stem)


def ask(browser, action="Ask", **loads):
    """Type loads, all others zero, and send them; each one typed draws the arrows anew."""
    for name in ("fx", "fy", "fz", "mx", "my", "mz"):
        field, text = f"input[name={name}]", str(loads.get(name, 0))
        if browser.one(field).get_attribute("value") != text:
            browser.type(field, text)
    browser.click("form button", action)


def test_an_uploaded_part_is_queued_solved_and_then_covered(browser, client, tmp_path):
    add(browser, bundle(tmp_path, "rod", nonlinear="true"))
    browser.click("nav.tabs a", "Query")
    ask(browser, fz=-50)  # its job is watched, for as long as the solve takes
    browser.named(".pill", "covered")
    (job,) = client.call_json("GET", "/v1/jobs?component=rod")["jobs"]
    assert job["status"] == "done"
    reported = browser.text("table.answer")
    assert "± " in reported
    assert client.component("rod", wait_s=60)["rows"] >= 1
    assert browser.mistakes() == []


def test_a_failed_solve_tells_why_shows_its_log_and_is_tried_again(browser, client, tmp_path):
    add(browser, bundle(tmp_path, "column", nonlinear="true", force="[40000, 100, 100]"))
    browser.click("nav.tabs a", "Query")
    ask(browser, fx=-10_000)
    assert "buckles" in browser.text(".note", "The solve failed")
    browser.click(".note a", "Job")
    browser.click("button", "Log")
    browser.one("dialog h2")
    browser.click("dialog summary")
    browser.named("dialog pre", "Traceback")
    assert "/tmp/" not in browser.text("dialog pre")
    browser.click("dialog button", "Close")
    browser.click("button", "Retry")
    browser.until(lambda: 2 in attempts(client))


def attempts(client):
    jobs = client.call_json("GET", "/v1/jobs?component=column")["jobs"]
    return [job["attempt"] for job in jobs]


def test_bad_rows_of_a_measured_file_are_named_mended_imported_and_exported(
    browser, client, chromium
):
    browser.visit("#/add")
    browser.type("#new-name", "rig")
    for place in browser.all("form input[type=number]"):
        place.send_keys("600")
    browser.click("button", "Add the table")
    browser.named("h1", "rig")
    browser.click("nav.tabs a", "Import")
    browser.drop(".drop", "measured.csv", MEASURED)
    reported = browser.text("#mistakes")
    assert "Line 4" in reported
    assert "Line 6" in reported
    assert client.component("rig")["rows"] == 0
    browser.type("[aria-label='Line 4']", "0,0,-200,0,0,0,0,0,-0.2,0,0,0")
    browser.type("[aria-label='Line 6']", "0,0,-400,0,0,0,0,0,-0.4,0,0,0")
    browser.click("#check-again")
    browser.click("#import")
    browser.named(".note", "6 rows are in the table")
    browser.click("nav.tabs a", "Query")
    ask(browser, fz=-250)
    assert "−250" in browser.text("table.answer")
    browser.click("nav.tabs a", "Import")
    browser.click("button", "Export")
    exported = saved(browser, "rig-v")
    assert (
        exported.read_bytes() == client.call("GET", "/v1/components/rig/table?format=csv").content
    )


GAUGED = """Test rig;Fz;Fx (kN);Fy (kN);Mx (Nm);My (Nm);Mz (Nm);uz (mm);Strain
1;0,1;0;0;0;0;0;-0,1;311,5
2;0,2;0;0;0;0;0;-0,2;311,7
3;0,3;0;0;0;0;0;-0,3;312,1
"""


@pytest.fixture(scope="module")
def gauged(client):
    """A component for measured rows."""
    spans = {"force": [600] * 3, "moment": [60] * 3}
    about = {"name": "gauged", "title": "Gauged rig", "range": spans}
    client.call_json("POST", "/v1/components", about)
    return client


def test_probable_errors_of_a_measurement_are_shown_before_and_after_its_import(browser, client):
    spans = {"force": [600] * 3, "moment": [60] * 3}
    about = {"name": "logged", "title": "A rig with a data logger", "range": spans}
    client.call_json("POST", "/v1/components", about)
    units = zip(("F", "M", "u", "r"), ("N", "Nm", "mm", "rad"), strict=True)
    header = ",".join(f"{word}{axis} [{unit}]" for word, unit in units for axis in "xyz")
    moved = [0.02 * k for k in range(1, 25)]
    moved[5] = moved[17] = -9999
    lines = [f"0,0,{20 * k},0,0,0,0,0,{one},0,0,0" for k, one in enumerate(moved, 1)]
    browser.visit("#/c/logged/table")
    browser.drop(".drop", "sentinels.csv", "\n".join([header, *lines]))
    assert "Rows of the file: 7, 19" in browser.text(".note", "a logger writes")
    browser.click("#import")
    browser.named(".note", "24 rows are in the table")
    browser.named(".note", "a logger writes")


def test_the_axes_and_points_of_a_rig_are_drawn_while_they_are_typed(browser, gauged):
    browser.visit("#/c/gauged/table")
    browser.click("#rig-options summary")
    browser.type("#rig-frame", "x=-y,y=z,z=x")
    browser.type("#rig-load-point", "0,0,0.05")
    text = browser.attribute("#rig-picture svg", "aria-label")
    assert "the rig's x axis points along −y" in text
    assert text.endswith("the load point is at 0, 0, 0.05 m")
    assert "left-handed" in browser.text("#rig-picture")
    browser.type("#rig-load-point", "0,0,here")
    assert "three numbers in metres" in browser.text("#rig-picture")


def test_where_the_point_of_the_moments_matters_an_import_asks_for_the_load_cell(browser, client):
    spans = {"force": [250, 20, 20], "moment": [10, 20, 20]}
    client.call_json("POST", "/v1/components", {"name": "cell", "title": "C", "range": spans})
    header = "Fx [N],Fy [N],Fz [N],Mx [Nm],My [Nm],Mz [Nm],ux [mm],uy [mm],uz [mm]"
    browser.visit("#/c/cell/table")
    browser.drop(".drop", "cell.csv", f"{header}\n-100,0,5,0,-1,0,0,0,12\n")
    assert "moves with the interface" in browser.text("#mistakes")
    browser.run(
        "const cell = document.querySelector('#load-cell'); cell.value = 'fixed';"
        "cell.dispatchEvent(new Event('change', {bubbles: true}));"
    )
    browser.named("#preview caption", "in SI")
    shown = browser.text("#preview tbody tr:last-child").split()
    assert shown[1:7] == ["−100", "0", "5", "0", "0.2", "0"]  # -1 N·m less 0.012 m x -100 N


def test_a_rig_file_is_applied_drawn_and_kept_with_the_import(browser, client, tmp_path):
    spans = {"force": [600] * 3, "moment": [60] * 3}
    client.call_json("POST", "/v1/components", {"name": "bench", "title": "B", "range": spans})
    file = tmp_path / "rig.toml"
    file.write_text("name = 'bench 3'\nframe = 'x=-y,y=x,z=z'\nload_point = [0, 0, 0.5]\n")
    browser.visit("#/c/bench/table")
    browser.click("#rig-options summary")
    browser.one("#rig-file").send_keys(str(file))
    header = "Fx [N],Fy [N],Fz [N],Mx [Nm],My [Nm],Mz [Nm],ux [mm]"
    browser.drop(".drop", "bench.csv", f"{header}\n40,0,0,0,0,0,0.1\n")
    shown = browser.text("#preview tbody tr:last-child").split()
    assert shown[1:7] == ["0", "−40", "0", "20", "0", "0"]
    assert "x axis points along −y" in browser.attribute("#rig-picture svg", "aria-label")
    browser.click("#import")
    browser.named(".note", "1 row is in the table")
    browser.click("table.imports details summary", "rig")
    assert "name = 'bench 3'" in browser.text("details pre", "bench")


def test_a_profile_is_remembered_and_cycles_are_left_out_and_have_a_stiffness(browser, client):
    spans = {"force": [600] * 3, "moment": [60] * 3}
    client.call_json("POST", "/v1/components", {"name": "press", "title": "P", "range": spans})
    loads = [*range(0, 500, 50), *range(500, 0, -50)] * 3
    lines = "\n".join(f"{load},{load / 1000 + k * 1e-9}" for k, load in enumerate(loads))
    browser.visit("#/c/press/table")
    browser.click("#rig-options summary")
    browser.click("#rig-profile option[value=instron]")
    browser.click("#cycle-options summary")
    browser.type("#skip-cycles", "1")
    browser.drop(".drop", "press.csv", f"Load (N),Extension (mm)\n{lines}\n")
    browser.named(".note", "60 read, 21 of skipped cycles")
    browser.click("#import")
    browser.named(".note", "39 rows are in the table")
    browser.type("#stiffness-low", "100")
    browser.type("#stiffness-high", "400")
    browser.click("#stiffness-ask")
    assert browser.text("#stiffness tr", "loading").startswith("loading 14 1000000")
    browser.visit("#/c/press/overview")
    browser.visit("#/c/press/table")
    browser.click("#rig-options summary")
    browser.one("#rig-profile option[value=ros]")
    assert browser.attribute("#rig-profile", "value") == "instron"


def test_columns_are_named_left_out_and_turned_before_an_import(browser, gauged):
    browser.visit("#/c/gauged/table")
    browser.drop(".drop", "gauged.csv", GAUGED)
    browser.one("#columns")
    browser.type("input[aria-label='What Test rig is']", "leave out")
    browser.type("input[aria-label='What Strain is']", "leave out")
    browser.type("input[aria-label='What Fz is']", "-fz [kN]")
    browser.click("#check-again")
    shown = browser.text("#preview tbody tr:last-child").split()
    assert shown[1:4] == ["0", "0", "−300"]
    browser.click("#import")
    browser.named(".note", "3 rows are in the table")
    rows = gauged.call_json("GET", "/v1/components/gauged/table")["rows"]
    assert [row["wrench"][2] for row in rows] == [-100.0, -200.0, -300.0]
    assert "gauged.csv" in browser.text("table.imports")


def test_units_that_a_file_does_not_name_are_chosen_at_once(browser, gauged):
    bare = "fx,fy,fz,mx,my,mz,ux\n1,2,3,4,5,6,0.001\n2,2,3,4,5,6,0.002\n"
    browser.visit("#/c/gauged/table")
    browser.drop(".drop", "bare.csv", bare)
    browser.one("#columns fieldset")
    for label, unit in (("Force", "kN"), ("Moment", "N*m"), ("Translation", "mm")):
        browser.run(
            "const input = [...document.querySelectorAll('#columns label')]"
            ".find((one) => one.firstChild.textContent === arguments[0]).querySelector('select');"
            "input.value = arguments[1]; input.dispatchEvent(new Event('change'));",
            label,
            unit,
        )
    browser.click("#check-again")
    browser.one("#preview")
    head, first = browser.text("#preview thead"), browser.text("#preview tbody tr")
    assert "Fx, N" in head
    assert first.split()[1:4] == ["1000", "2000", "3000"]


def test_a_component_is_noted_renamed_put_away_and_brought_back_by_keyboard(browser, gauged):
    about = gauged.component("gauged")
    browser.visit("#/c/gauged/settings")
    browser.one("#notes")
    browser.tab_to("#notes")
    browser.press("gauge 7 drifts")
    browser.tab_to("#save-notes")
    browser.press(Keys.ENTER)
    browser.named("form span", "Saved.")
    browser.tab_to("#rename-name")
    browser.press("gauged2", Keys.ENTER)
    browser.named("h1", "gauged2")
    browser.tab_to("#archive")
    browser.press(Keys.ENTER)
    browser.named("#away", "archived")
    assert gauged.component("gauged2")["archived"] is True
    browser.tab_to("#unarchive")
    browser.press(Keys.ENTER)
    browser.one("#archive")
    reported = gauged.component("gauged2")
    assert (reported["notes"], reported["rows"]) == ("gauge 7 drifts", about["rows"])
    browser.visit("#/")
    browser.click("#archived")
    assert "archived" in browser.text(".card", "gauged\n")
    assert browser.mistakes() == []


def test_rows_of_another_setup_are_told_and_solved_again_by_one_button(
    browser, client, tmp_path, tmp_path_factory
):
    add(browser, bundle(tmp_path, "reworked", nonlinear="true"))
    client.solve("reworked", [0, 0, -50.0], [0, 0, 0], wait_s=120)
    (file,) = tmp_path_factory.getbasetemp().glob("page0/workspace/components/reworked/*.toml")
    file.write_text(file.read_text().replace("poisson_ratio = 0.", "poisson_ratio = 0.1"))
    browser.until(lambda: client.component("reworked")["another_setup"]["wrenches"])
    browser.visit("#/c/reworked")
    assert "1 row belongs to another setup" in browser.text(".note", "another setup")
    browser.click(".note button", "Solve them again")
    browser.until(lambda: not client.component("reworked")["another_setup"]["wrenches"])
    assert client.component("reworked", wait_s=60)["rows"] > 0
    browser.visit("#/c/reworked")
    browser.named("h2", "Method and rows")
    assert not [item for item in browser.all(".note") if "another setup" in item.text]
    assert browser.mistakes() == []


def saved(browser, start):
    folder = browser.downloads
    result = browser.until(
        lambda: [p for p in folder.glob(f"{start}*") if p.suffix != ".crdownload"]
    )
    return result[0]


def test_the_deformed_plate_is_magnified_and_turned(browser, plate):
    browser.resize(800, 500)
    browser.visit(f"{PLATE}/shape")
    browser.drawn("#shape")
    assert "Largest displacement" in browser.text("dl.facts")
    first = browser.picture("#shape")
    height = "return Math.min(...document.querySelector('#shape').data[0].z)"
    magnified = browser.run(height)
    browser.click("button", "True scale")
    browser.until(lambda: browser.run(height) > magnified)
    assert browser.text("#factor") == "× 1"
    camera = "return document.querySelector('#shape')._fullLayout.scene.camera.eye.x"
    before = browser.run(camera)
    browser.click("button[aria-label='Turn right']")
    browser.until(lambda: browser.run(camera) > 1.03 * before)
    assert browser.picture("#shape") != first
    assert browser.mistakes() == []


def test_the_deformed_plate_shows_the_parts_of_its_error_bar(browser, plate):
    browser.visit(f"{PLATE}/shape")
    browser.drawn("#shape")
    ask(browser, "Show", fz=-900)  # the row's own wrench: between rows one row tells no bar
    browser.until(lambda: "discretisation" in browser.text("dl.facts"))
    assert re.search(r"interpolation (negligible|.*m), discretisation \d", browser.text("dl.facts"))


def test_the_stress_of_a_shape_has_a_bar_of_two_digits_and_names_the_missing_error(browser, plate):
    browser.visit(f"{PLATE}/query")
    browser.one("form button")
    browser.run(
        "const own = window.fetch; window.fetch = async (to, how) => { const reply = await own(to,"
        " how);"
        " if (!String(to).includes('/deformed')) return reply; const body = await reply.json();"
        " Object.assign(body.stress, {largest: 123456789, error: 12345678, yields: false,"
        " yield_strength: 240e6}); return new Response(JSON.stringify(body)); }"
    )
    browser.go(f"{PLATE}/shape")
    shown = browser.text("dl.facts", "MPa")
    assert "123 MPa ± 12 MPa (interpolation" in shown
    assert "no (yield strength 240 MPa; the mesh's error is not included)" in shown


def test_a_shape_beyond_the_tolerance_by_its_mesh_names_the_cause(browser, client, tmp_path):
    client.add_component(bundle(tmp_path, "strict", translation=1e-15))
    client.solve("strict", [0, 0, -60.0], [0, 0, 0], wait_s=120)
    browser.visit("#/c/strict/shape")
    browser.drawn("#shape")
    ask(browser, "Show", fz=-60)
    browser.named(
        ".note.thin",
        "An error bar exceeds the tolerance because of discretisation and linearity",
    )


@pytest.fixture(scope="module")
def walk(chromium, plate):
    """All views of a telephone's width, one after the other: what is too wide, asked or wrong."""
    chromium.begin(plate)
    chromium.resize(390, 700)
    chromium.visit("#/")
    wide = {}
    for address in (
        "#/",
        "#/add",
        "#/jobs",
        "#/audit",
        "#/scene",
        *(f"{PLATE}/{view}" for view in VIEWS),
    ):
        chromium.go(address)
        if address.endswith("/query"):
            ask(chromium, fx=123.4567, fy=-321.7654, fz=-900.1234, mx=12.34567)
            chromium.one("table.answer")
        chromium.until(lambda: "…" not in chromium.text("main"), address)
        width = chromium.run("return document.documentElement.scrollWidth")
        if width > 390:
            wide[address] = width
    return {"wide": wide, "hosts": chromium.hosts(), "mistakes": chromium.mistakes()}


def test_no_view_is_wider_than_a_telephone(walk):
    assert walk["wide"] == {}


def test_no_view_asks_another_host(walk, client):
    assert walk["hosts"] == {client.url.removeprefix("http://")}


def test_no_view_has_a_script_that_fails_or_is_blocked(walk):
    assert walk["mistakes"] == []


def test_a_query_is_asked_by_keyboard_alone(browser, plate):
    browser.visit("#/")
    browser.one("a[href='#/c/plate_thin']")
    browser.tab_to("a[href='#/c/plate_thin']")
    browser.press(Keys.ENTER)
    browser.one(".tabs")
    browser.tab_to(".tabs a[href$='/query']")
    browser.press(Keys.ENTER)
    browser.one("input[name=fz]")
    browser.tab_to("input[name=fz]")
    browser.press(Keys.CONTROL + "a" + Keys.NULL, "-900", Keys.ENTER)
    assert browser.named(".pill", "covered")


def test_the_keyboard_turns_a_drawing(browser, plate):
    browser.resize(800, 500)
    browser.visit(f"{PLATE}/coverage")
    browser.drawn("#coverage")
    browser.tab_to(".figure")
    eye = "return document.querySelector('#coverage')._fullLayout.scene.camera.eye.x"
    before = browser.run(eye)
    browser.press(Keys.ARROW_RIGHT)
    browser.until(lambda: browser.run(eye) != before)


def test_the_calls_are_documented_without_another_host(browser):
    browser.visit("docs")
    browser.named(".opblock-summary", "/v1/components/{name}/displacement")
    assert browser.hosts() == {browser.server.removeprefix("http://")}
    assert browser.mistakes() == []


def test_methods_version_and_links_of_the_calls_stand_out_in_lines_of_80_characters(browser):
    browser.visit("docs")
    browser.named(".opblock-summary", "/v1/components/{name}/displacement")
    results = browser.run((Path(__file__).parent / "contrast.js").read_text())
    assert {"GET", "POST", "PUT", "DELETE", "OAS"} <= {result["text"] for result in results}
    assert [result for result in results if result["ratio"] < 4.5] == []  # WCAG 2.2, level AA
    widths = "return [...document.querySelectorAll('#calls p')].map((p) => p.clientWidth)"
    assert max(browser.run(widths)) < 800  # 80 characters, px


@pytest.mark.parametrize("width", [390, 1280])
def test_links_and_buttons_of_the_calls_are_24_px_high(browser, width):
    browser.resize(width, 900)
    browser.visit("docs")
    browser.click(".opblock-summary-control")
    browser.one(".opblock .tablinks")
    low = browser.run(
        "return [...document.querySelectorAll('#calls :is(a, button)')].filter((one) => {"
        " const { height } = one.getBoundingClientRect(); return height && height < 24; })"
        ".map((one) => one.outerHTML)"
    )
    assert low == []


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_words_stand_out_from_what_is_behind_them(browser, plate, scheme):
    browser.colours(scheme)
    browser.visit(f"{PLATE}/query")
    ask(browser, fz=-900)
    browser.one("table.answer")
    browser.type("input[name=fz]", "-800")  # the answer on view is stale
    results = browser.run((Path(__file__).parent / "contrast.js").read_text())
    assert len(results) > 20
    for address in ("#/", "#/audit", "#/scene", "#/terms", f"{PLATE}/checks"):
        browser.go(address)
        browser.until(lambda: "…" not in browser.text("main"))
        results += browser.run((Path(__file__).parent / "contrast.js").read_text())
    assert [result for result in results if result["ratio"] < 4.5] == []  # WCAG 2.2, level AA


def test_a_key_that_is_typed_goes_with_every_call(browser, plate):
    browser.visit(f"{PLATE}/query")
    before = browser.one("input[name=fx]")
    browser.click("#key")
    key = getattr(plate, "_key", None) or "wb_secret"
    browser.type("dialog input", key)
    browser.click("dialog button", "Use this key")
    browser.gone(before)
    browser.named("pre", "Authorization: Bearer $WRENCHBOOK_KEY")
    browser.run(
        "window.sent = []; const own = window.fetch;"
        "window.fetch = (to, how) => {"
        " window.sent.push(how.headers.Authorization); return own(to, how); }"
    )
    ask(browser, fz=-900)
    browser.one("table.answer")
    assert set(browser.run("return window.sent")) == {f"Bearer {key}"}


def test_what_is_shown_of_a_scene_is_its_plan(browser, plate):
    browser.visit("#/scene")
    browser.click("label", "plate_thin")
    browser.click("button", "Plan")
    assert "First solves" in browser.text(".cards .card", "plate_thin")
