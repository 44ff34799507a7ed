"""Calls of a component with two interfaces: loads at each, a displacement of each."""

import numpy as np
import pytest

from tests.fea.two_interfaces import LINK
from tests.service.test_http_components import bundle_zip, upload

URL = "/v1/components/two_ends"
RIGHT = {"loads": {"right": {"force": [0, 10, 1]}}}


@pytest.fixture
def link(http):
    """A server with a linear link that is held at its left interface."""
    reply = upload(http, bundle_zip(LINK))
    assert reply.status_code == 201, reply.text
    return http


@pytest.fixture
def solved(link):
    """The same once its compliance is known."""
    reply = link.post(f"{URL}/displacement", json={**RIGHT, "on_thin": "wait", "wait_s": 60})
    assert reply.status_code == 200, reply.text
    return link


def test_the_component_names_its_inputs_its_range_and_its_interfaces(link):
    body = link.get(URL).json()
    assert [one["name"] for one in body["space"]["inputs"]][6:8] == ["right.fx", "right.fy"]
    assert body["range"]["loads"]["right"]["force"][2] == [-200.0, 200.0]
    assert body["interfaces"]["left"]["held"] is True
    assert body["interface"] is None


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
    job = next(one for one in jobs if one["loads"]["right"]["force"] == [0.0, 10.0, 1.0])
    assert job["loads"]["left"]["moment"] == [0.0] * 3
    assert job["displacements"]["left"]["translation"] == [0.0] * 3
    assert job["displacements"]["right"]["translation"][1] != 0.0
