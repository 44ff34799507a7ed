"""The method of `serve --method`: answers of requests that name none."""

import pytest
from starlette.testclient import TestClient

from tests.service.live import as_rows, clean_wrenches, moved
from tests.until import until
from wrenchbook.service.http.app import create_app
from wrenchbook.service.workspace import Settings

CALL = "/v1/components/rig"
WRENCH = {"force": [12.0, 0, 0], "moment": [0, 1.5, 2.5], "on_thin": "estimate"}


@pytest.fixture(params=["griddata", "linear"])
def method(request):
    return request.param


@pytest.fixture
def http(tmp_path, method):
    with TestClient(create_app(Settings(tmp_path, solvers=0, method=method))) as http:
        span = {"force": [100.0] * 3, "moment": [10.0] * 3}
        http.post("/v1/components", json={"name": "rig", "title": "rig", "range": span})
        rows = as_rows(clean_wrenches(), moved(clean_wrenches()))
        http.post(f"{CALL}/table?format=json", json={"rows": rows})
        until(lambda: http.get(CALL).json()["table_version"] == len(rows))
        yield http


def test_the_servers_method_answers_a_request_that_names_none(http, method):
    assert http.post(f"{CALL}/displacement", json=WRENCH).json()["method"] == method
    batch = {"wrenches": [[12.0, 0, 0, 0, 1.5, 2.5]], "on_thin": "estimate"}
    assert http.post(f"{CALL}/displacements", json=batch).json()["method"] == method


def test_the_method_of_a_request_goes_before_the_servers(http):
    asked = {**WRENCH, "method": "additive"}
    assert http.post(f"{CALL}/displacement", json=asked).json()["method"] == "additive"
