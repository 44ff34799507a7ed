"""Components with further inputs or several interfaces, over HTTP."""

import numpy as np
import pytest
from starlette.testclient import TestClient

from tests.fea.two_interfaces import LINK
from tests.service.test_http_components import bundle_zip, upload
from wrenchbook.service.http.app import create_app
from wrenchbook.service.workspace import Settings

HOT_URL = "/v1/components/hot"
EXPANSION, LENGTH = 23e-6, 0.4
HOT = f"""
name = "hot"
title = "A bar that is heated"
[mesh]
generator = "bar"
length = {LENGTH}
width = 0.02
height = 0.02
cells_along = 10
[[material]]
region = "all"
youngs_modulus = 70e9
poisson_ratio = 0.0
density = 2700.0
thermal_expansion = {EXPANSION}
[supports]
fixed = ["start"]
[interface]
section = "end"
coupling = "distributed"
[inputs.temperature]
range = [0, 120]
reference = 20
[inputs.acceleration]
range = [20, 20, 20]
[range]
force = [200, 200, 200]
moment = [5, 5, 5]
[analysis]
nonlinear = false
[tolerance]
translation = 1e-4
rotation = 1e-3
"""
STILL = {"force": [0, 0, 0], "moment": [0, 0, 0]}


def inputs(temperature, az=0.0):
    return {"temperature": temperature, "ax": 0.0, "ay": 0.0, "az": az}


def ask(http, temperature, az=0.0, **options):
    body = {**STILL, "inputs": inputs(temperature, az), **options}
    return http.post(f"{HOT_URL}/displacement", json=body)


@pytest.fixture(scope="module")
def http(tmp_path_factory):
    with TestClient(create_app(Settings(tmp_path_factory.mktemp("spaces"), solvers=2))) as client:
        yield client


@pytest.fixture(scope="module")
def hot(http):
    """A server with a linear bar that the embedded solver has solved once."""
    reply = upload(http, bundle_zip(HOT))
    assert reply.status_code == 201, reply.text
    reply = ask(http, 60.0, -9.81, on_thin="wait", wait_s=60)
    assert reply.status_code == 200, reply.text
    assert http.app.state.workspace.tables.catch_up("hot", 600)
    return http


def test_a_free_bar_expands_by_the_expansion_of_its_material(hot):
    body = ask(hot, 100.0).json()
    assert body["coverage"] == "covered"
    assert body["translation"][0] == pytest.approx(LENGTH * EXPANSION * 80.0, rel=1e-9)
    assert body["translation"][2] == pytest.approx(0.0, abs=1e-15)


def test_a_bar_at_its_reference_temperature_does_not_move(hot):
    body = ask(hot, 20.0).json()
    assert body["translation"] == pytest.approx([0.0] * 3, abs=1e-15)


def test_the_mesh_adds_no_error_at_the_reference_temperature(hot):
    assert ask(hot, 20.0).json()["error"]["translation"][2] < 1e-9
    assert ask(hot, 20.0, -9.81).json()["error"]["translation"][2] > 1e-9


def test_temperature_and_acceleration_add_up(hot):
    both, warm, pulled = (ask(hot, *item).json() for item in ((90, -9.81), (90, 0), (20, -9.81)))
    for place in range(3):
        total = warm["translation"][place] + pulled["translation"][place]
        assert both["translation"][place] == pytest.approx(total, rel=1e-9, abs=1e-15)


def test_a_missing_input_is_422_with_its_place_and_unit(hot):
    reply = hot.post(f"{HOT_URL}/displacement", json={**STILL, "inputs": {"temperature": 30}})
    assert reply.status_code == 422
    assert [error["loc"] for error in reply.json()["errors"]] == [
        "inputs.ax",
        "inputs.ay",
        "inputs.az",
    ]
    assert "m/s^2" in reply.text


def test_a_temperature_beyond_its_range_is_named_with_the_range(hot):
    reply = ask(hot, 130.0, on_thin="reject")
    assert reply.status_code == 409
    assert "temperature = 130 degC is outside the load range, 0..120 degC" in reply.text


def test_a_job_has_its_inputs_by_name(hot):
    jobs = hot.get("/v1/jobs").json()["jobs"]
    job = next(item for item in jobs if item["inputs"] == inputs(60.0, -9.81))
    assert job["force"] == job["moment"] == [0.0] * 3
    assert job["translation"][0] == pytest.approx(LENGTH * EXPANSION * 40.0, rel=1e-6)


def test_the_compliance_has_the_displacement_where_all_inputs_are_zero(hot):
    ask(hot, 20.0, on_thin="wait")
    body = hot.get(f"{HOT_URL}/compliance").json()
    matrix, offset = np.array(body["matrix"]), np.array(body["offset"])
    moved = matrix @ [0, 0, 0, 0, 0, 0, 120.0, 0, 0, 0] + offset
    assert moved[0] == pytest.approx(EXPANSION * 100 * LENGTH, rel=1e-9)
    assert body["checks"]["symmetric"]["ok"]
    assert body["checks"]["positive"]["ok"]


def test_a_component_names_the_state_that_a_displacement_is_relative_to(hot):
    text = hot.get(HOT_URL).json()["interface"]["displacement"]
    assert text == "relative to the part without loads, at temperature 20 degC, ax 0 m/s^2, " + (
        "ay 0 m/s^2, az 0 m/s^2"
    )


# -- two interfaces ------------------------------------------------------------------------------

URL = "/v1/components/two_ends"
RIGHT = {"loads": {"right": {"force": [0, 10, 1]}}}


@pytest.fixture(scope="module")
def solved(http):
    """A server with a linear link, held at its left interface, whose compliance is known."""
    reply = upload(http, bundle_zip(LINK))
    assert reply.status_code == 201, reply.text
    reply = http.post(f"{URL}/displacement", json={**RIGHT, "on_thin": "wait", "wait_s": 60})
    assert reply.status_code == 200, reply.text
    # The answer also queued the solves of the compliance. A glance shows the present table;
    # the component waits for the table with all rows.
    for job in http.get("/v1/jobs").json()["jobs"]:
        assert http.get(f"/v1/jobs/{job['id']}", params={"wait_s": 60}).json()["status"] == "done"
    assert http.get(URL, params={"wait_s": 60}).json()["pending_rows"] == 0
    return http


def test_the_component_names_its_inputs_its_range_and_its_interfaces(solved):
    body = solved.get(URL).json()
    assert [item["name"] for item in body["space"]["inputs"]][6:8] == ["right.fx", "right.fy"]
    assert body["range"]["loads"]["right"]["force"][2] == [-200.0, 200.0]
    assert body["interfaces"]["left"]["held"] is True
    assert body["interface"] is None


def test_a_glance_tells_the_covered_share_of_several_interfaces_and_the_bar_of_each_output(solved):
    body = solved.get(f"{URL}/glance").json()
    assert body["whole"] == [1.0, 0.0, 0.0]
    assert len(body["error"]) == 12
    assert body["axes"] == {}


def test_a_load_at_one_interface_moves_it_and_not_the_held_one(solved):
    body = solved.post(f"{URL}/displacement", json=RIGHT).json()
    assert body["coverage"] == "covered"
    assert body["displacements"]["left"]["translation"] == [0.0, 0.0, 0.0]
    moved = body["displacements"]["right"]
    assert moved["translation"][1] == pytest.approx(10 * moved["translation"][2])
    assert moved["error"]["translation"][1] > 0.0


def test_a_batch_has_the_digits_of_the_single_answers(solved):
    single = solved.post(f"{URL}/displacement", json=RIGHT).json()["displacements"]["right"]
    wrench = [0.0] * 6 + [0.0, 10.0, 1.0, 0.0, 0.0, 0.0]
    many = solved.post(f"{URL}/displacements", json={"wrenches": [wrench]}).json()
    assert many["displacements"][0][6:9] == single["translation"]
    assert many["within_tolerance"] == [True]
    block = np.array([wrench]).astype("<f8").tobytes()
    kind = {"content-type": "application/octet-stream"}
    reply = solved.post(f"{URL}/displacements", content=block, headers=kind)
    numbers = np.frombuffer(reply.content)
    assert reply.headers["Wrenchbook-Outputs"] == "12"
    assert numbers.tolist() == many["displacements"][0] + many["errors"][0] + [0.0]


def test_the_parts_of_an_error_bar_are_those_of_each_interface(solved):
    body = solved.post(f"{URL}/displacement", json={**RIGHT, "detail": True}).json()
    assert set(body["error_parts"]["table"]) == {"left", "right"}


def test_the_compliance_is_twelve_by_twelve_and_symmetric(solved):
    body = solved.get(f"{URL}/compliance").json()
    matrix = np.array(body["matrix"])
    assert matrix.shape == (12, 12)
    assert np.abs(matrix - matrix.T).max() <= 1e-9 * np.abs(matrix).max()
    assert body["columns"][6] == "right.fx [N]"


def test_coverage_has_no_gaps_by_axis(solved):
    assert solved.get(f"{URL}/coverage").json()["gaps"] == []


def test_a_job_has_loads_and_displacements_by_interface(solved):
    jobs = solved.get("/v1/jobs").json()["jobs"]
    job = next(item for item in jobs if item["loads"]["right"]["force"] == [0.0, 10.0, 1.0])
    assert job["loads"]["left"]["moment"] == [0.0] * 3
    assert job["displacements"]["left"]["translation"] == [0.0] * 3
    assert job["displacements"]["right"]["translation"][1] != 0.0


def test_a_block_of_the_longest_numbers_of_12_inputs_is_taken(solved):
    """The limit of its bytes was that of six inputs."""
    wrenches = [[-0.12345678901234567] * 12] * 10_000
    reply = solved.post(f"{URL}/envelope", json={"wrenches": wrenches})
    assert reply.json()["recorded"] == 10_000


@pytest.mark.parametrize(
    ("wrench", "where", "why"),
    [
        ([0.0] * 11 + ["1"], "wrenches.0.11", "number"),
        ([0.0] * 6, "wrenches.0", "has 6 numbers, but the component has 12 inputs"),
    ],
)
def test_a_mistake_in_a_block_of_12_inputs_has_its_place(solved, wrench, where, why):
    reply = solved.post(f"{URL}/recording", json={"wrenches": [wrench]})
    (mistake,) = reply.json()["errors"]
    assert mistake["loc"] == where
    assert why in mistake["msg"]


@pytest.mark.parametrize("call", ["recording", "envelope", "displacements"])
def test_float64_of_six_inputs_is_not_read_as_wrenches_of_12(solved, call):
    """Four wrenches of six numbers are as many bytes as two of 12."""
    query = {"inputs": 6} | ({"on_thin": "estimate"} if call == "displacements" else {})
    kind = {"content-type": "application/octet-stream"}
    content = np.ones((4, 6), dtype="<f8").tobytes()
    reply = solved.post(f"{URL}/{call}", content=content, params=query, headers=kind)
    assert "has 6 numbers, but the component has 12 inputs" in reply.json()["detail"]
