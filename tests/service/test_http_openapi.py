"""The OpenAPI document says what each call takes and what it can answer."""

import importlib
import json
import re
import subprocess
import sys
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from starlette.testclient import TestClient

from tests.service.client.answers import bar_compliance
from tests.service.live import add_rows, as_rows, served
from wrenchbook import Displacement, Displacements
from wrenchbook.service import messages
from wrenchbook.service.http.app import create_app
from wrenchbook.service.http.openapi import TEXTS, places
from wrenchbook.service.workspace import Settings

COMPONENT = "/v1/components/{name}"
BODIES = {
    ("post", f"{COMPONENT}/displacement"): {"application/json"},
    ("post", f"{COMPONENT}/displacements"): {"application/json", "application/octet-stream"},
    ("post", f"{COMPONENT}/solve"): {"application/json"},
    ("post", f"{COMPONENT}/fill"): {"application/json"},
    ("post", f"{COMPONENT}/recording"): {"application/json", "application/octet-stream"},
    ("post", f"{COMPONENT}/recording/start"): {"application/json"},
    ("post", f"{COMPONENT}/table/resolve"): {"application/json"},
    ("post", f"{COMPONENT}/envelope"): {"application/json", "application/octet-stream"},
    ("post", f"{COMPONENT}/envelope/start"): {"application/json"},
    ("post", "/v1/components"): {"application/json", "multipart/form-data"},
    ("post", f"{COMPONENT}/table"): {
        *("application/json", "text/csv", "application/x-hdf5", "application/vnd.apache.parquet"),
        "application/vnd.openxmlformats-officedocument.spreadsheetml.sheet",
        *("application/octet-stream", "application/gzip", "multipart/form-data"),
    },
}
PLATE = "/v1/components/plate_thin"


@pytest.fixture(scope="module")
def http(tmp_path_factory):
    """A server without solvers: no call here is right, so none changes anything."""
    with TestClient(create_app(Settings(tmp_path_factory.mktemp("wrong"), solvers=0))) as client:
        yield client


@pytest.fixture(scope="module")
def document(http):
    return http.get("/openapi.json").json()


def operations(document):
    for path, of_path in document["paths"].items():
        for method, operation in of_path.items():
            yield method, path, operation


def problems(operation):
    return {code: one for code, one in operation["responses"].items() if code >= "400"}


def test_every_error_is_documented_as_a_problem_and_never_as_json(document):
    for method, path, operation in operations(document):
        if path.startswith(("/health", "/metrics", "/umbridge")):  # errors of their own form
            continue
        result = problems(operation)
        assert {"500", "503"} <= result.keys(), (method, path)
        if "{" in path:
            assert {"404", "422"} <= result.keys(), (method, path)
        for code, one in result.items():
            reference = one["content"]["application/problem+json"]["schema"]["$ref"]
            assert reference == "#/components/schemas/Problem", (method, path, code)
            assert set(one["content"]) == {"application/problem+json"}, (method, path, code)
            assert one["description"]
    assert "detail" in document["components"]["schemas"]["Problem"]["required"]


def test_each_field_parameter_call_and_reply_has_a_description(document):
    for item, key, *tables in places(document):
        assert item.get("description"), (tables[0], key)
    for method, path, operation in operations(document):
        assert operation["summary"], (method, path)
        texts = [reply["description"] for reply in operation["responses"].values()]
        assert all(text and text != "Successful Response" for text in texts), (method, path)


def test_each_text_of_the_toml_file_is_in_the_document(document):
    used = {
        (next((table for table in tables if key in TEXTS.get(table, ())), ""), key)
        for _, key, *tables in places(document)
    }
    assert {(table, key) for table, keys in TEXTS.items() for key in keys} <= used


def test_the_path_and_the_bodies_of_every_call_are_in_the_document(document):
    for method, path, operation in operations(document):
        named = {item["name"] for item in operation.get("parameters", []) if item["in"] == "path"}
        assert all(f"{{{name}}}" in path for name in named)
        assert path.count("{") == len(named), (method, path)
        for kind in BODIES.get((method, path), ()):
            schema = operation["requestBody"]["content"][kind]["schema"]
            if "$ref" in schema:
                schema = document["components"]["schemas"][schema["$ref"].rsplit("/", 1)[-1]]
            assert schema["type"] in ("object", "string"), (method, path, kind)


def test_the_binary_batch_is_in_the_document(document):
    batch = document["paths"][f"{COMPONENT}/displacements"]["post"]
    assert "octet-stream" in str(list(batch["responses"]["200"]["content"]))
    assert "octet-stream" in str(list(batch["responses"]["202"]["content"]))
    names = {parameter["name"] for parameter in batch["parameters"]}
    assert names >= {"on_thin", "wait_s", "method", "translation", "rotation", "beyond_range"}


@pytest.mark.parametrize(
    ("path", "codes"),
    [
        (f"{COMPONENT}/displacement", {"200", "202", "404", "409", "422", "424"}),
        (f"{COMPONENT}/solve", {"200", "202", "404", "409", "422", "424"}),
        (f"{COMPONENT}/displacements", {"200", "202", "404", "409", "422"}),
        (f"{COMPONENT}/fill", {"200", "202", "404", "409", "422"}),
        (f"{COMPONENT}/recording", {"200", "201", "404", "409", "413", "422"}),
        (f"{COMPONENT}/recording/start", {"200", "202", "404", "409", "422"}),
        (f"{COMPONENT}/table/resolve", {"200", "202", "404", "409", "422"}),
        (f"{COMPONENT}/envelope", {"200", "404", "409", "413", "422"}),
        (f"{COMPONENT}/envelope/start", {"200", "202", "404", "409", "422"}),
        ("/v1/components", {"201", "409", "415", "422"}),
        (f"{COMPONENT}/table", {"200", "404", "413", "415", "422"}),
    ],
)
def test_a_call_documents_what_the_contract_says_it_answers(document, path, codes):
    assert codes <= document["paths"][path]["post"]["responses"].keys()


def test_the_document_is_sent_once_to_a_caller_that_keeps_it(http):
    first = http.get("/openapi.json")
    assert first.headers["content-type"] == "application/json"
    again = http.get("/openapi.json", headers={"if-none-match": first.headers["etag"]})
    assert (again.status_code, again.content) == (304, b"")
    assert again.headers["etag"] == first.headers["etag"]
    assert http.get("/openapi.json", headers={"if-none-match": '"other"'}).content == first.content


def test_the_document_is_not_rendered_anew_at_each_get(http, monkeypatch):
    first = http.get("/openapi.json").content
    monkeypatch.setattr("wrenchbook.service.http.openapi.get_openapi", None)
    assert http.get("/openapi.json").content == first


def test_a_displacement_is_described_once_for_the_document_the_reply_and_the_client(http, document):
    options = {"on_thin": "estimate", "detail": True, "derivatives": True}
    one = http.post(f"{PLATE}/displacement", json={"force": [0, 0, 1], **options}).json()
    options = {"on_thin": "estimate", "derivatives": True}
    many = http.post(f"{PLATE}/displacements", json={"wrenches": [[0] * 6], **options}).json()
    for kind, of_client, reply in (
        (messages.Displacement, Displacement, one),
        (messages.Displacements, Displacements, many),
    ):
        names = {field.name for field in fields(kind)}
        schema = document["components"]["schemas"][kind.__name__]
        assert set(schema["properties"]) == names
        assert set(schema["required"]) <= reply.keys() <= names
        assert issubclass(of_client, kind)


# -- a client that is generated from the document ------------------------------------------------

WRENCH = [10.0, -20.0, 30.0], [1.0, 2.0, -3.0]
BY_NAME = "from_a_document"
GENERATE_S = 300.0  # it takes 2 s


@pytest.fixture(scope="module")
def operation_ids(document):
    return [item["operationId"] for path in document["paths"].values() for item in path.values()]


@pytest.fixture(scope="module")
def generated(document, tmp_path_factory):
    """The generated package, as its user imports it."""
    folder = tmp_path_factory.mktemp("generated")
    (folder / "openapi.json").write_text(json.dumps(document))
    command = [sys.executable, "-m", "openapi_python_client", "generate", "--meta", "none"]
    command += ["--path", "openapi.json", "--output-path", BY_NAME]
    created = subprocess.run(
        command, cwd=folder, capture_output=True, text=True, timeout=GENERATE_S, check=False
    )
    assert created.returncode == 0, created.stdout + created.stderr
    sys.path.insert(0, str(folder))
    yield lambda module: importlib.import_module(f"{BY_NAME}.{module}")
    sys.path.remove(str(folder))


@pytest.fixture(scope="module")
def url(tmp_path_factory):
    with served(tmp_path_factory.mktemp("workspace")) as client:
        wrench = np.full((1, 6), 1.0)
        add_rows(
            client, "bar", as_rows(wrench, wrench @ bar_compliance().T, bar_compliance()[None])
        )
        yield client.url


def test_a_generated_client_reads_a_displacement(generated, url):
    call = generated("api.displacement.displacement")
    body = generated("models").DisplacementBody(force=WRENCH[0], moment=WRENCH[1])
    with generated("client").Client(base_url=url) as client:
        answer = call.sync("bar", client=client, body=body)
    expected = bar_compliance() @ np.concatenate(WRENCH)
    np.testing.assert_allclose([*answer.translation, *answer.rotation], expected, rtol=1e-9)
    assert answer.coverage == "covered"


def test_a_generated_client_reads_a_problem(generated, url):
    call = generated("api.components.get_component")
    with generated("client").Client(base_url=url) as client:
        problem = call.sync("nowhere", client=client)
    assert problem.status == 404
    assert "nowhere" in problem.detail


def test_calls_have_names_that_a_person_would_choose(operation_ids):
    assert all(re.fullmatch(r"[a-z]+(_[a-z]+){0,3}", name) for name in operation_ids)
    assert {"displacement", "list_jobs", "import_table", "umbridge_evaluate"} <= set(operation_ids)


def test_every_call_can_be_generated(generated, operation_ids):
    folder = Path(generated("api").__path__[0])
    assert {path.stem for path in folder.glob("*/*.py")} - {"__init__"} == set(operation_ids)


def test_no_two_calls_have_one_name(operation_ids):
    assert len(set(operation_ids)) == len(operation_ids)
