"""What the solver's own mesh is off, in the bars of surfaces and sweeps over HTTP."""

import json
import shutil
import sqlite3

import meshio
import numpy as np
import pytest

from tests.service.live import served
from tests.service.surfaces import write_bundle
from wrenchbook.service.workers.private import private_server

FORCE, MOMENT = [100.0, -50.0, -900.0], [10.0, 20.0, -5.0]
TOLERANCE = "\n[tolerance]\ntranslation = {}\nrotation = 1.0\n"
QUERY = "fx=100&fy=-50&fz=-900&mx=10&my=20&mz=-5"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A data directory in which a nonlinear and a linear plate were solved once."""
    place = tmp_path_factory.mktemp("solved")
    with private_server(place / "data", 2) as client:
        for name, linear in (("sheet", False), ("flat", True)):
            bundle = write_bundle(place, name, nonlinear=not linear)
            text = (bundle / "component.toml").read_text("utf-8")
            (bundle / "component.toml").write_text(text + TOLERANCE.format("1e-6"), "utf-8")
            client.add_component(bundle)
            assert client.solve(name, [*FORCE, *MOMENT], wait_s=120).source == "fea"
    return place / "data"


@pytest.fixture(scope="module")
def client(folder):
    with served(folder) as client:
        yield client


def shares_of(client, name):
    """The mesh's and the linearity's share of the interface's bars, (6,), m and rad."""
    body = json.dumps({"force": FORCE, "moment": MOMENT, "detail": True, "on_thin": "estimate"})
    headers = {"Content-Type": "application/json"}
    path = f"/v1/components/{name}/displacement"
    parts = client.call("POST", path, body.encode(), headers=headers).json()["error_parts"]
    causes = [cause for cause in ("mesh", "linearity") if cause in parts]
    return {cause: np.concatenate(list(parts[cause].values())) for cause in causes}


@pytest.mark.parametrize("name", ["sheet", "flat"])
def test_the_middle_of_the_interface_has_at_least_the_bar_of_the_displacement(client, name):
    found = client.deformed(name, FORCE, MOMENT)
    middle = np.linalg.norm(found.vertices, axis=1).argmin()
    assert np.linalg.norm(found.vertices[middle]) < 1e-9
    own = sum(shares_of(client, name).values())
    assert found.error[middle] >= np.linalg.norm(own[:3]) > 1e-6


def test_the_reply_tells_the_largest_of_each_share_and_where_it_is_from(client):
    parts = client.deformed("sheet", FORCE, MOMENT).error_parts
    assert list(parts) == ["table", "mesh", "mesh_basis"]
    assert parts["mesh"] > 1e-6 > 1e-12 > parts["table"] > 0
    assert "finer mesh of" in parts["mesh_basis"]


def test_a_linear_component_has_a_share_of_its_linearity(client):
    parts = client.deformed("flat", FORCE, MOMENT).error_parts
    assert parts["linearity"] > 0
    assert "nonlinear solves" in parts["linearity_basis"]


def test_a_covered_surface_whose_mesh_is_over_the_tolerance_says_so(client):
    found = client.deformed("sheet", FORCE, MOMENT)
    assert (found.coverage, found.within_tolerance) == ("covered", False)


def test_a_glb_tells_the_shares_in_its_extras_and_a_header(client):
    reply = client.call("GET", f"/v1/components/sheet/deformed?{QUERY}&format=gltf")
    size = int.from_bytes(reply.content[12:16], "little")
    (mesh,) = json.loads(reply.content[20 : 20 + size])["meshes"]
    told = client.deformed("sheet", FORCE, MOMENT)
    assert mesh["extras"]["error_parts"] == told.error_parts
    assert mesh["extras"]["within_tolerance"] is False
    assert reply.headers["Wrenchbook-Within-Tolerance"] == "false"


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


def test_where_nothing_tells_of_the_mesh_the_reply_says_that_and_how_to_learn_it(folder, tmp_path):
    shutil.copytree(folder, tmp_path / "data")
    db = sqlite3.connect(tmp_path / "data" / "ledger.sqlite")
    with db:
        db.execute("DELETE FROM solver_errors")
    db.close()
    with served(tmp_path / "data") as client:
        found = client.deformed("sheet", FORCE, MOMENT)
        sweep = client.call("GET", "/v1/components/sheet/response?load=fz&points=3").json()
    assert found.error_parts["mesh"] is None
    assert "the next solve of this component estimates it" in found.error_parts["mesh_basis"]
    assert found.within_tolerance is None
    assert found.error.max() == found.error_parts["table"]
    assert sweep["bars_are_whole"] is False
