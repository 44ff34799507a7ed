"""A component with temperature and acceleration as further inputs, over HTTP."""

import numpy as np
import pytest

from tests.service.test_http_components import bundle_zip, upload

URL = "/v1/components/hot"
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
    return http.post(f"{URL}/displacement", json=body)


@pytest.fixture
def hot(http, monkeypatch):
    """A server with a linear bar that the embedded solver has solved once."""
    monkeypatch.delenv("WRENCHBOOK_SOLVE")
    reply = upload(http, bundle_zip(HOT))
    assert reply.status_code == 201, reply.text
    reply = ask(http, 60.0, -9.81, on_thin="wait", wait_s=60)
    assert reply.status_code == 200, reply.text
    assert http.app.state.workspace.tables.catch_up("hot", 60.0)
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
    both, warm, pulled = (ask(hot, *one).json() for one in ((90, -9.81), (90, 0), (20, -9.81)))
    for place in range(3):
        total = warm["translation"][place] + pulled["translation"][place]
        assert both["translation"][place] == pytest.approx(total, rel=1e-9, abs=1e-15)


def test_a_missing_input_is_422_with_its_place_and_unit(hot):
    reply = hot.post(f"{URL}/displacement", json={**STILL, "inputs": {"temperature": 30}})
    assert reply.status_code == 422
    assert [one["loc"] for one in reply.json()["errors"]] == ["inputs.ax", "inputs.ay", "inputs.az"]
    assert "m/s^2" in reply.text


def test_a_temperature_beyond_its_range_is_named_with_the_range(hot):
    reply = ask(hot, 130.0, on_thin="reject")
    assert reply.status_code == 409
    assert "temperature = 130 degC is outside the load range, 0..120 degC" in reply.text


def test_a_job_has_its_inputs_by_name(hot):
    jobs = hot.get("/v1/jobs").json()["jobs"]
    job = next(one for one in jobs if one["inputs"] == inputs(60.0, -9.81))
    assert job["force"] == job["moment"] == [0.0] * 3
    assert job["translation"][0] == pytest.approx(LENGTH * EXPANSION * 40.0, rel=1e-6)


def test_the_compliance_has_the_displacement_where_all_inputs_are_zero(hot):
    ask(hot, 20.0, on_thin="wait")
    body = hot.get(f"{URL}/compliance").json()
    matrix, offset = np.array(body["matrix"]), np.array(body["offset"])
    moved = matrix @ [0, 0, 0, 0, 0, 0, 120.0, 0, 0, 0] + offset
    assert moved[0] == pytest.approx(EXPANSION * 100 * LENGTH, rel=1e-9)
    assert body["checks"]["symmetric"]["ok"]
    assert body["checks"]["positive"]["ok"]


def test_a_component_names_the_state_that_a_displacement_is_relative_to(hot):
    words = hot.get(URL).json()["interface"]["displacement"]
    assert words == "relative to the part without loads, at temperature 20 degC, ax 0 m/s^2, " + (
        "ay 0 m/s^2, az 0 m/s^2"
    )
