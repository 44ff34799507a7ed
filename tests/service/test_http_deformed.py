"""Deformed surfaces over HTTP, from the client and the command line, on real solves."""

import json
import shutil
import sqlite3
from concurrent.futures import ThreadPoolExecutor

import meshio
import numpy as np
import pytest
from typer.testing import CliRunner

from tests.service.live import served as server_of
from tests.service.surfaces import sheet, solved, wrenches, write_bundle
from wrenchbook.service.cli.main import app
from wrenchbook.service.client import ProblemError
from wrenchbook.service.ops.backup import back_up
from wrenchbook.service.ops.restore import restore
from wrenchbook.service.workers.private import private_server

QUERY = "fx=100&fy=-50&fz=-900&mx=10&my=20&mz=-5"
FORCE, MOMENT = [100.0, -50.0, -900.0], [10.0, 20.0, -5.0]
PATH = "/v1/components/sheet/deformed"


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    """A server with the plate and one linear one, and the plate's folder."""
    place = tmp_path_factory.mktemp("served")
    folders = write_bundle(place), write_bundle(place, "flat", nonlinear=False)
    with private_server(place / "data", 2) as client:
        for folder in folders:
            with (folder / "component.toml").open("a") as file:
                file.write("\n[tolerance]\ntranslation = 1e-6\nrotation = 1.0\n")
            client.add_component(folder)
        yield client, folders[0], place / "data"


@pytest.fixture(scope="module")
def solve(served):
    client, *_ = served
    answer = client.displacement("sheet", FORCE, MOMENT, on_thin="wait", wait_s=120)
    assert answer.source == "fea"
    return answer


def refused(call, *texts, **more):
    with pytest.raises(ProblemError) as caught:
        call(*texts, **more)
    return caught.value


def test_before_any_solve_it_says_how_to_get_a_surface(served):
    client, *_ = served
    error = refused(client.deformed, "flat", FORCE)
    assert error.status == 409
    assert "POST /v1/components/flat/solve or .../fill" in error.detail


def test_at_a_solved_wrench_it_is_the_solvers_to_nine_digits(served, solve):
    client, folder, _ = served
    result = client.deformed("sheet", FORCE, MOMENT)
    (true,), _ = solved(folder, np.array([[*FORCE, *MOMENT]]))
    size = np.abs(true.displacement).max()
    assert np.abs(result.displacement - true.displacement).max() < 1e-9 * size
    np.testing.assert_array_equal(result.triangles, true.triangles)
    np.testing.assert_allclose(result.vertices, true.vertices, atol=1e-15)
    assert (result.source, result.is_covered, result.reason) == ("row", True, "")
    assert result.stress.largest == pytest.approx(true.largest, rel=1e-6)
    assert result.stress.yield_strength == 60e6
    np.testing.assert_allclose(result.deformed(10.0), true.vertices + 10 * true.displacement)


def test_its_middle_moves_as_the_displacement_says(served, solve):
    client, *_ = served
    result = client.deformed("sheet", FORCE, MOMENT)
    inside = np.linalg.norm(result.vertices[:, :2], axis=1) < 0.0601
    inside &= np.abs(result.vertices[:, 2]) < 1e-9
    patch = result.triangles[inside[result.triangles].all(axis=1)]
    corners = result.vertices[patch]
    area = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    mean = area @ result.displacement[patch].mean(axis=1) / area.sum()
    # Flat triangles between the nodes are not quite the section's own shape functions.
    assert np.linalg.norm(mean - solve.translation) < 1e-2 * np.linalg.norm(solve.translation)


def test_elsewhere_it_is_flagged(served, solve):
    client, *_ = served
    result = client.deformed("sheet", [0, 0, 500])
    assert (result.source, result.coverage, result.error) == ("rows", "thin", None)
    assert client.deformed("sheet", [1500, 0, 0]).coverage == "outside"
    assert refused(client.deformed, "sheet", [1e300, 0, 0]).status == 409


def test_outside_where_an_answer_has_no_bar_the_surface_has_none_and_no_verdict(served, solve):
    client, *_ = served
    for fz in (-200.0, 300.0):
        client.solve("sheet", [0, 0, fz], [0, 0, 0], wait_s=120)
    assert client.displacement("sheet", [1500, 0, 0], on_thin="estimate").error is None
    result = client.deformed("sheet", [1500, 0, 0])
    assert (result.source, result.coverage, result.error) == ("rows", "outside", None)
    assert (result.stress.error, result.stress.yields) == (None, None)


def test_the_reply_tells_the_frame(served, solve):
    client, *_ = served
    raw = client.deformed("sheet", FORCE, MOMENT).raw
    assert raw["frame"] == {"point": [0, 0, 0.004], "axes": np.eye(3).tolist()}
    assert (raw["force"], raw["moment"], raw["simplified"]) == (FORCE, MOMENT, None)


def test_the_linear_plate_answers_every_wrench_once_one_is_solved(served):
    client, *_ = served
    client.displacement("flat", FORCE, on_thin="wait", wait_s=120)
    for force in ([10.0, 0, 0], [0, 0, -3.0]):
        result = client.deformed("flat", force)
        assert (result.source, result.coverage) == ("linear", "covered")
    one, ten = client.deformed("flat", [0, 0, -1]), client.deformed("flat", [0, 0, -10])
    np.testing.assert_allclose(ten.displacement, 10 * one.displacement, rtol=1e-12)
    assert ten.stress.largest == pytest.approx(10 * one.stress.largest, rel=1e-9)


def test_the_command_line_writes_each_form(served, solve, tmp_path, monkeypatch):
    client, *_ = served
    client.displacement("sheet", FORCE, MOMENT, on_thin="wait", wait_s=120)
    loads = ["--force", *map(str, FORCE), "--moment", *map(str, MOMENT), "--server", client.url]
    for ending, start in ((".glb", b"glTF"), (".vtu", b"<?xml"), (".json", b"{")):
        file = tmp_path / f"shape{ending}"
        done = CliRunner().invoke(app, ["deformed", "sheet", str(file), *loads])
        assert done.exit_code == 0, done.output
        assert file.read_bytes().startswith(start)
    assert json.loads((tmp_path / "shape.json").read_bytes())["component"] == "sheet"


def test_many_at_once_are_answered_and_others_with_them(served, solve):
    client, folder, _ = served
    asked = 0.5 * wrenches(sheet(folder), 12, seed=4)
    with ThreadPoolExecutor(12) as pool:
        shapes = list(pool.map(lambda one: client.deformed("sheet", one), asked))
        quick = client.displacement("sheet", FORCE, MOMENT, on_thin="estimate")
    assert len({shape.displacement.tobytes() for shape in shapes}) == 12
    assert quick.translation is not None


def shares_of(client, name):
    """The mesh's and the linearity's share of the interface's bars, (6,), m and rad."""
    body = json.dumps({"force": FORCE, "moment": MOMENT, "detail": True, "on_thin": "estimate"})
    headers = {"Content-Type": "application/json"}
    path = f"/v1/components/{name}/displacement"
    parts = client.call("POST", path, body.encode(), headers=headers).json()["error_parts"]
    causes = [cause for cause in ("mesh", "linearity") if cause in parts]
    return {cause: np.concatenate(list(parts[cause].values())) for cause in causes}


@pytest.fixture
def client(served, solve):
    """The server once both plates are solved."""
    client, *_ = served
    client.displacement("flat", FORCE, MOMENT, on_thin="wait", wait_s=120)
    return client


@pytest.mark.parametrize("name", ["sheet", "flat"])
def test_the_middle_of_the_interface_has_at_least_the_bar_of_the_displacement(client, name):
    result = client.deformed(name, FORCE, MOMENT)
    middle = np.linalg.norm(result.vertices, axis=1).argmin()
    assert np.linalg.norm(result.vertices[middle]) < 1e-9
    own = sum(shares_of(client, name).values())
    assert result.error[middle] >= np.linalg.norm(own[:3]) > 1e-6


def test_the_reply_tells_the_largest_of_each_share_and_where_it_is_from(client):
    parts = client.deformed("sheet", FORCE, MOMENT).error_parts
    assert list(parts) == ["table", "mesh", "mesh_basis"]
    assert parts["mesh"] > 1e-6 > 1e-12 > parts["table"] > 0
    assert "finer mesh of" in parts["mesh_basis"]


def test_a_glb_tells_the_shares_in_its_extras_and_a_header(client):
    reply = client.call("GET", f"/v1/components/sheet/deformed?{QUERY}&format=gltf")
    size = int.from_bytes(reply.content[12:16], "little")
    (mesh,) = json.loads(reply.content[20 : 20 + size])["meshes"]
    reported = client.deformed("sheet", FORCE, MOMENT)
    assert mesh["extras"]["error_parts"] == reported.error_parts
    assert mesh["extras"]["within_tolerance"] is False
    assert reply.headers["Wrenchbook-Within-Tolerance"] == "false"


def test_a_linear_component_has_a_share_of_its_linearity(client):
    parts = client.deformed("flat", FORCE, MOMENT).error_parts
    assert parts["linearity"] > 0
    assert "nonlinear solves" in parts["linearity_basis"]


def test_a_vtu_has_the_shares_of_each_vertex(client, tmp_path):
    (tmp_path / "a.vtu").write_bytes(client.deformed_file("flat", FORCE, MOMENT, "vtu"))
    data = meshio.read(tmp_path / "a.vtu").point_data
    total = data["error_table"] + data["error_mesh"] + data["error_linearity"]
    np.testing.assert_allclose(data["error"], total, rtol=1e-12)


def test_a_sweep_has_the_bars_of_the_displacement(client):
    sweep = client.call("GET", "/v1/components/flat/response?load=fz&points=3").json()
    answer = client.displacement("flat", [0, 0, sweep["at"][2]], on_thin="estimate")
    np.testing.assert_allclose(sweep["error"][2], answer.error_vector, rtol=1e-9)
    assert sweep["bars_are_whole"] is True


def test_where_nothing_tells_of_the_mesh_the_reply_says_that_and_how_to_learn_it(
    client, served, tmp_path
):
    back_up(served[2], tmp_path / "a.backup")
    restore(tmp_path / "a.backup", tmp_path / "data")
    shutil.copytree(served[2] / "fields", tmp_path / "data" / "fields", dirs_exist_ok=True)
    db = sqlite3.connect(tmp_path / "data" / "ledger.sqlite")
    with db:
        db.execute("DELETE FROM solver_errors")
    db.close()
    with server_of(tmp_path / "data") as client:
        result = client.deformed("sheet", FORCE, MOMENT)
        sweep = client.call("GET", "/v1/components/sheet/response?load=fz&points=3").json()
    assert result.error_parts["mesh"] is None
    assert "the next solve of this component estimates it" in result.error_parts["mesh_basis"]
    assert result.within_tolerance is None
    assert result.error.max() == result.error_parts["table"]
    assert sweep["bars_are_whole"] is False


def test_a_row_without_a_surface_gets_one_as_the_text_says(served, solve):
    client, _, data = served
    asked = [0.0, 0.0, -333.0]
    client.displacement("sheet", asked, on_thin="wait", wait_s=120)
    row = client.solve("sheet", asked).raw["row"]
    kept = client.deformed("sheet", asked).displacement
    shutil.rmtree(data / "fields" / "sheet")
    assert "no row has fields" in refused(client.deformed, "sheet", asked).detail
    client.call("DELETE", f"/v1/components/sheet/table/{row}")
    client.displacement("sheet", asked, on_thin="wait", wait_s=120)
    answer = client.solve("sheet", asked)
    if answer.job is not None:
        client.wait(answer.job.id, 120)
    result = client.deformed("sheet", asked)
    assert result.source == "row"
    np.testing.assert_array_equal(result.displacement, kept)
