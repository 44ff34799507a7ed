import io
import shutil
import zipfile

import pytest
from starlette.testclient import TestClient

from tests.until import until
from wrenchbook.fea.bundle.shipped import SHIPPED
from wrenchbook.service.http.app import create_app
from wrenchbook.service.workspace import Settings

TABLE_ONLY = {"name": "rig", "title": "rig", "range": {"force": [1, 2, 3], "moment": [1, 1, 1]}}


def bundle_zip(text, name="component.toml"):
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr(name, text)
    return buffer.getvalue()


def upload(http, content):
    return http.post("/v1/components", files={"bundle": ("b.zip", content, "application/zip")})


def bar_text(**changes):
    text = (SHIPPED / "bar" / "component.toml").read_text().replace('"bar"', '"beam"', 1)
    for old, new in changes.values():
        assert old in text
        text = text.replace(old, new)
    return text


def test_the_library_is_listed_in_pages_of_a_search_each_component_once(http):
    for number in range(5):
        http.post("/v1/components", json={**TABLE_ONLY, "name": f"hinge{number}"})
    http.post("/v1/components/hinge1/archive")
    url, result, pages = "/v1/components?q=hinge&limit=2&archived=true", [], 0
    while url:
        reply = http.get(url)
        url, pages = reply.json()["next"], pages + 1
        assert reply.headers.get("link") == (f'<{url}>; rel="next"' if url else None)
        result += [component["name"] for component in reply.json()["components"]]
    assert (result, pages) == ([f"hinge{number}" for number in range(5)], 3)
    listed = http.get("/v1/components").json()
    assert listed["next"] is None
    names = [component["name"] for component in listed["components"]]
    assert {"bar", "plate", "plate_thin", "spring", "link", "hot_bracket"} <= set(names)


def test_a_component_tells_contract_range_rows_and_coverage(http):
    body = http.get("/v1/components/plate").json()
    assert body["contract"]["units"].startswith("SI")
    assert body["range"]["force"][2] == [-5000.0, 5000.0]
    assert body["rows"] == 0
    assert "axes" in body["coverage"]


def test_a_load_of_a_measured_part_that_does_not_act_has_the_range_0(http):
    span = {"force": [0, 0, 300], "moment": [0, 0, 0]}
    body = http.post("/v1/components", json=TABLE_ONLY | {"name": "strut", "range": span}).json()
    assert body["range"]["force"] == [[0.0, 0.0], [0.0, 0.0], [-300.0, 300.0]]


def test_a_table_only_component_is_made_by_one_post(http):
    reply = http.post("/v1/components", json=TABLE_ONLY)
    assert reply.status_code == 201
    assert reply.headers["location"] == "/v1/components/rig"
    assert reply.json()["range"]["force"] == [[-1.0, 1.0], [-2.0, 2.0], [-3.0, 3.0]]
    about = http.get("/v1/components/rig").json()
    assert (about["has_fea"], about["interface"]) == (False, None)


@pytest.mark.parametrize("force", [[900, 900, 900], [[-900, 900], 900, [-900, 900]]])
def test_a_range_of_numbers_or_of_pairs_is_one_range_and_comes_back_as_pairs(http, force):
    given = {"force": force, "moment": [[-5, 90], 90, 90]}
    pairs = {"force": [[-900, 900]] * 3, "moment": [[-5, 90], [-90, 90], [-90, 90]]}
    created = http.post("/v1/components", json={**TABLE_ONLY, "range": given}).json()
    assert created["range"] == http.get("/v1/components/rig").json()["range"] == pairs
    again = {**TABLE_ONLY, "name": "again", "range": created["range"]}
    assert http.post("/v1/components", json=again).json()["range"] == pairs


def test_the_range_that_a_component_has_is_taken_by_fill_and_by_a_scene_plan(http):
    range_ = http.get("/v1/components/plate_thin").json()["range"]
    narrow = {word: [span[1] / 2 for span in spans] for word, spans in range_.items()}
    for item in (range_, narrow):
        filled = http.post("/v1/components/plate_thin/fill", json={"range": item, "budget": 1})
        assert filled.status_code == 202, filled.text
        scene = {"components": {"plate_thin": item}}
        assert http.post("/v1/scenes/plan", json=scene).status_code == 200


def test_a_bundle_is_uploaded_as_a_zip(http):
    reply = upload(http, bundle_zip(bar_text(), "beam/component.toml"))
    assert reply.status_code == 201, reply.text
    assert reply.json()["linear"] is True
    point = reply.json()["interface"]["point"]
    assert len(point) == 3
    assert point[0] > 0
    assert "beam" in [
        component["name"] for component in http.get("/v1/components").json()["components"]
    ]


def test_loads_of_range_zero_are_not_filled_and_not_covered(folder):
    text = bar_text(
        mesh=("cells_along = 40", "cells_along = 4"),
        analysis=("nonlinear = false", "nonlinear = true"),
        force=("[1000, 100, 100]", "[0, 0, 100]"),
        moment=("[50, 50, 50]", "[0, 0, 0]"),
    )
    bundle = folder / "components" / "beam"
    bundle.mkdir(parents=True)
    (bundle / "component.toml").write_text(text)
    fill, call = "/v1/components/beam/fill", "/v1/components/beam/displacement"
    inside = {"force": [0, 0, 37], "moment": [0, 0, 0], "on_thin": "estimate"}
    with TestClient(create_app(Settings(folder, solvers=2))) as http:
        while jobs := http.post(fill, json={"budget": 30}).json()["jobs"]:
            for job in jobs:
                result = http.get(f"/v1/jobs/{job['id']}", params={"wait_s": 60}).json()
                assert result["status"] == "done"
                assert not any((*result["force"][:2], *result["moment"]))
        until(lambda: http.post(call, json=inside).json()["coverage"] == "covered")
        across = http.post(call, json={**inside, "force": [0, 1, 37]}).json()
        assert across["coverage"] == "outside"


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("youngs_modulus = 210e9", "youngs_modulus = -1.0", "youngs_modulus"),
        ("[mesh]", "[mesh", "line"),
    ],
)
def test_a_bundle_with_a_mistake_is_refused_by_key_and_nothing_is_added(
    http, folder, old, new, words
):
    reply = upload(http, bundle_zip(bar_text(change=(old, new))))
    assert reply.status_code == 422, reply.text
    problem = reply.json()
    assert words in str(problem["errors"])
    assert "Nothing was added" in problem["detail"]
    assert list((folder / "components").iterdir()) == []
    assert http.get("/v1/components/beam").status_code == 404


@pytest.mark.parametrize(
    "content",
    [
        b"cannot be read as a zip",
        bundle_zip("x", "readme.txt"),
        bundle_zip("x", "../component.toml"),
        bundle_zip("x", "/component.toml"),
    ],
)
def test_an_archive_that_is_no_bundle_is_refused(http, folder, content):
    reply = upload(http, content)
    assert reply.status_code == 422
    assert list((folder / "components").iterdir()) == []


def test_a_job_is_listed_tells_its_progress_and_is_cancelled(http, stand_in):
    stand_in("endless")
    body = {"force": [1, 2, 3], "moment": [0, 0, 0]}
    job = http.post("/v1/components/plate_thin/solve", json=body).json()["job"]
    listed = http.get("/v1/jobs", params={"component": "plate_thin"}).json()["jobs"]
    assert [item["id"] for item in listed] == [job["id"]]
    progress = until(lambda: http.get(job["url"]).json().get("progress"))
    assert progress == {"fraction": 0.25, "message": "still going"}
    cancelled = http.delete(job["url"]).json()
    assert cancelled["status"] == "cancelled"
    assert http.get(job["url"], params={"wait_s": 5}).json()["status"] == "cancelled"


def test_a_solve_answers_from_fea_and_the_files_of_its_attempt_come_as_a_zip(http):
    body = {"force": [1, 2, 3], "moment": [0, 0, 0], "wait_s": 60}
    reply = http.post("/v1/components/plate_thin/solve", json=body)
    assert (reply.status_code, reply.json()["source"]) == (200, "fea")
    assert reply.json()["translation"] == pytest.approx([1e-6, 2e-6, 3e-6])
    job = reply.json()["job"]
    content = http.get(f"{job['url']}/files").content
    assert {"spec.json", "result.json"} <= set(zipfile.ZipFile(io.BytesIO(content)).namelist())


def test_the_files_of_a_done_job_that_were_deleted_are_not_called_not_started(http, folder):
    """The answer was: Job 2 has not started."""
    body = {"force": [1, 0, 0], "moment": [0, 0, 0], "wait_s": 60}
    job = http.post("/v1/components/plate_thin/solve", json=body).json()["job"]["id"]
    shutil.rmtree(folder / "jobs" / str(job))
    reply = http.get(f"/v1/jobs/{job}/files")
    assert reply.status_code == 404
    assert f"Job {job} is done" in reply.json()["detail"]
    assert "deleted" in reply.json()["detail"]
    assert "not started" not in reply.json()["detail"]
    assert "needs no files" in reply.json()["detail"]  # and cannot be retried
    assert http.get(f"/v1/jobs/{job}/log").json()["detail"] == reply.json()["detail"]


def test_a_job_that_no_solver_began_has_no_files_and_says_what_to_do(tmp_path):
    """A cancelled one was to be asked for later, a waiting one to be retried."""
    with TestClient(create_app(Settings(tmp_path, solvers=0))) as http:
        job = http.post("/v1/components/plate_thin/solve", json={"force": [1, 0, 0]}).json()["job"]
        for call in ("files", "log"):
            assert "ask again later" in http.get(f"{job['url']}/{call}").json()["detail"]
        http.delete(job["url"])
        for call in ("files", "log"):
            detail = http.get(f"{job['url']}/{call}").json()["detail"]
            assert "is cancelled, and no solver began it" in detail
            assert f"retry it: POST {job['url']}/retry" in detail


def test_an_uploaded_deck_is_refused_unless_the_operator_allows_decks(http, folder):
    source = SHIPPED / "plate_ccx"
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for path in source.iterdir():
            text = path.read_bytes()
            archive.writestr(path.name, text.replace(b'name = "plate_ccx"', b'name = "mine"'))
    reply = upload(http, buffer.getvalue())
    assert reply.status_code == 422
    assert "--allow-decks" in str(reply.json()["errors"])
    assert list((folder / "components").iterdir()) == []


def test_a_component_tells_its_interface(http):
    interface = http.get("/v1/components/plate_thin").json()["interface"]
    assert interface["section"] == "patch"
    assert interface["point"] == [0, 0, 0.004]
    assert interface["axes"] == [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
    assert interface["coupling"] == "distributed"
    assert interface["locked"] == []
    assert interface["moment"] == "about the interface point where it is now"


def test_what_the_check_of_a_bundle_warns_of_is_in_the_reply_and_in_the_component(http, folder):
    reply = upload(http, bundle_zip(bar_text(slender=("cells_along = 40", "cells_along = 2"))))
    assert reply.status_code == 201, reply.text
    warnings = reply.json()["warnings"]
    assert warnings
    assert {"where", "message"} == warnings[0].keys()
    assert "aspect ratio" in warnings[0]["message"]
    assert http.get("/v1/components/beam").json()["warnings"] == warnings
    with TestClient(create_app(Settings(folder, solvers=0))) as restarted:
        assert restarted.get("/v1/components/beam").json()["warnings"] == warnings


def test_a_sound_component_has_no_warnings(http):
    fit = bar_text(u=("translation = 1e-6", "translation = 1e-2"), r=("n = 1e-6", "n = 1e-2"))
    assert upload(http, bundle_zip(fit)).json()["warnings"] == []
