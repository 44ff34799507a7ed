"""Downloaded tables of components with several interfaces or further inputs."""

import sys
from types import SimpleNamespace

import numpy as np
import pytest

from tests.service.spaces import SPACE, M, N, add_link
from wrenchbook.service.client import Table
from wrenchbook.surrogate.kernel.binding import PackedTable

LOADS = {"left": [0.2, 0, 0, 0, 0.1, 0], "right": {"force": [0, -0.3, 0]}}
BODY = {
    "loads": {
        "left": {"force": [0.2, 0, 0], "moment": [0, 0.1, 0]},
        "right": {"force": [0, -0.3, 0]},
    },
    "inputs": {"temperature": 0.4},
}
URL = "/v1/components/two_ends"


@pytest.fixture
def table(http):
    add_link(http)
    return Table(PackedTable.from_bytes(http.get(f"{URL}/table?format=packed").content))


def test_an_answer_by_interface_is_the_servers(http, table):
    there = http.post(
        f"{URL}/displacement", json={**BODY, "on_thin": "estimate", "derivatives": True}
    ).json()
    here = table.answer(loads=LOADS, inputs={"temperature": 0.4}, derivatives=True)
    assert set(here.interfaces) == {"left", "right"}
    for name, own in here.interfaces.items():
        theirs = there["displacements"][name]
        np.testing.assert_array_equal(own.vector, [*theirs["translation"], *theirs["rotation"]])
        np.testing.assert_array_equal(own.error_translation, theirs["error"]["translation"])
    np.testing.assert_array_equal(here.derivative, there["derivative"])
    assert (here.coverage, here.method) == (there["coverage"], there["method"])
    np.testing.assert_array_equal(here.interfaces["right"].wrench, [0, -0.3, 0, 0, 0, 0])


def test_a_batch_has_the_tables_inputs_and_outputs(table):
    inputs = np.zeros((3, N))
    inputs[:, -1] = [0.1, 0.2, 0.3]
    found = table.batch(inputs, tolerance=(1e-3, 1e-3), derivatives=True)
    assert found.displacements.shape == (3, M)
    assert found.errors.shape == (3, M)
    assert found.derivatives.shape == (3, M, N)
    one = table.answer(loads={}, inputs={"temperature": 0.2})
    np.testing.assert_array_equal(found.displacements[1, :6], one.interfaces["left"].vector)


def test_stiffness_is_the_inverse_by_the_loads(table):
    query = {"loads": LOADS, "inputs": {"temperature": 0.4}}
    slope = table.answer(**query, derivatives=True).derivative
    product = table.stiffness(**query) @ slope[:, :M]
    np.testing.assert_allclose(product, np.eye(M), atol=1e-9)


@pytest.mark.parametrize(
    ("query", "words"),
    [
        ({"force": [0, 0, 1]}, "interfaces left, right: give loads by name"),
        ({"loads": {"middle": [0] * 6}, "inputs": {"temperature": 0}}, "no such interface"),
        ({"loads": LOADS}, "inputs.temperature: missing; give its value in degC"),
        ({"loads": LOADS, "inputs": {"pressure": 1, "temperature": 0}}, "no such input"),
        ({"loads": LOADS, "inputs": {"temperature": np.nan}}, "finite"),
        ({"force": [0, 0, 1], "loads": LOADS}, "either force and moment, or loads"),
        ({}, "give a force, a moment or loads"),
    ],
)
def test_a_query_that_does_not_fit_the_space_is_refused_by_name(table, query, words):
    with pytest.raises(ValueError, match=words):
        table.answer(**query)


def test_a_batch_of_single_wrenches_is_refused(table):
    with pytest.raises(ValueError, match=rf"shape \(n, {N}\)"):
        table.batch(np.zeros((2, 6)))


def test_its_columns_are_those_of_an_export(table, monkeypatch):
    pandas = SimpleNamespace(DataFrame=dict, concat=lambda frames, **_: frames[0])
    monkeypatch.setitem(sys.modules, "pandas", pandas)
    frame = table.to_pandas()
    assert list(frame)[1:3] == ["left.fx [N]", "left.fy [N]"]
    assert "temperature [degC]" in frame
    assert "right.rz [rad]" in frame
    assert "right.mz" in repr(table)
    assert "temperature [degC]" in table._repr_html_()


def test_the_space_has_the_names_of_the_inputs(table):
    assert table.space == SPACE
