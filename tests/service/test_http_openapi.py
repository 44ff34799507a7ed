"""The OpenAPI document says what each call takes and what it can answer."""

from dataclasses import fields

import pytest
from starlette.testclient import TestClient

from wrenchbook import Displacement, Displacements
from wrenchbook.service import messages
from wrenchbook.service.http.app import create_app
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
    ("post", f"{COMPONENT}/table"): {"application/json", "text/csv"},
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
        found = problems(operation)
        assert {"500", "503"} <= found.keys(), (method, path)
        if "{" in path:
            assert {"404", "422"} <= found.keys(), (method, path)
        for code, one in found.items():
            reference = one["content"]["application/problem+json"]["schema"]["$ref"]
            assert reference == "#/components/schemas/Problem", (method, path, code)
            assert set(one["content"]) == {"application/problem+json"}, (method, path, code)
            assert one["description"]
    assert "detail" in document["components"]["schemas"]["Problem"]["required"]


def test_the_path_and_the_bodies_of_every_call_are_in_the_document(document):
    for method, path, operation in operations(document):
        named = {one["name"] for one in operation.get("parameters", []) if one["in"] == "path"}
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
    names = {one["name"] for one in batch["parameters"]}
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
