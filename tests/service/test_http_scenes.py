"""POST /v1/scenes/plan, and filling and downloading as it says."""

from __future__ import annotations

import pickle
from collections.abc import Iterator
from itertools import product
from pathlib import Path

import numpy as np
import pytest

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
from wrenchbook.service.client import (
    Client,
    InvalidArgument,
    ProblemError,
    Scene,
    SceneError,
    Table,
)
from wrenchbook.service.client.mount import DisplacementUnknown, Mount, MountWarning

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
    with served(tmp_path_factory.mktemp("scenes") / "workspace") as made:
        # The corners of the scene too: a bound takes answers whose errors are known there.
        wrenches = np.concatenate((full_wrenches(40), CORNERS))
        add_table(made, "rig", as_rows(wrenches, moved(wrenches), tangents(wrenches)))
        yield made


def body(**more: object) -> dict:
    return {"components": {"plate_thin": {**PLANAR, **more}}}


def test_a_plan_tells_what_is_needed_and_what_is_left_out(http):
    reply = http.post(CALL, json=body(outputs=["uz", "rx"]))
    assert reply.status_code == 200
    told = reply.json()["components"]["plate_thin"]
    assert told.keys() >= KEYS
    assert told["loads"] == ["fx", "fz", "my"]
    assert told["outputs"] == ["uz", "rx"]
    assert told["axes"]["z"] == {"inputs": ["fz", "my"], "dimensions": 2}
    assert told["solves"] == {"whole": 9, "scene": 6}
    assert told["displacement_bound"] == [None] * 6
    assert told["saves"] == {"build_s": None, "memory_bytes": None, "us_per_answer": None}
    assert "no rows yet" in told["saves_from"]["build_s"]


def test_a_scene_narrower_than_wrenches_are_told_apart_is_planned_too(http):
    speck = {"force": [[-1e-308, 1e-308], [0, 0], [0, 0]], "moment": NONE}
    reply = http.post(CALL, json={"components": {"plate_thin": speck}})
    assert reply.status_code == 200
    told = reply.json()["components"]["plate_thin"]
    assert told["solves"] == {"whole": 9, "scene": 1}


def test_a_fill_of_the_scene_queues_the_solves_of_its_plan_and_no_others(http, stand_in):
    stand_in("endless")
    planned = http.post(CALL, json=body()).json()["components"]["plate_thin"]["solves"]["scene"]
    wanted = {"range": PLANAR, "budget": 100}
    reply = http.post("/v1/components/plate_thin/fill", json=wanted)
    assert reply.status_code == 202
    jobs = [http.get(one["url"]).json() for one in reply.json()["jobs"]]
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


def test_a_load_on_a_locked_freedom_is_no_load_of_the_scene(http):
    spans = {"force": [[-1, 1]] * 3, "moment": [[-0.01, 0.01]] * 3}
    reply = http.post(CALL, json={"components": {"spring": spans}})
    assert reply.json()["components"]["spring"]["loads"] == ["fz", "mz"]


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


def asked_on_rig() -> np.ndarray:
    """Wrenches of the scene on the rig, (50, 6), N and N m."""
    asked = full_wrenches(50, 3) * np.isin(np.arange(6), READ)
    asked[:, 2] = -np.abs(asked[:, 2])
    return asked


def test_a_downloaded_scene_answers_as_the_whole_table_and_as_the_server(client: Client):
    part, whole = client.download("rig", scene=Scene(ON_RIG)), client.download("rig")
    asked = asked_on_rig()
    found, full = part.batch(asked), whole.batch(asked)
    far = client.displacements("rig", asked, on_thin="estimate")
    for other in (full, far):
        np.testing.assert_array_equal(found.displacements[:, READ], other.displacements[:, READ])
        np.testing.assert_array_equal(found.errors[:, READ], other.errors[:, READ])


def test_outputs_that_a_scene_leaves_out_are_unknown(client: Client):
    part, asked = client.download("rig", scene=Scene(ON_RIG)), asked_on_rig()
    assert np.isnan(part.batch(asked).displacements[:, [1, 3, 5]]).all()
    one = part.answer(asked[0, :3], asked[0, 3:], derivatives=True)
    assert one.derivative is not None
    np.testing.assert_array_equal(np.isnan(one.derivative).all(axis=1), [0, 1, 0, 1, 0, 1])


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
    with pytest.raises(InvalidArgument, match="plan takes a Client or an AsyncClient"):
        Scene(ON_RIG).plan(client.url)
    for wrong in ("rig", {"rig": {}}, [1]):
        with pytest.raises(InvalidArgument, match="takes a Scene, such as"):
            client.download("rig", scene=wrong)
    with pytest.raises(SceneError, match="the scene has no component 'rig'; it has plate"):
        client.download("rig", scene=Scene({"plate": PLANAR}))


@pytest.mark.parametrize(
    ("wanted", "told"),
    [
        ({}, "at least one component"),
        ({"a": 1}, "components.a: a table of force"),
        ({"a": {**PLANAR, "torque": 1}}, "components.a: unknown torque"),
        ({"a": {"force": NONE}}, "components.a.moment is missing"),
        ({"a": {**PLANAR, "force": 5}}, "components.a.force: three loads"),
        ({"a": {**PLANAR, "force": [1, 2]}}, "components.a.force: three loads"),
        ({"a": {**PLANAR, "force": ["1", 2, 3]}}, "components.a.force.0"),
        ({"a": {**PLANAR, "force": [[1, [2]], 2, 3]}}, "components.a.force.0"),
        ({"a": {**PLANAR, "force": [True, 2, 3]}}, "components.a.force.0"),
        ({"a": {**PLANAR, "force": [0, float("nan"), 0]}}, "components.a.force.1"),
        ({"a": {**PLANAR, "force": [0, [2, 1], 0]}}, "low end, 2, is above the high end, 1"),
        ({"a": {**PLANAR, "outputs": []}}, "components.a.outputs"),
        ({"a": {**PLANAR, "outputs": "uz"}}, "components.a.outputs"),
        ({"a": {**PLANAR, "outputs": [["uz"]]}}, "components.a.outputs"),
        ({"a": {**PLANAR, "outputs": 5}}, "components.a.outputs"),
        ({"a": {**PLANAR, "tolerance": -1}}, "components.a.tolerance"),
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
    with pytest.raises(SceneError, match=r"scene\.toml: "):
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
