"""POST /v1/scenes/plan, and filling and downloading as it says."""

from __future__ import annotations

import json
import pickle
from collections.abc import Iterator
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from starlette.testclient import TestClient

from tests.service.live import (
    FULL,
    add_rows,
    add_table,
    as_rows,
    full_wrenches,
    moved,
    served,
    tangents,
)
from tests.service.spaces import SPACE, N, add_component, add_link
from wrenchbook.service.cli import render
from wrenchbook.service.cli.main import _loads
from wrenchbook.service.client import (
    Client,
    InvalidArgument,
    ProblemError,
    Scene,
    SceneError,
    Table,
)
from wrenchbook.service.client.mount import DisplacementUnknown, Mount, MountWarning
from wrenchbook.service.demand import DemandMaps
from wrenchbook.service.fmu.export import make_fmu
from wrenchbook.service.http.app import create_app
from wrenchbook.service.ledger import Ledger
from wrenchbook.service.tables.mapped import ServedTable
from wrenchbook.service.workspace import Settings
from wrenchbook.surrogate.answer import UnknownMethodError
from wrenchbook.surrogate.table.rows import LoadRange

CALL = "/v1/scenes/plan"
NONE = [[0.0, 0.0]] * 3
PLANAR = {"force": [[-100, 100], [0, 0], [-100, 50]], "moment": [[0, 0], [-10, 10], [0, 0]]}
ON_RIG = {"rig": {**PLANAR, "outputs": ["ux", "uz", "ry"]}}
CORNERS = np.array(list(product((-100, 100), [0], (-100, 50), [0], (-10, 10), [0])), float)
KEYS = {
    "decision", "reason", "loads", "axes", "outputs", "displacement_bound", "solves", "saves",
}  # fmt: skip


@pytest.fixture(scope="module")
def client(tmp_path_factory) -> Iterator[Client]:
    with served(tmp_path_factory.mktemp("scenes") / "workspace") as created:
        # The corners of the scene too: a bound takes answers whose errors are known there.
        wrenches = np.concatenate((full_wrenches(40), CORNERS))
        add_table(created, "rig", as_rows(wrenches, moved(wrenches), tangents(wrenches)))
        yield created


def body(**more: object) -> dict:
    return {"components": {"plate_thin": {**PLANAR, **more}}}


def test_a_plan_tells_what_is_needed_and_what_is_left_out(http):
    reply = http.post(CALL, json=body(outputs=["uz", "rx"]))
    assert reply.status_code == 200
    reported = reply.json()["components"]["plate_thin"]
    assert reported.keys() >= KEYS
    assert reported["loads"] == ["fx", "fz", "my"]
    assert reported["outputs"] == ["uz", "rx"]
    assert reported["axes"]["z"] == {"inputs": ["fz", "my"], "dimensions": 2}
    assert reported["solves"] == {"whole": 9, "scene": 6}
    assert reported["displacement_bound"] == [None] * 6
    assert reported["saves"] == {"build_s": None, "memory_bytes": None, "us_per_answer": None}
    assert "no rows yet" in reported["saves_from"]["build_s"]


def test_a_scene_narrower_than_wrenches_are_told_apart_is_planned_too(http):
    speck = {"force": [[-1e-308, 1e-308], [0, 0], [0, 0]], "moment": NONE}
    reply = http.post(CALL, json={"components": {"plate_thin": speck}})
    assert reply.status_code == 200
    reported = reply.json()["components"]["plate_thin"]
    assert reported["solves"] == {"whole": 9, "scene": 1}


def test_a_fill_of_the_scene_queues_the_solves_of_its_plan_and_no_others(http, stand_in):
    stand_in("endless")
    planned = http.post(CALL, json=body()).json()["components"]["plate_thin"]["solves"]["scene"]
    wanted = {"range": PLANAR, "budget": 100}
    reply = http.post("/v1/components/plate_thin/fill", json=wanted)
    assert reply.status_code == 202
    jobs = [http.get(item["url"]).json() for item in reply.json()["jobs"]]
    assert len(jobs) == planned == 6
    wrenches = np.array([job["force"] + job["moment"] for job in jobs])
    assert (wrenches[:, [1, 3, 5]] == 0).all()
    whole = http.post("/v1/components/plate_ccx/fill", json={"budget": 100}).json()["jobs"]
    assert len(whole) == 9


def test_a_fill_of_a_scene_that_is_rigid_queues_nothing(http):
    wanted = {"range": {"force": NONE, "moment": NONE}}
    reply = http.post("/v1/components/plate_thin/fill", json=wanted)
    assert (reply.status_code, reply.json()["stage"]) == (200, "met")
    assert "no load can occur" in reply.json()["reason"]
    assert http.get("/v1/jobs").json()["jobs"] == []


def test_a_scene_of_more_components_than_may_be_is_422_with_the_place(http):
    reply = http.post(CALL, json={"components": {f"c{n}": PLANAR for n in range(65)}})
    assert (reply.status_code, reply.json()["errors"][0]["loc"]) == (422, "components")


def test_a_scene_plans_itself_by_a_client(client: Client):
    plan = Scene(ON_RIG).plan(client)["rig"]
    assert plan.decision == "table"
    assert plan.saves["memory_bytes"] > 0
    assert plan.saves["build_s"] > 0
    assert "measured" in plan.saves_from["us_per_answer"]
    low, high = np.array(PLANAR["force"] + PLANAR["moment"], dtype=float).T
    asked = np.random.default_rng(1).uniform(size=(500, 6)) * (high - low) + low
    assert (np.abs(moved(asked)) <= plan.displacement_bound).all()


READ = [0, 2, 4]


def test_outputs_that_a_scene_leaves_out_are_unknown_and_the_others_as_of_the_whole_table(client):
    part, whole = client.download("rig", scene=Scene(ON_RIG)), client.download("rig")
    asked = full_wrenches(50, 3) * np.isin(np.arange(6), READ)
    asked[:, 2] = -np.abs(asked[:, 2])
    result, full = part.batch(asked, derivatives=True), whole.batch(asked)
    np.testing.assert_array_equal(result.displacements[:, READ], full.displacements[:, READ])
    np.testing.assert_array_equal(result.errors[:, READ], full.errors[:, READ])
    for unknown in (result.displacements[:, [1, 3, 5]], result.derivatives[:, [1, 3, 5]]):
        assert np.isnan(unknown).all()


def test_a_downloaded_scene_tells_the_plan_that_it_follows(client: Client):
    scene = Scene(ON_RIG)
    plan = client.download("rig", scene=scene).plan
    assert plan is not None
    assert (plan.loads, plan.outputs) == (("fx", "fz", "my"), ("ux", "uz", "ry"))
    assert plan.decision == scene.plan(client)["rig"].decision
    assert client.download("rig").plan is None


def test_a_downloaded_scene_survives_a_pickle_and_a_file_and_follows_the_server(
    client: Client, tmp_path: Path
):
    wrenches = full_wrenches(30, 7)
    add_table(client, "grows", as_rows(wrenches, moved(wrenches), tangents(wrenches)))
    scene = Scene({"grows": ON_RIG["rig"]})
    part = client.download("grows", scene=scene)
    again = pickle.loads(pickle.dumps(part))
    asked = FULL * [0.3, 0, -0.2, 0, 0.1, 0]
    np.testing.assert_array_equal(part.answer(asked).vector, again.answer(asked).vector)
    part.save(tmp_path / "part.wbt")
    opened = Table.open(tmp_path / "part.wbt")
    np.testing.assert_array_equal(part.answer(asked).vector, opened.answer(asked).vector)
    assert repr(opened.plan) == repr(part.plan)
    assert part.refresh() is False
    add_rows(client, "grows", as_rows(full_wrenches(1, 8), moved(full_wrenches(1, 8))))
    assert part.refresh() is True
    assert part.version > again.version
    assert again.refresh() is True
    again.close()


def test_a_scene_beyond_the_range_is_not_downloaded(client: Client):
    with pytest.raises(ProblemError, match="fx must lie within") as caught:
        client.download("rig", scene=Scene({"rig": {"force": [101, 0, 0], "moment": [0, 0, 0]}}))
    assert caught.value.status == 422
    with pytest.raises(InvalidArgument, match="plan needs a Client or an AsyncClient"):
        Scene(ON_RIG).plan(client.url)
    for wrong in ("rig", {"rig": {}}, [1]):
        with pytest.raises(InvalidArgument, match="must be a Scene, such as"):
            client.download("rig", scene=wrong)
    with pytest.raises(SceneError, match="the scene has no component 'rig'; name one of: plate"):
        client.download("rig", scene=Scene({"plate": PLANAR}))


@pytest.mark.parametrize(
    ("wanted", "told"),
    [
        ({}, "the scene has no component; add"),
        ({"a": 1}, "components.a is .*, but must be a table"),
        ({"a": {**PLANAR, "torque": 1}}, "components.a: torque is not a key"),
        ({"a": {"force": NONE}}, "components.a.moment is missing"),
        ({"a": {**PLANAR, "force": 5}}, "but must have three loads"),
        ({"a": {**PLANAR, "force": [1, 2]}}, "but must have three loads"),
        ({"a": {**PLANAR, "force": ["1", 2, 3]}}, "components.a.force.0"),
        ({"a": {**PLANAR, "force": [[1, [2]], 2, 3]}}, "components.a.force.0"),
        ({"a": {**PLANAR, "force": [True, 2, 3]}}, "components.a.force.0"),
        ({"a": {**PLANAR, "force": [0, float("nan"), 0]}}, "components.a.force.1"),
        ({"a": {**PLANAR, "force": [0, [2, 1], 0]}}, "low end 2 is above the high end 1"),
        ({"a": {**PLANAR, "force": [0, 0, -5]}}, r"force.2 .* write 5, or \[-5, 0\]"),
        ({"a": {**PLANAR, "outputs": []}}, "components.a.outputs"),
        ({"a": {**PLANAR, "outputs": "uz"}}, "components.a.outputs"),
        ({"a": {**PLANAR, "outputs": [["uz"]]}}, "components.a.outputs"),
        ({"a": {**PLANAR, "outputs": 5}}, "components.a.outputs"),
        ({"a": {"loads": {"left": 5}}}, "components.a.loads.left is 5, but must be a table"),
        ({"a": {"loads": {"left": None}}}, "components.a.loads.left is None, but must be a table"),
        ({"a": {**PLANAR, "tolerance": -1}}, "components.a.tolerance"),
        (
            {"a": {**PLANAR, "tolerance": [0, 1e-5]}},
            "^components.a.tolerance: translation must be finite and above 0 m, such as 1e-6, n",
        ),
    ],
)
def test_a_scene_that_cannot_be_is_told_before_anything_is_sent(wanted, told):
    with pytest.raises(SceneError, match=told):
        Scene(wanted)


def test_a_number_is_plus_and_minus_itself():
    scene = Scene({"a": {"force": [5, 0, [-1, 2]], "moment": (0, 0.0, 1)}})
    assert scene.component("a")["force"] == [[-5.0, 5.0], [0.0, 0.0], [-1.0, 2.0]]
    assert scene.wanted("a")["range"]["moment"][2] == [-1.0, 1.0]


def test_the_sample_scenes_are_read():
    folder = Path(__file__).parents[2] / "data" / "scenes"
    scenes = {file.stem: Scene.read(file) for file in folder.glob("*.toml")}
    assert list(scenes["planar"]) == ["plate_thin"]
    assert list(scenes["light_load"]) == ["bar", "plate", "plate_thin"]


@pytest.mark.parametrize("text", ["force = 1\n", "[components\n", "\xff"])
def test_a_file_that_is_no_scene_is_named(tmp_path: Path, text: str):
    file = tmp_path / "scene.toml"
    file.write_bytes(text.encode("latin-1"))
    with pytest.raises(SceneError, match=r"scene\.toml(: | is not valid TOML)"):
        Scene.read(file)


def test_a_mount_on_a_scenes_table_takes_what_is_not_read_as_zero_only_if_told(client):
    table = client.download("rig", scene=Scene(ON_RIG))
    wrench = np.array([20.0, 0.0, -50.0, 0.0, 4.0, 0.0])
    with pytest.raises(DisplacementUnknown, match=r"uy, rx, rz.*scene's outputs.*unmeasured"):
        Mount(table, "rig", np.eye(3), np.zeros(3)).step(wrench)
    mount = Mount(table, "rig", np.eye(3), np.zeros(3), unmeasured="rigid")
    # Its rows are too few for the tolerance: ry may be off by 2.1e-6 rad, 1.7e-6 are covered.
    with pytest.warns(MountWarning, match="ry"):
        mount.step(wrench)
    assert mount.coverage.thin == 1
    read = [0, 2, 4]
    assert np.array_equal(mount.displacement[read], table.answer(wrench).vector[read])
    assert mount.displacement[[0, 2, 4]].all()
    assert not mount.displacement[[1, 3, 5]].any()


# -- several interfaces and a temperature ----------------------------------------------------------


SCENE = {
    "loads": {"left": {"force": [1, [0, 0], [0, 0]], "moment": [[0, 0.5], [0, 0], [0, 0]]}},
    "inputs": {"temperature": [-0.5, 0.5]},
    "outputs": ["left.ux", "left.rz"],
}


@pytest.fixture(scope="module")
def link(tmp_path_factory):
    with TestClient(create_app(Settings(tmp_path_factory.mktemp("two_ends"), solvers=0))) as client:
        add_link(client, has_fea=True)
        add_link(client, 1, "straight", linear=True)
        yield client


def planned(link, wanted, name="two_ends"):
    return link.post("/v1/scenes/plan", json={"components": {name: wanted}})


def test_a_nonlinear_component_is_looked_up_with_the_reason(link):
    plan = planned(link, SCENE).json()["components"]["two_ends"]
    assert plan["decision"] == "table"
    assert "one interface" in plan["reason"]
    assert plan["loads"] == ["left.fx", "left.mx", "temperature"]
    assert plan["outputs"] == ["left.ux", "left.rz"]
    assert plan["solves"] == {"whole": 2 * N + 3, "scene": 9}
    assert plan["axes"] == {}


def test_a_linear_component_has_the_matrix_of_the_loads_that_occur(link):
    plan = planned(link, SCENE, "straight").json()["components"]["straight"]
    matrix = link.app.state.workspace.surrogate("straight").fit.matrix
    assert plan["decision"] == "linear"
    occurring = [0, 3, N - 1]
    result = np.array(plan["compliance"])
    np.testing.assert_array_equal(result[:, occurring], matrix[:, occurring])
    assert not np.delete(result, occurring, axis=1).any()


def test_a_further_input_that_is_left_out_has_its_whole_range(link):
    plan = planned(link, {"loads": {"left": {"force": [1, 1, 1]}}}).json()["components"]["two_ends"]
    assert plan["loads"] == ["left.fx", "left.fy", "left.fz", "temperature"]


def test_a_scene_without_any_load_is_rigid(link):
    add_component(link, "solved", has_fea=True)
    wanted = {"inputs": {"temperature": [0, 0]}}
    plan = planned(link, wanted, "solved").json()["components"]["solved"]
    assert plan["decision"] == "rigid"


def test_a_component_without_rows_is_planned(link):
    add_component(link, "bare")
    assert link.app.state.workspace.tables.catch_up("bare", 600)
    plan = planned(link, SCENE, "bare").json()["components"]["bare"]
    assert plan["decision"] == "table"


def test_a_scenes_file_has_the_same_bytes_under_the_same_entity_tag(link):
    call, wanted = "/v1/components/straight/scene", {"wanted": json.dumps(SCENE)}
    first, second = (link.get(call, params=wanted) for _ in range(2))
    assert first.status_code == 200
    assert first.headers["ETag"] == second.headers["ETag"]
    assert first.content == second.content


def test_unknown_further_inputs_are_listed_in_the_order_of_the_request(link):
    names = ["speed", "age", "humidity", "wear", "current"]
    reply = planned(link, {**SCENE, "inputs": {key: [0, 1] for key in names}})
    places = [mistake["loc"].rpartition(".")[2] for mistake in reply.json()["errors"]]
    assert (reply.status_code, places) == (422, names)


def filled(link, **more):
    return link.post("/v1/components/two_ends/fill", json={"budget": 3, **more})


def test_solves_of_a_fill_lie_within_the_loads_of_its_interface(link):
    wanted = {"loads": {"left": {"force": [0.5, 0.5, 0.5]}}, "inputs": {"temperature": [0, 0.5]}}
    limit = {"translation": 1e-5, "rotation": 1e-5}
    reply = filled(link, range=wanted, outputs=["left.ux"], tolerance=limit)
    assert reply.status_code == 202, reply.text
    wrenches = link.app.state.workspace.submission.pending_wrenches("two_ends")
    assert len(wrenches) == 3
    assert (np.abs(wrenches[:, :3]) <= 0.5).all()
    assert not wrenches[:, 3 : N - 1].any()
    assert (wrenches[:, N - 1] >= 0).all()


def test_a_fill_that_cannot_reach_the_tolerance_says_the_solves_it_would_take(link):
    reason = filled(link, tolerance={"translation": 1e-4, "rotation": 1e-4}).json()["reason"]
    assert "further solves, an estimate by the rate so far" in reason


def test_compliance_coverage_and_envelope_have_the_names_of_the_space(link):
    reply = link.get("/v1/components/two_ends/compliance").json()
    assert reply["columns"][N - 1] == "temperature [degC]"
    heads = [column.header for column in render.compliance_tables(reply)[0].columns]
    assert (heads[1], heads[-1]) == ("left.fx", "temperature")
    assert link.get("/v1/components/two_ends/coverage").status_code == 200
    link.post("/v1/components/two_ends/envelope", json={"wrenches": [[0.1] * N]})
    result = link.get("/v1/components/two_ends/envelope").json()
    assert result["inputs"][-1] == "temperature"
    assert len(result["inputs"]) == len(result["min"]) == N
    assert len(result["outputs"]) == len(result["displacement_bound"])


def test_the_demand_map_of_many_inputs_outlasts_a_restart(tmp_path):
    span = LoadRange(-np.ones(N), np.ones(N), SPACE)
    ledger = Ledger(tmp_path / "ledger.sqlite")
    counts = DemandMaps(ledger)
    counts.note("two_ends", span, tuple([0.4] * N), "thin")
    counts.save()
    ledger.close()
    ledger = Ledger(tmp_path / "ledger.sqlite")
    result = DemandMaps(ledger).map_of("two_ends", span)
    ledger.close()
    assert result.asked == 1
    assert len(result.cells[0].wrench) == N


def test_a_method_of_axes_is_422_for_several_interfaces(link):
    for call, body in (
        ("displacement", {"loads": {"left": {"force": [0.2, 0, 0]}}, "inputs": {"temperature": 0}}),
        ("displacements", {"wrenches": [[0.0] * N]}),
    ):
        body = {**body, "method": "griddata", "on_thin": "estimate"}
        reply = link.post(f"/v1/components/two_ends/{call}", json=body)
        assert reply.status_code == 422, reply.text
        assert "one wrench at one interface" in reply.json()["detail"]
    packed = link.app.state.workspace.surrogate("two_ends").packed
    with pytest.raises(UnknownMethodError, match="one wrench at one interface"):
        make_fmu("two_ends", packed, "griddata")
    assert ServedTable(packed, method="griddata").default == "kriging"


def test_a_scene_takes_loads_by_interface_and_further_inputs(link):
    span = {"force": [[0, 0], [0, 0], [-1, 0]], "moment": [0, 0, 0]}
    need = {
        "loads": {"right": span},
        "inputs": {"temperature": [0, 1]},
        "outputs": ["right.uz", "right.rx"],
    }
    scene = Scene({"two_ends": need})
    assert planned(link, scene.components["two_ends"]).status_code == 200
    wanted = scene.wanted("two_ends")
    assert wanted["range"]["loads"]["right"]["force"][2] == [-1.0, 0.0]
    assert wanted["range"]["inputs"] == {"temperature": [0.0, 1.0]}
    assert wanted["outputs"] == ["right.uz", "right.rx"]
    with pytest.raises(SceneError, match=r"components.link.loads.right: torque is not a key"):
        Scene({"link": {"loads": {"right": {"torque": [0, 0, 0]}}}})
    with pytest.raises(SceneError, match=r"components.link.inputs.temperature must be"):
        Scene({"link": {"loads": {}, "inputs": {"temperature": "warm"}}})


@pytest.mark.parametrize(
    ("option", "load", "further"),
    [("--load right", ["right=1,0,0", "right=2,0,0"], None), ("--input t", None, ["t=1", "t=2"])],
)
def test_an_option_that_is_given_twice_for_one_name_is_refused(option, load, further):
    with pytest.raises(InvalidArgument, match=f"{option} is given twice"):
        _loads(None, None, load, further)


def test_the_list_of_components_has_the_forces_by_interface():
    loads = {"force": [[-1, 1]] * 3, "moment": [[-2, 2]] * 3}
    named = {"name": "arm", "title": "An arm", "rows": 3, "has_fea": True, "linear": False}
    named |= {"another_setup": {"rows": 0}, "pending_rows": 0}
    named["range"] = {"loads": {"left": loads, "right": loads}}
    assert list(render.component_table([named]).columns[4].cells) == ["left 1 1 1; right 1 1 1"]
