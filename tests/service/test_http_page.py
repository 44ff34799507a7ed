"""The page's files and the calls that it draws from."""

import io
import json
import re
import zipfile
from pathlib import Path

import numpy as np
import pytest
from fastapi import FastAPI
from starlette.testclient import TestClient

from tests.service.conftest import SOLVERS
from tests.service.live import FULL, as_rows, clean_wrenches, full_wrenches, moved
from wrenchbook.fea.check.reporting import report, surface_in
from wrenchbook.service.http import problems
from wrenchbook.service.http.app import create_app
from wrenchbook.service.http.routes.jobs import MAX_LOG_BYTES
from wrenchbook.service.http.routes.page import FOLDER, router
from wrenchbook.service.jobs.attempt import LOG
from wrenchbook.service.library.bundles import known_faces_of
from wrenchbook.service.workspace import Settings

RIG = "/v1/components/rig"
MODULES = sorted((FOLDER / "js").glob("*.js"))
PAGES = ("/", "/docs")


def texts() -> list[Path]:
    return [path for path in FOLDER.rglob("*") if path.is_file()]


@pytest.fixture(scope="module")
def page():
    """The page alone: no workspace stands behind it."""
    app = FastAPI(docs_url=None)
    problems.install(app)
    app.include_router(router)
    return TestClient(app)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("page") / "workspace"


@pytest.fixture(scope="module")
def http(folder):
    """A server whose every solve fails."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("WRENCHBOOK_SOLVE", "stand_in:diverges")
        patch.setenv("PYTHONPATH", SOLVERS)
        with TestClient(create_app(Settings(folder, solvers=1))) as client:
            yield client


@pytest.fixture(scope="module")
def rig(http):
    """A table of 25 clean and 40 full rows."""
    wrenches = np.concatenate((clean_wrenches(), full_wrenches(40)))
    about = {"name": "rig", "title": "rig", "range": {"force": [100] * 3, "moment": [10] * 3}}
    assert http.post("/v1/components", json=about).status_code == 201
    rows = as_rows(wrenches, moved(wrenches))
    assert http.post(f"{RIG}/table?wait_s=600", json={"rows": rows}).status_code == 200
    return http


@pytest.mark.parametrize("address", PAGES)
def test_a_page_holds_no_script_and_refers_to_no_other_host(page, address):
    page = page.get(address).text
    assert re.findall(r"<script(?![^>]*src=)[^>]*>", page) == []
    assert re.findall(r"\son\w+=", page) == []
    assert re.findall(r"(?:src|href)=\"(?:https?:)?//", page) == []


@pytest.mark.parametrize("address", PAGES)
def test_all_that_a_page_refers_to_is_served(page, address):
    names = re.findall(r"(?:src|href)=\"(page/[^\"]+)\"", page.get(address).text)
    assert len(names) > 3
    assert {name: page.get(f"/{name}").status_code for name in names} == dict.fromkeys(names, 200)


@pytest.mark.parametrize(("file", "address"), [("index.html", "/"), ("docs.html", "/docs")])
def test_the_file_of_a_page_leads_to_its_address(page, file, address):
    """It was served at its own, where its links to styles led nowhere."""
    reply = page.get(f"/page/{file}", follow_redirects=False)
    assert reply.status_code == 307
    assert page.get(f"/page/{file}").url.path == address


def test_all_that_modules_import_is_served(page):
    text = "\n".join(module.read_text() for module in MODULES)
    names = re.findall(r"(?:from|import) \"\./([^\"]+)\"", text)
    names += re.findall(r"\"(\w+\.js)\"", text)
    assert {name for name in names if page.get(f"/page/js/{name}").status_code != 200} == set()


def test_no_file_of_the_page_names_another_host():
    named = {
        path.name: result
        for path in texts()
        if (result := re.findall(r"https?://(?!www\.w3\.org/2000/svg)[\w.]+", path.read_text()))
    }
    assert named == {}


@pytest.mark.parametrize("name", ["plotly.min.js", "swagger-ui-bundle.js", "swagger-ui.css"])
def test_what_the_page_borrows_comes_packed_and_is_not_sent_twice(page, name):
    first = page.get(f"/page/{name}", headers={"accept-encoding": "gzip"})
    assert first.status_code == 200
    assert first.headers["content-encoding"] == "gzip"
    assert len(first.content) > 100_000
    again = page.get(f"/page/{name}", headers={"if-none-match": first.headers["etag"]})
    assert (again.status_code, again.content) == (304, b"")


@pytest.mark.parametrize(
    "name", ["../app.py", "..%2f..%2fhttp%2fapp.py", "js/../../http/app.py", "nothing.js", ""]
)
def test_nothing_but_the_page_is_served(page, name):
    reply = page.get(f"/page/{name}")
    assert reply.status_code == 404
    assert "create_app" not in reply.text


def test_rows_to_draw_are_as_many_as_asked_for_those_of_the_axis_first(rig):
    reported = rig.get(f"{RIG}/drawing?axis=z&most=12").json()
    assert (reported["of"], reported["shown"], len(reported["wrench"])) == (65, 12, 12)
    assert sum(reported["clean"]) == 9  # the corners of the axis, and zero load
    assert reported["row"] == sorted(reported["row"])


def test_rows_along_a_load_have_no_other(rig):
    wrenches = np.array(rig.get(f"{RIG}/drawing?along=mx").json()["wrench"])
    assert len(wrenches) == 1  # zero load; corners of an axis hold three loads
    assert not wrenches[:, [0, 1, 2, 4, 5]].any()


def test_the_grid_of_an_axis_is_covered_as_queries_are(rig):
    grid = rig.get(f"{RIG}/drawing?axis=x").json()["grid"]
    asked = {"wrenches": grid["wrench"], "on_thin": "estimate"}
    reported = rig.post(f"{RIG}/displacements", json=asked).json()["coverage"]
    assert [("covered", "thin", "outside")[code] for code in grid["coverage"]] == reported


def test_a_response_is_what_queries_answer(rig):
    reported = rig.get(f"{RIG}/response?load=fz&my=3&points=5").json()
    assert reported["at"] == np.linspace(-FULL[2], FULL[2], 5).tolist()
    wrenches = [[0, 0, load, 0, 3, 0] for load in reported["at"]]
    asked = {"wrenches": wrenches, "on_thin": "estimate"}
    answers = rig.post(f"{RIG}/displacements", json=asked).json()
    assert reported["displacement"] == answers["displacements"]
    assert reported["error"] == reported["interpolation"] == answers["errors"]


def test_looking_at_a_table_counts_as_no_query(rig):
    before = rig.get("/metrics").text
    for call in ("glance", "drawing?axis=y", "response?load=fx"):
        assert rig.get(f"{RIG}/{call}").status_code == 200
    queries = r"wrenchbook_queries_total\{.*"
    assert re.findall(queries, rig.get("/metrics").text) == re.findall(queries, before)


def test_a_glance_tells_what_parts_of_the_range_are_covered(rig):
    reported = rig.get(f"{RIG}/glance").json()
    for shares in (reported["whole"], *reported["axes"].values()):
        assert sum(shares) == pytest.approx(1.0)
        assert min(shares) >= 0.0
    assert reported["axes"].keys() == {"x", "y", "z"}
    assert reported["interpolation"] == reported["error"]  # measured rows: no discretisation error
    assert (
        reported["within_tolerance"] is None or reported["within_tolerance"] <= reported["whole"][0]
    )
    empty = rig.get("/v1/components/plate_thin/glance").json()
    assert empty["whole"] == [0.0, 0.0, 1.0]


def test_a_glance_names_the_error_that_a_table_without_a_tolerance_allows(rig):
    allowed = rig.get(f"{RIG}/glance").json()["allowed"]
    variation = np.ptp(np.concatenate((moved(clean_wrenches()), moved(full_wrenches(40)))), axis=0)
    assert allowed == pytest.approx(0.01 * variation, rel=1e-6)


def test_the_surface_of_an_unsolved_part_is_there_to_draw(http):
    reported = http.get("/v1/components/plate_thin/surface").json()
    assert len(reported["triangles"]) > 100
    assert max(map(max, reported["triangles"])) < len(reported["vertices"]) <= 2000


def faces_of(http, files):
    """The reply to a zip of these texts and bytes, of which only the faces are asked."""
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w") as bundle:
        for name, content in files.items():
            bundle.writestr(name, content)
    sent = {"bundle": ("part.zip", archive.getvalue())}
    return http.post("/v1/components?faces=true", files=sent)


def test_the_faces_of_a_part_are_those_of_its_check_with_a_trace_that_has_their_toml(http):
    reported = http.get("/v1/components/plate_thin/faces").json()
    folder = http.app.state.workspace.library["plate_thin"].folder
    checked = report(folder, surface=surface_in(folder))["faces"]
    assert reported["faces"] == json.loads(json.dumps(checked))
    lines = {item["meta"] for item in reported["figure"]["data"] if item["type"] == "mesh3d"}
    assert lines == {face["toml"] for face in reported["faces"]}


def test_a_bundle_shows_its_faces_before_the_rest_is_written_and_is_not_added(http):
    blocks = Path(__file__).parents[1] / "fea/good/blocks/blocks.msh"
    toml = 'name = "half"\n[mesh]\nfile = "part.msh"\nunit = "mm"\n'
    reported = faces_of(http, {"component.toml": toml, "part.msh": blocks.read_bytes()})
    assert reported.status_code == 200
    assert reported.json()["faces"][0]["toml"] == '{plane = "x", at = 0.0}'
    assert http.get("/v1/components/half").status_code == 404


def test_the_faces_of_a_bundle_that_is_not_added_take_no_place_of_a_components(http):
    known = known_faces_of.cache_info()
    toml = 'name = "half"\n[mesh]\ngenerator = "bar"\nlength = 1.0\nwidth = 0.1\nheight = 0.1\n'
    assert faces_of(http, {"component.toml": f"{toml}cells_along = 4\n"}).status_code == 200
    assert known_faces_of.cache_info() == known


def test_faces_of_a_table_only_component_are_refused_and_it_is_not_added(http):
    body = {"name": "half", "title": "Half", "range": {"force": [[-1, 1]] * 3}}
    body["range"]["moment"] = body["range"]["force"]
    reported = http.post("/v1/components?faces=true", json=body)
    assert (reported.status_code, reported.json()["errors"][0]["loc"]) == (422, "faces")
    assert "leave faces out" in reported.json()["detail"]
    assert http.get("/v1/components/half").status_code == 404
    assert http.post("/v1/components", json=body).status_code == 201


@pytest.mark.parametrize(
    ("file", "why"),
    [("../other.msh", "is outside the bundle"), ("absent.msh", "absent.msh"), (None, "no [mesh]")],
)
def test_a_bundle_whose_faces_cannot_be_read_is_refused_with_the_reason(http, file, why):
    mesh = f'[mesh]\nfile = "{file}"\nunit = "mm"\n' if file else ""
    reported = faces_of(http, {"component.toml": f'name = "half"\n{mesh}'})
    assert reported.status_code == 422
    assert why in reported.json()["detail"]


@pytest.mark.parametrize(
    ("toml", "deck", "why"),
    [
        (
            "",
            "1,1,2,3,9",
            "element 1 on node 9, which no *NODE defines",
        ),  # of a node that is not there
        ("", "1,1,1,1,1", "without volume"),
        ("[", "1,1,2,3,4", "not valid TOML"),
    ],
)
def test_a_bundle_whose_mesh_file_is_wrong_is_refused_with_its_mistake(http, toml, deck, why):
    nodes = "*NODE\n1,0,0,0\n2,1,0,0\n3,0,1,0\n4,0,0,1\n*ELEMENT,TYPE=C3D4\n"
    mesh = f'[mesh]\nfile = "m.inp"\nunit = "mm"\n{toml}'
    reported = faces_of(http, {"component.toml": mesh, "m.inp": nodes + deck + "\n"})
    assert reported.status_code == 422
    assert why in reported.json()["detail"]


def test_a_table_without_a_mesh_has_no_faces(rig):
    assert rig.get(f"{RIG}/faces").json()["type"].endswith("no-mesh")


@pytest.fixture(scope="module")
def failed(http, folder):
    """The folder of a failed job's attempt."""
    solve = {"force": [0, 0, 1], "wait_s": 60}
    assert http.post("/v1/components/plate_thin/solve", json=solve).status_code == 424
    return folder / "jobs" / "1" / "1"


def test_the_log_of_a_failed_job_names_no_folder_of_the_machine(http, failed, folder):
    (failed / LOG).write_text(
        f'File "{folder.absolute()}/jobs/1/1/deck", in {Path(problems.__file__).parents[2]}'
    )
    reported = http.get("/v1/jobs/1/log")
    assert reported.headers["content-type"].startswith("text/plain")
    assert reported.text == 'File "<data>/jobs/1/1/deck", in <wrenchbook>'


def test_the_log_of_a_failed_job_names_no_other_folder_either(http, failed):
    """A deck's command may print any path; the job's zip has cut them already."""
    (failed / LOG).write_text("Traceback (most recent call last):\nread /tmp/lab/secret/mesh.inp")
    text = http.get("/v1/jobs/1/log").text
    assert text == "Traceback (most recent call last):\nread .../mesh.inp"


def test_of_a_long_log_the_end_is_told_and_how_much_is_missing(http, failed):
    (failed / LOG).write_bytes(b"x" * 10 + b"y" * MAX_LOG_BYTES)
    reported = http.get("/v1/jobs/1/log").text
    assert reported.startswith("[the first 10 bytes are in .../files]\ny")
    assert "x" not in reported.removeprefix("[the first 10 bytes are in .../files]")


def test_a_log_that_is_a_link_is_not_followed(http, failed, tmp_path):
    secret = tmp_path / "secret"
    secret.write_text("secret")
    (failed / LOG).unlink(missing_ok=True)
    (failed / LOG).symlink_to(secret)
    assert http.get("/v1/jobs/1/log").status_code == 404


@pytest.mark.parametrize("path", MODULES, ids=lambda path: path.name)
def test_no_text_of_others_is_made_markup_or_script(path):
    created = r"(inner|outer)HTML|insertAdjacentHTML|document\.write|\beval\(|new Function|srcdoc"
    assert not re.search(created, path.read_text(encoding="utf-8"))
