"""UM-Bridge of a component of two interfaces and a temperature."""

from __future__ import annotations

import numpy as np
import pytest
from starlette.testclient import TestClient

from tests.service.spaces import SPACE, M, N, add_link
from tests.service.test_umbridge import ask, refused
from wrenchbook.service.http.app import create_app
from wrenchbook.service.workspace import Settings

WHERE = np.linspace(-0.5, 0.5, N).tolist()
QUERY = {"name": "two_ends", "input": [WHERE], "config": {"on_thin": "estimate"}}
PLACES = {"outWrt": 0, "inWrt": 0}


@pytest.fixture(scope="module")
def link(tmp_path_factory):
    with TestClient(create_app(Settings(tmp_path_factory.mktemp("two_ends"), solvers=0))) as client:
        add_link(client)
        yield client


@pytest.fixture
def table(link):
    return link.app.state.workspace.surrogate("two_ends").packed


def test_sizes_are_the_numbers_of_inputs_and_outputs(link):
    assert ask(link, "InputSizes", name="two_ends").json() == {"inputSizes": [len(SPACE.inputs)]}
    assert ask(link, "OutputSizes", name="two_ends").json() == {"outputSizes": [len(SPACE.outputs)]}


def test_evaluate_gives_the_tables_outputs(link, table):
    found = ask(link, "Evaluate", **QUERY).json()["output"]
    assert found == [list(table.answer(WHERE).outputs)]


def test_products_are_those_with_the_whole_jacobian(link, table):
    jacobian, sens, vec = table.derivative(WHERE), np.arange(1.0, M + 1), np.arange(1.0, N + 1)
    found = ask(link, "Gradient", **QUERY, **PLACES, sens=sens.tolist()).json()["output"]
    np.testing.assert_allclose(found, jacobian.T @ sens, rtol=1e-12)
    found = ask(link, "ApplyJacobian", **QUERY, **PLACES, vec=vec.tolist()).json()["output"]
    np.testing.assert_allclose(found, jacobian @ vec, rtol=1e-12)


@pytest.mark.parametrize("count", [6, N - 1, N + 1])
def test_a_vector_of_another_length_is_invalid_input_with_the_length(link, count):
    query = {**QUERY, "input": [[0.0] * count]}
    message = refused(ask(link, "Evaluate", **query), "InvalidInput")
    assert "input[0]" in message
    assert str(N) in message
