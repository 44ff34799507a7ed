"""Measured components, without finite elements, with several interfaces or further inputs."""

import numpy as np
import pytest

from wrenchbook.fea.bundle.read import read_bundle
from wrenchbook.surrogate.table.spread import spread_wrenches

SPAN = {"force": [100, 100, 100], "moment": [5, [-2, 3], 5]}
TWO = [{"name": "left", "range": SPAN}, {"name": "right", "range": SPAN}]
WARM = {"temperature": {"unit": "degC", "range": [-20, 60], "reference": 20}}
PULLED = {"acceleration": {"range": [20, 20, 20]}}
TOLERANCE = {"translation": 1e-4, "rotation": 1e-3}


def add(http, **entries):
    body = {"name": "rig", "title": "A rig", "tolerance": TOLERANCE, **entries}
    return http.post("/v1/components", json=body)


def response(inputs, matrix, expansion):
    """Return displacements, shape (n, m), that a temperature behind the loads also stretches."""
    loads = inputs[:, : matrix.shape[1]]
    warm = inputs[:, matrix.shape[1] :] - WARM["temperature"]["reference"]
    own = loads @ matrix.T
    return own + (warm @ expansion if warm.shape[1] else 0.0)


def measured(http, count=80):
    """Return the component's range, its columns and rows of a linear response."""
    component = http.app.state.workspace.library["rig"]
    space, load_range = component.space, component.load_range
    loads = len(space.outputs)
    rng = np.random.default_rng(7)
    size = np.where(np.arange(loads) % 6 < 3, 1e-5, 1e-4)
    matrix = rng.uniform(-1, 1, (loads, loads)) * size
    expansion = rng.uniform(-1e-5, 1e-5, (len(space.scalars), loads))
    inputs = spread_wrenches(load_range, count)
    return space, matrix, expansion, inputs


def csv_of(space, inputs, outputs):
    heads = [f"{item.name} [{item.unit}]" for item in (*space.inputs, *space.outputs)]
    lines = [",".join(map(repr, row)) for row in np.hstack([inputs, outputs]).tolist()]
    return "\n".join([",".join(heads), *lines]) + "\n"


@pytest.mark.parametrize("entries", [{"interface": TWO}, {"range": SPAN, "inputs": WARM}])
def test_an_imported_table_answers_loads_and_inputs_between_its_rows(http, entries):
    assert add(http, **entries).status_code == 201
    space, matrix, expansion, inputs = measured(http)
    text = csv_of(space, inputs, response(inputs, matrix, expansion))
    sent = http.post(
        "/v1/components/rig/table",
        content=text,
        headers={"content-type": "text/csv"},
        params={"wait_s": 600},
    )
    assert sent.status_code == 200, sent.text
    assert (sent.json()["inserted"], sent.json()["in_use"]) == (80, True)
    query = 0.3 * inputs[3] + 0.3 * inputs[11] + 0.4 * inputs[40]
    reply = http.post("/v1/components/rig/displacement", json=space.by_name(query.tolist())).json()
    assert (reply["coverage"], reply["method"]) == ("covered", "kriging"), reply
    result = reply.get("displacements") or {"": reply}
    got = np.concatenate(
        [[*result[name]["translation"], *result[name]["rotation"]] for name in space.interfaces]
    )
    bars = np.concatenate(
        [
            [*result[name]["error"]["translation"], *result[name]["error"]["rotation"]]
            for name in space.interfaces
        ]
    )
    truth = response(query[None], matrix, expansion)[0]
    assert (np.abs(got - truth) <= bars).all(), (got - truth, bars)
    assert (bars <= np.where(space.is_rotation, 1e-3, 1e-4)).all()


def test_the_component_has_its_ranges_by_interface(http):
    body = add(http, interface=TWO, inputs={**WARM, **PULLED}).json()
    component = http.app.state.workspace.library["rig"]
    assert component.space.input_names[:2] == ("left.fx", "left.fy")
    assert component.space.input_names[12:] == ("temperature", "ax", "ay", "az")
    assert component.load_range.low[4] == -2.0
    assert component.space.zero[12] == 20.0
    assert body["interface"] is None
    assert body["interfaces"] == {}
    read = read_bundle(component.folder)
    assert [interface.name for interface in read.interfaces] == ["left", "right"]
    assert read.range.low.tolist() == [-100, -100, -100, -5, -2, -5] * 2
    assert read.further[0].reference == 20.0


def test_a_thin_query_of_a_measured_component_says_that_nothing_is_solved(http):
    add(http, interface=TWO)
    body = {"loads": {"left": {"force": [1, 0, 0], "moment": [0, 0, 0]}}}
    reply = http.post("/v1/components/rig/displacement", json=body)
    assert reply.status_code == 409
    assert "rig" in reply.text
