"""Deformed surfaces over HTTP, from the client and the command line, on real solves."""

import json
import shutil
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from typer.testing import CliRunner

from tests.service.surfaces import sheet, solved, wrenches, write_bundle
from wrenchbook.service.cli.main import app
from wrenchbook.service.client import ProblemError
from wrenchbook.service.workers.private import private_server

FORCE, MOMENT = [100.0, -50.0, -900.0], [10.0, 20.0, -5.0]
PATH = "/v1/components/sheet/deformed"


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    """A server with the plate and one linear one, and the plate's folder."""
    place = tmp_path_factory.mktemp("served")
    folder = write_bundle(place)
    with private_server(place / "data", 2) as client:
        client.add_component(folder)
        client.add_component(write_bundle(place, "flat", nonlinear=False))
        yield client, folder, place / "data"


@pytest.fixture(scope="module")
def solve(served):
    client, *_ = served
    answer = client.displacement("sheet", FORCE, MOMENT, on_thin="wait", wait_s=120)
    assert answer.source == "fea"
    return answer


def refused(call, *words, **more):
    with pytest.raises(ProblemError) as caught:
        call(*words, **more)
    return caught.value


def test_before_any_solve_it_says_how_to_get_a_surface(served):
    client, *_ = served
    error = refused(client.deformed, "flat", FORCE)
    assert error.status == 409
    assert "POST this wrench to /v1/components/flat/solve" in error.detail


def test_at_a_solved_wrench_it_is_the_solvers_to_nine_digits(served, solve):
    client, folder, _ = served
    found = client.deformed("sheet", FORCE, MOMENT)
    (true,), _ = solved(folder, np.array([[*FORCE, *MOMENT]]))
    size = np.abs(true.displacement).max()
    assert np.abs(found.displacement - true.displacement).max() < 1e-9 * size
    np.testing.assert_array_equal(found.triangles, true.triangles)
    np.testing.assert_allclose(found.vertices, true.vertices, atol=1e-15)
    assert (found.source, found.is_covered, found.reason) == ("row", True, "")
    assert found.stress.largest == pytest.approx(true.largest, rel=1e-6)
    assert found.stress.yield_strength == 60e6
    np.testing.assert_allclose(found.deformed(10.0), true.vertices + 10 * true.displacement)


def test_its_middle_moves_as_the_displacement_says(served, solve):
    client, *_ = served
    found = client.deformed("sheet", FORCE, MOMENT)
    inside = np.linalg.norm(found.vertices[:, :2], axis=1) < 0.0601
    inside &= np.abs(found.vertices[:, 2]) < 1e-9
    patch = found.triangles[inside[found.triangles].all(axis=1)]
    corners = found.vertices[patch]
    area = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    mean = area @ found.displacement[patch].mean(axis=1) / area.sum()
    # Flat triangles between the nodes are not quite the section's own shape functions.
    assert np.linalg.norm(mean - solve.translation) < 1e-2 * np.linalg.norm(solve.translation)


def test_elsewhere_it_is_flagged(served, solve):
    client, *_ = served
    found = client.deformed("sheet", [0, 0, 500])
    assert (found.source, found.coverage, found.error) == ("rows", "thin", None)
    assert client.deformed("sheet", [1500, 0, 0]).coverage == "outside"


def test_the_reply_tells_the_frame(served, solve):
    client, *_ = served
    raw = client.deformed("sheet", FORCE, MOMENT).raw
    assert raw["frame"] == {"point": [0, 0, 0.004], "axes": np.eye(3).tolist()}
    assert (raw["force"], raw["moment"], raw["simplified"]) == (FORCE, MOMENT, None)


def test_far_beyond_the_range_it_is_refused(served, solve):
    client, *_ = served
    assert refused(client.deformed, "sheet", [1e300, 0, 0]).status == 409


def test_a_component_that_is_not_there_is_unknown(served):
    client, *_ = served
    assert refused(client.deformed, "nobody", FORCE).status == 404


def test_the_linear_plate_answers_every_wrench_once_one_is_solved(served):
    client, *_ = served
    client.displacement("flat", FORCE, on_thin="wait", wait_s=120)
    for force in ([10.0, 0, 0], [0, 0, -3.0]):
        found = client.deformed("flat", force)
        assert (found.source, found.coverage) == ("linear", "covered")
    one, ten = client.deformed("flat", [0, 0, -1]), client.deformed("flat", [0, 0, -10])
    np.testing.assert_allclose(ten.displacement, 10 * one.displacement, rtol=1e-12)
    assert ten.stress.largest == pytest.approx(10 * one.stress.largest, rel=1e-9)


def test_a_row_without_a_surface_gets_one_as_the_text_says(served, solve):
    client, _, data = served
    asked = [0.0, 0.0, -333.0]
    client.displacement("sheet", asked, on_thin="wait", wait_s=120)
    row = client.solve("sheet", asked).raw["row"]
    kept = client.deformed("sheet", asked).displacement
    shutil.rmtree(data / "fields" / "sheet")
    assert "none of its" in refused(client.deformed, "sheet", asked).detail
    client.call("DELETE", f"/v1/components/sheet/table/{row}")
    client.displacement("sheet", asked, on_thin="wait", wait_s=120)
    answer = client.solve("sheet", asked)
    if answer.job is not None:
        client.wait(answer.job.id, 120)
    found = client.deformed("sheet", asked)
    assert found.source == "row"
    np.testing.assert_array_equal(found.displacement, kept)


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
    assert len({one.displacement.tobytes() for one in shapes}) == 12
    assert quick.translation is not None
