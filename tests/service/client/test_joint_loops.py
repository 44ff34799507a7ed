"""Joints in loops that are not their own: mj_step1 and mj_step2, mj_step, and the docs' recipes."""

from __future__ import annotations

import re
from contextlib import nullcontext
from pathlib import Path
from unittest.mock import MagicMock

import numpy as np
import pytest
from mujoco import rollout

import wrenchbook
from tests.service.client.joint_scenes import known_table, linear_table, mujoco, scene, sphere
from tests.service.client.test_joint import FOOT
from tests.service.client.test_joint_tables import two_joints
from wrenchbook.service.client.joint import JointError, JointRangeError, JointWarning
from wrenchbook.service.client.joint.mujoco_callback import joints_in_mj_step
from wrenchbook.service.client.joint.mujoco_joint import MujocoJoint, pull_joints, step_joints

TABLE, FULL = linear_table(), mujoco.mjtState.mjSTATE_FULLPHYSICS
DOCS = Path(__file__).parents[3] / "data/docs/how-to/joint-loops.md"
FOOT_TIP = sphere(3, geom='solref="0.004 1"') + "<body/>"
SCENES = {  # a stiff part at 1 ms, a foot on stiff contacts, a mass matrix that is diagonal
    "bar": (sphere(5, "0.02 0 0.03"), {}),
    "contact": (FOOT_TIP, FOOT),
    "pgs": (FOOT_TIP, {**FOOT, "option": 'solver="PGS"'}),
    "diagonal": (sphere(5), {}),
    "no control": (sphere(5), {"option": "><flag actuation='disable'/></option><option"}),
}


def made(name: str):
    model, data = scene(SCENES[name][0], **SCENES[name][1])
    data.qfrc_applied[0] = 50 * 9.81 - 120 if model.nv > 6 else 0.0  # the foot presses
    data.qvel[-6:-3] = [0.01, 0.02, -0.03]
    return model, data, MujocoJoint(model, data, TABLE, damping=0.05)


def by_halves(model, data, joint, count, pulls=1):
    for _ in range(count):
        mujoco.mj_step1(model, data)
        for _ in range(pulls):
            pull_joints(joint)
        mujoco.mj_step2(model, data)


def twice_between(model, data, joint, count):
    by_halves(model, data, joint, count, pulls=2)


def in_mj_step(model, data, joint, count):
    with joints_in_mj_step():
        mujoco.mj_step(model, data, count - 10)
        for _ in range(10):
            joint.step()


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize(("loop", "off"), [(by_halves, 0), (in_mj_step, 0), (twice_between, 1e-9)])
def test_each_loop_has_the_bits_of_step(loop, off: float, name: str):
    (_, data, joint), other = made(name), made(name)
    for _ in range(300):
        joint.step()
    loop(*other, 300)
    np.testing.assert_allclose(other[1].qpos, data.qpos, rtol=0, atol=off)
    np.testing.assert_allclose(other[1].qvel, data.qvel, rtol=0, atol=off)
    np.testing.assert_allclose(other[2].wrench, joint.wrench, rtol=0, atol=1e3 * off)


def test_mj_step_has_all_joints_of_a_scene():
    (data, joints), (other, others) = two_joints(), two_joints()
    for _ in range(100):
        step_joints(*joints)
    with joints_in_mj_step():
        mujoco.mj_step(others[0]._model, other, 100)
    np.testing.assert_array_equal(other.qpos, data.qpos)


def test_a_second_callback_is_refused():
    refused = pytest.raises(JointError, match="already has a control callback")
    with joints_in_mj_step(), refused, joints_in_mj_step():
        pass
    assert mujoco.get_mjcb_control() is mujoco.get_mjcb_passive() is None


def test_a_callback_that_takes_the_place_of_the_joints_is_an_error():
    with pytest.raises(JointError, match="stops the joints"), joints_in_mj_step():
        mujoco.set_mjcb_control(lambda model, data: None)


def test_after_a_step_the_mass_matrix_is_that_of_the_scene():
    model, data, joint = made("bar")
    joint.step()
    fresh = mujoco.MjData(model)
    mujoco.mj_fwdPosition(model, fresh)
    np.testing.assert_array_equal(data.M, fresh.M)


def test_a_scene_without_a_joint_in_mj_step_is_warned_of():
    model, data, joint = made("bar")
    with joints_in_mj_step(), pytest.warns(JointWarning, match="nothing holds its tip"):
        mujoco.mj_step(model, mujoco.MjData(model))
    assert joint._data is data


def test_a_joint_pulls_in_mj_step_again_once_another_of_its_tip_is_gone():
    model, data, joint = made("bar")
    MujocoJoint(model, data, TABLE)
    with joints_in_mj_step():
        mujoco.mj_step(model, data, 10)
    assert joint.report().steps == 10


def test_a_scene_put_elsewhere_has_the_bits_of_a_new_joint():
    table, ends = known_table(40), []
    for before in (0, 20):
        model, data, _ = made("bar")
        joint = MujocoJoint(model, data, table)
        for _ in range(before):
            joint.step()
        mujoco.mj_resetData(model, data)
        data.time, data.qvel[2] = 1.0, -0.03
        for _ in range(20):
            joint.step()
        ends.append(data.qpos.copy())
    np.testing.assert_array_equal(*ends)


def rolled(pose: float):
    """Four rollouts of 5 steps in two threads, and their starts; the third is from a pose, m."""
    model, data, _ = made("bar")
    starts = np.empty((4, mujoco.mj_stateSize(model, FULL)))
    for k, start in enumerate(starts):
        data.qvel[:3], data.qpos[0] = 0.01 * k, pose * (k == 2)
        mujoco.mj_getState(model, data, start, FULL)
    joints = [MujocoJoint(model, mujoco.MjData(model), TABLE) for _ in range(2)]
    scenes = [joint._data for joint in joints]
    with pytest.raises(JointRangeError) if pose else nullcontext(), joints_in_mj_step():
        states, _ = rollout.rollout([model] * 4, scenes, starts, nstep=5)
    return model, starts, states[:, -1]


def test_a_rollout_in_threads_has_the_bits_of_loops():
    model, starts, ends = rolled(0.0)
    for start, end in zip(starts, ends, strict=True):
        data, now = mujoco.MjData(model), np.empty_like(start)
        joint = MujocoJoint(model, data, TABLE)
        mujoco.mj_setState(model, data, start, FULL)
        for _ in range(5):
            joint.step()
        mujoco.mj_getState(model, data, now, FULL)
        np.testing.assert_array_equal(end, now)


def test_an_error_in_a_rollouts_thread_is_raised_at_the_end_and_others_run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # MuJoCo writes a log
    times = rolled(5.0)[2][:, 0]
    np.testing.assert_allclose(times[[0, 1, 3]], 5e-3)


# -- recipes of the docs: a hand on the bar, pushed by a motor of 30 N for 40 steps ----------------


@pytest.fixture
def hand(tmp_path, monkeypatch):
    """The scene, its joint and its place after the steps; the scene's file is beside the test."""
    monkeypatch.chdir(tmp_path)
    motor = '<actuator><motor site="hand" gear="0 0 1 0 0 0"/></actuator>'
    model, data = scene(SCENES["bar"][0] + '<site name="hand"/>', extra=motor)
    mujoco.mj_saveLastXML("arm-joint.xml", model)
    joint = MujocoJoint(model, data, TABLE, damping=0.02)
    data.ctrl[0] = 30.0
    for _ in range(40):
        joint.step()
    reached = data.qpos.copy()
    mujoco.mj_resetData(model, data)
    data.ctrl[0] = 30.0
    return model, data, joint, pytest.approx(reached, abs=1e-12)


def recipe(marker: str, **names):
    """The names that the Python block with a marker defines, run as it stands."""
    blocks = re.findall(r"^```python\n(.*?)^```", DOCS.read_text("utf-8"), re.M | re.S)
    (block,) = [text for text in blocks if marker in text]
    space = {"wrenchbook": wrenchbook, "mujoco": mujoco, "table": TABLE, **names}
    exec(block, space)
    return space


def test_the_recipe_of_the_passive_viewer_steps_the_joint(hand):
    model, data, joint, reached = hand
    stand_in = MagicMock()
    opened = stand_in.viewer.launch_passive.return_value.__enter__.return_value
    opened.is_running.side_effect = [True] * 40 + [False]
    recipe("launch_passive", mujoco=stand_in, model=model, data=data, joint=joint)
    assert data.qpos == reached


def test_the_recipe_of_gymnasium_steps_the_joint(hand, tmp_path):
    reason = "pip install 'gymnasium[mujoco]'"
    spaces = pytest.importorskip("gymnasium.spaces", reason=reason)
    pytest.importorskip("gymnasium.envs.mujoco", reason=reason)
    space = spaces.Box(-1.0, 1.0, (13,))
    env = recipe("class Env")["Env"](str(tmp_path / "arm-joint.xml"), 20, space)
    for _ in range(2):
        env.do_simulation([30.0], env.frame_skip)
    assert env.data.qpos == hand[3]


def test_the_recipe_of_dm_control_steps_the_joint(hand, monkeypatch):
    bindings = "dm_control.mujoco.wrapper.mjbindings.sizes"
    sizes = pytest.importorskip(bindings, reason="pip install dm_control").array_sizes
    for kind, struct in zip(("mjmodel", "mjdata"), hand, strict=False):
        # dm_control 1.0.50 names fields that MuJoCo 4 does not have.
        known = {name: of for name, of in sizes[kind].items() if hasattr(struct, name)}
        monkeypatch.setitem(sizes, kind, known)
    physics = recipe("class Physics")["physics"]
    for _ in range(2):
        physics.reset()
        physics.joint.restart()
        physics.set_control([30.0])
        physics.step(30)
        physics.step(10)
    assert physics.data.qpos == hand[3]


@pytest.mark.parametrize("step", [by_halves, in_mj_step])
def test_a_scene_that_mujoco_has_reset_since_it_was_unstable_is_named_once(
    capfd, tmp_path, monkeypatch, step
):
    monkeypatch.chdir(tmp_path)  # MuJoCo writes a log where it runs
    model, data, joint = made("bar")
    step(model, data, joint, 20)
    data.qvel[0] = np.nan
    with pytest.warns(JointWarning, match="MuJoCo has reset the unstable scene") as caught:
        step(model, data, joint, 20)
    assert len(caught) == 1
    data.qvel[0] = np.nan
    step(model, data, joint, 20)
    assert np.isfinite(data.qpos).all()


def test_a_scene_that_the_user_resets_is_not_taken_for_an_unstable_one():
    model, data, joint = made("bar")
    by_halves(model, data, joint, 20)
    mujoco.mj_resetData(model, data)
    by_halves(model, data, joint, 20)
