"""A client that a public generator makes from the OpenAPI document, with a server."""

from __future__ import annotations

import importlib
import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.service.client.answers import bar_compliance
from tests.service.live import add_rows, as_rows, served
from wrenchbook.service.http.app import create_app
from wrenchbook.service.workspace import Settings

WRENCH = [10.0, -20.0, 30.0], [1.0, 2.0, -3.0]
BY_NAME = "from_a_document"
GENERATE_S = 300.0  # it takes 2 s


@pytest.fixture(scope="module")
def document():
    return create_app(Settings(Path("no-such-folder"))).openapi()


@pytest.fixture(scope="module")
def operations(document):
    return [one["operationId"] for path in document["paths"].values() for one in path.values()]


@pytest.fixture(scope="module")
def generated(document, tmp_path_factory):
    """The generated package, as its user imports it."""
    folder = tmp_path_factory.mktemp("generated")
    (folder / "openapi.json").write_text(json.dumps(document))
    command = [sys.executable, "-m", "openapi_python_client", "generate", "--meta", "none"]
    command += ["--path", "openapi.json", "--output-path", BY_NAME]
    made = subprocess.run(
        command, cwd=folder, capture_output=True, text=True, timeout=GENERATE_S, check=False
    )
    assert made.returncode == 0, made.stdout + made.stderr
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


def test_calls_have_names_that_a_person_would_choose(operations):
    assert all(re.fullmatch(r"[a-z]+(_[a-z]+){0,3}", name) for name in operations)
    assert {"displacement", "list_jobs", "import_table", "umbridge_evaluate"} <= set(operations)


def test_every_call_can_be_generated(generated, operations):
    folder = Path(generated("api").__path__[0])
    assert {path.stem for path in folder.glob("*/*.py")} - {"__init__"} == set(operations)


def test_no_two_calls_have_one_name(operations):
    assert len(set(operations)) == len(operations)
