"""Joints in loops that are not their own: mj_step1 and mj_step2, mj_step, and the docs' recipes."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from mujoco import rollout

import wrenchbook
from tests.service.client.joint_scenes import linear_table, mujoco, scene, sphere
from tests.service.client.test_joint import FOOT
from tests.service.client.test_joint_tables import two_joints
from wrenchbook.service.client.joint import JointError, JointRangeError
from wrenchbook.service.client.joint.mujoco_joint import (
    MujocoJoint,
    joints_in_mj_step,
    pull_joints,
    step_joints,
)

TABLE = linear_table()
DOCS = Path(__file__).parents[3] / "data/docs/how-to/joint.md"
FULL = mujoco.mjtState.mjSTATE_FULLPHYSICS
CONTACT = 'solref="0.004 1"'
SCENES = {  # a stiff part at 1 ms, a foot on stiff contacts, a mass matrix that is diagonal
    "bar": (sphere(5, "0.02 0 0.03"), {}),
    "contact": (sphere(3, geom=CONTACT) + "<body/>", FOOT),
    "diagonal": (sphere(5), {}),
    "no control": (sphere(5), {"option": "><flag actuation='disable'/></option><option"}),
    "pgs": (sphere(3, geom=CONTACT) + "<body/>", {**FOOT, "option": 'solver="PGS"'}),
}


def made(name: str):
    tip, options = SCENES[name]
    model, data = scene(tip, **options)
    if model.nv > 6:  # the foot presses on the ground by 150 N
        data.qfrc_applied[0] = 50 * 9.81 - 120
    data.qvel[-6:-3] = [0.01, 0.02, -0.03]
    return model, data, MujocoJoint(model, data, TABLE, damping=0.05)


def by_halves(model, data, joint, count):
    for _ in range(count):
        mujoco.mj_step1(model, data)
        pull_joints(joint)
        mujoco.mj_step2(model, data)


def twice_between(model, data, joint, count):
    for _ in range(count):
        mujoco.mj_step1(model, data)
        pull_joints(joint)
        pull_joints(joint)
        mujoco.mj_step2(model, data)


def in_mj_step(model, data, joint, count):
    with joints_in_mj_step():
        mujoco.mj_step(model, data, count)


def step_in_it(model, data, joint, count):
    with joints_in_mj_step():
        for _ in range(count):
            joint.step()


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize(
    ("loop", "off"), [(by_halves, 0), (in_mj_step, 0), (step_in_it, 0), (twice_between, 1e-9)]
)
def test_each_loop_has_the_bits_of_step(loop, off: float, name: str):
    _, data, joint = made(name)
    for _ in range(300):
        joint.step()
    other = made(name)
    loop(*other, 300)
    np.testing.assert_allclose(other[1].qpos, data.qpos, rtol=0, atol=off)
    np.testing.assert_allclose(other[1].qvel, data.qvel, rtol=0, atol=off)
    np.testing.assert_allclose(other[2].wrench, joint.wrench, rtol=0, atol=1e3 * off)


def test_mj_step_has_all_joints_of_a_scene():
    data, joints = two_joints()
    other, others = two_joints()
    for _ in range(100):
        step_joints(*joints)
    with joints_in_mj_step():
        mujoco.mj_step(others[0]._model, other, 100)
    np.testing.assert_array_equal(other.qpos, data.qpos)


def test_a_callback_in_use_is_refused_and_none_remains():
    mujoco.set_mjcb_control(lambda model, data: None)
    try:
        with pytest.raises(JointError, match="another callback"), joints_in_mj_step():
            pass
    finally:
        mujoco.set_mjcb_control(None)
    with pytest.raises(JointError, match="no joint pulled"), joints_in_mj_step():
        mujoco.set_mjcb_control(lambda model, data: None)
    assert mujoco.get_mjcb_control() is mujoco.get_mjcb_passive() is None


def test_after_a_step_the_mass_matrix_is_that_of_the_scene():
    model, data, joint = made("bar")
    joint.step()
    fresh = mujoco.MjData(model)
    mujoco.mj_fwdPosition(model, fresh)
    np.testing.assert_array_equal(data.M, fresh.M)


def states_of(model, count: int) -> np.ndarray:
    """Initial states: swings of growing speed."""
    data, states = mujoco.MjData(model), np.empty((count, mujoco.mj_stateSize(model, FULL)))
    for k in range(count):
        data.qvel[:3] = 0.01 * k
        mujoco.mj_getState(model, data, states[k], FULL)
    return states


def test_a_rollout_in_threads_has_the_bits_of_loops():
    model, _, _ = made("bar")
    starts, reached = states_of(model, 9), []
    scenes = [mujoco.MjData(model) for _ in range(3)]
    joints = [MujocoJoint(model, data, TABLE) for data in scenes]
    with joints_in_mj_step():
        states, _ = rollout.rollout([model] * 9, scenes, starts, nstep=50)
    for start in starts:
        data, now = mujoco.MjData(model), np.empty(starts.shape[1])
        joint = MujocoJoint(model, data, TABLE)
        mujoco.mj_setState(model, data, start, FULL)
        for _ in range(50):
            joint.step()
        mujoco.mj_getState(model, data, now, FULL)
        reached.append(now)
    np.testing.assert_array_equal(states[:, -1], reached)
    assert all(joint.report().steps for joint in joints)


def test_an_error_in_a_rollouts_thread_is_raised_at_the_end(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # MuJoCo writes a log
    model, _, _ = made("bar")
    scenes, starts = [mujoco.MjData(model) for _ in range(2)], states_of(model, 4)
    joints = [MujocoJoint(model, data, TABLE) for data in scenes]
    starts[2, 1] = 5.0  # m along the bar
    with pytest.raises(JointRangeError, match="times the load range"), joints_in_mj_step():
        states, _ = rollout.rollout([model] * 4, scenes, starts, nstep=5)
    assert len(joints) == 2
    np.testing.assert_allclose(states[[0, 1, 3], -1, 0], 5e-3)  # the others have run
    assert (states[2] == states[2, 0]).all()


# -- recipes of the docs ---------------------------------------------------------------------------

MOTOR = '<actuator><motor site="hand" gear="0 0 1 0 0 0"/></actuator>'
HAND = sphere(5, "0.02 0 0.03") + '<site name="hand"/>'


def recipe(marker: str, **names):
    """The names that the Python block with a marker defines, run as it stands."""
    found = re.findall(r"^```python\n(.*?)^```", DOCS.read_text("utf-8"), re.M | re.S)
    (block,) = [text for text in found if marker in text]
    space = {"wrenchbook": wrenchbook, "mujoco": mujoco, "table": TABLE, **names}
    exec(block, space)
    return space


def swung(loop) -> tuple[float, float]:
    """Height and force after 40 steps of a motor of 30 N, by a loop (model, data, joint)."""
    model, data = scene(HAND, extra=MOTOR)
    joint = MujocoJoint(model, data, TABLE)
    data.ctrl[:] = 30.0
    loop(model, data, joint)
    return float(data.qpos[2]), float(joint.wrench[2])


def steps(model, data, joint):
    for _ in range(40):
        joint.step()


class Viewer:
    """A passive viewer without a window: open for 40 syncs."""

    def __init__(self, *scene):
        self.left = 40

    def __enter__(self):
        return self

    def __exit__(self, *error):
        pass

    def is_running(self):
        return self.left > 0

    def sync(self):
        self.left -= 1


def test_the_recipe_of_the_passive_viewer_steps_the_joint():
    class Stand:
        viewer = type("module", (), {"launch_passive": Viewer})

    def loop(model, data, joint):
        recipe("launch_passive", mujoco=Stand, model=model, data=data, joint=joint)

    assert swung(loop) == swung(steps)


def saved(tmp_path) -> str:
    model, _ = scene(HAND, extra=MOTOR)
    mujoco.mj_saveLastXML(str(tmp_path / "arm-joint.xml"), model)
    return str(tmp_path / "arm-joint.xml")


def test_the_recipe_of_gymnasium_steps_the_joint(tmp_path):
    reason = "pip install 'gymnasium[mujoco]'"
    spaces = pytest.importorskip("gymnasium.spaces", reason=reason)
    pytest.importorskip("gymnasium.envs.mujoco", reason=reason)
    env = recipe("class Env")["Env"](saved(tmp_path), 20, spaces.Box(-1.0, 1.0, (13,)))
    for _ in range(2):
        env.do_simulation([30.0], env.frame_skip)
    assert (float(env.data.qpos[2]), float(env.joint.wrench[2])) == pytest.approx(swung(steps))


def test_the_recipe_of_dm_control_steps_the_joint(tmp_path, monkeypatch):
    pytest.importorskip("dm_control.mujoco", reason="pip install dm_control")
    sizes = pytest.importorskip("dm_control.mujoco.wrapper.mjbindings.sizes").array_sizes
    model, data = scene(HAND)
    for kind, struct in (("mjmodel", model), ("mjdata", data)):  # 1.0.50 names fields of MuJoCo 3
        known = {name: of for name, of in sizes[kind].items() if hasattr(struct, name)}
        monkeypatch.setitem(sizes, kind, known)
    path = saved(tmp_path)
    monkeypatch.chdir(tmp_path)
    physics = recipe("class Physics")["physics"]
    assert Path(path).exists()
    for _ in range(2):
        physics.reset()
        physics.joint.restart()
        physics.set_control([30.0])
        physics.step(30)
        physics.step(10)
    found = float(physics.data.qpos[2]), float(physics.joint.displacement[2])
    assert found[0] == pytest.approx(swung(steps)[0], abs=1e-9)
