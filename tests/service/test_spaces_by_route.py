"""The same component of several interfaces and a temperature by each route: answers or refusals."""

import pytest

from tests.service.spaces import N, add_link
from wrenchbook.service.cli import render
from wrenchbook.service.cli.main import _loads
from wrenchbook.service.client import Scene
from wrenchbook.service.client.errors import InvalidArgument
from wrenchbook.service.client.scene import SceneError
from wrenchbook.service.fmu.export import describe, make_fmu
from wrenchbook.service.tables.mapped import ServedTable
from wrenchbook.surrogate.answer import UnknownMethodError
from wrenchbook.surrogate.kernel.binding import PackedTable
from wrenchbook.surrogate.table.space import Input, space_of

URL = "/v1/components/two_ends"
BODY = {"loads": {"left": {"force": [0.2, 0, 0]}}, "inputs": {"temperature": 0.4}}


@pytest.fixture
def two_ends(http):
    add_link(http)
    return http


@pytest.mark.parametrize("method", ["griddata", "additive"])
def test_a_method_of_axes_is_422_for_several_interfaces(two_ends, method):
    for call, body in (
        ("displacement", BODY),
        ("displacements", {"wrenches": [[0.0] * N]}),
    ):
        body = {**body, "method": method, "on_thin": "estimate"}
        reply = two_ends.post(f"{URL}/{call}", json=body)
        assert reply.status_code == 422, reply.text
        assert "one wrench at one interface" in reply.json()["detail"]


def test_a_servers_method_of_axes_leaves_such_a_table_its_own(two_ends):
    table = two_ends.app.state.workspace.tables.surrogate("two_ends")
    assert ServedTable(table.packed, method="griddata").default == "kriging"
    assert two_ends.post(f"{URL}/displacement", json=BODY).json()["method"] == "kriging"


def test_an_fmu_by_a_method_that_the_table_lacks_is_refused(two_ends):
    packed = PackedTable.from_bytes(two_ends.get(f"{URL}/table?format=packed").content)
    with pytest.raises(UnknownMethodError, match="one wrench at one interface"):
        make_fmu("two_ends", packed, "griddata")


def test_an_fmus_temperature_starts_at_its_reference():
    space = space_of(("",), [Input("temperature", "degC", "scalar", zero=20.0)])
    xml = describe("hot", "guid", "now", "a table", space).decode()
    assert '<Real unit="degC" start="20"' in xml or 'start="20"' in xml


def test_tables_on_the_command_line_have_the_names_of_all_inputs(two_ends):
    found = two_ends.get(f"{URL}/compliance").json()
    heads = [column.header for column in render.compliance_tables(found)[0].columns]
    assert heads[1] == "left.fx"
    assert heads[-1] == "temperature"


def test_the_list_of_components_has_the_forces_by_interface():
    loads = {"force": [[-1, 1]] * 3, "moment": [[-2, 2]] * 3}
    one = {
        "name": "arm",
        "title": "An arm",
        "rows": 3,
        "has_fea": True,
        "linear": False,
        "range": {"loads": {"left": loads, "right": loads}},
    }
    assert list(render.component_table([one]).columns[4].cells) == ["left 1 1 1; right 1 1 1"]


def test_an_envelope_names_its_inputs_and_outputs(two_ends):
    two_ends.post(f"{URL}/envelope", json={"wrenches": [[0.1] * N]})
    found = two_ends.get(f"{URL}/envelope").json()
    assert found["inputs"][-1] == "temperature"
    assert len(found["inputs"]) == len(found["min"]) == N
    assert len(found["outputs"]) == len(found["displacement_bound"])


@pytest.mark.parametrize(
    ("option", "load", "further"),
    [("--load right", ["right=1,0,0", "right=2,0,0"], None), ("--input t", None, ["t=1", "t=2"])],
)
def test_an_option_that_is_given_twice_for_one_name_is_refused(option, load, further):
    with pytest.raises(InvalidArgument, match=f"{option} is given twice"):
        _loads(None, None, load, further)


def test_a_scene_takes_loads_by_interface_and_further_inputs(two_ends):
    span = {"force": [[0, 0], [0, 0], [-1, 0]], "moment": [0, 0, 0]}
    need = {
        "loads": {"right": span},
        "inputs": {"temperature": [0, 1]},
        "outputs": ["right.uz", "right.rx"],
    }
    scene = Scene({"two_ends": need})
    reply = two_ends.post("/v1/scenes/plan", json={"components": scene.components})
    assert reply.status_code == 200, reply.text
    wanted = scene.wanted("two_ends")
    assert wanted["range"]["loads"]["right"]["force"][2] == [-1.0, 0.0]
    assert wanted["range"]["inputs"] == {"temperature": [0.0, 1.0]}
    assert wanted["outputs"] == ["right.uz", "right.rx"]


def test_a_scenes_mistake_is_named_by_interface():
    with pytest.raises(SceneError, match=r"components.link.loads.right: unknown torque"):
        Scene({"link": {"loads": {"right": {"torque": [0, 0, 0]}}}})
    with pytest.raises(SceneError, match=r"components.link.inputs.temperature: \[low, high\]"):
        Scene({"link": {"loads": {}, "inputs": {"temperature": "warm"}}})
