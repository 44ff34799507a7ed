"""Many joints in one call: each has the numbers of one, and none stops the others."""

from __future__ import annotations

import copy
import pickle
import warnings
from functools import cache
from typing import Any

import numpy as np
import pytest

from tests.service.client.joint_scenes import FREEDOMS, linear_table, mujoco, scene, sphere
from tests.service.client.test_joint_scenes import turning_table
from tests.service.client.test_joint_tables import WARM
from wrenchbook.service.client import arrays
from wrenchbook.service.client.errors import InvalidArgument
from wrenchbook.service.client.joint import Joint, JointError, Joints, JointWarning
from wrenchbook.service.client.joint.joint import quaternion, rotation_vector
from wrenchbook.service.client.joint.mujoco_joint import MujocoJoint, step_joints
from wrenchbook.service.client.joint.mujoco_joints import MujocoJoints
from wrenchbook.service.client.rotation import rotation_matrix
from wrenchbook.surrogate.kernel.joint import JointSteps

MASSES = np.diag([1.0, 1, 1, 9, 9, 9])
table = cache(turning_table)


def states(count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Poses (n, 7), velocities (n, 6) and the rotations (n, 3, 3), within the part's range."""
    rng = np.random.default_rng(5)
    moved = rng.uniform(-0.8, 0.8, (count, 6)) * [0.02, 0.02, 0.02, 0.2, 0.2, 0.2]
    turned = np.array([rotation_matrix(vector) for vector in moved[:, 3:]])
    poses = np.hstack([moved[:, :3], [quaternion(rotation_vector(R)) for R in turned]])
    return poses, rng.normal(size=(count, 6)), turned


def test_joints_have_the_wrenches_displacements_and_errors_of_each_joint():
    poses, velocities, turned = states(9)
    joints = Joints(table(), 9, damping=0.05)
    result = joints.step(poses, velocities, MASSES, 1e-3, threads=2)
    for k in range(9):
        one = Joint(table(), damping=0.05)
        expected = one.step(turned[k], poses[k, :3], velocities[k], MASSES, 1e-3)
        np.testing.assert_array_equal(result[k], expected)
        np.testing.assert_array_equal(joints.displacements[k], one.displacement)
        assert joints.coverage[k] == one.coverage
    assert (joints.status == "ok").all()
    assert all((error > 0).any() for error in joints.errors)


def test_errors_are_unknown_before_a_step_and_after_a_restart():
    poses, velocities, _ = states(2)
    joints = Joints(table(), 2)
    assert np.isnan(joints.errors).all()
    joints.step(poses, velocities, MASSES, 1e-3)
    joints.restart([1])
    assert np.isnan(joints.errors[1]).all(axis=1).tolist() == [False, True]


COPIES = [copy.copy, copy.deepcopy, lambda joint: pickle.loads(pickle.dumps(joint))]


@pytest.mark.parametrize("copied", COPIES, ids=["copy", "deepcopy", "pickle"])
def test_a_copy_of_a_joint_goes_on_by_itself(copied):
    poses, velocities, turned = states(2)
    joint = Joint(table())
    joint.step(turned[0], poses[0, :3], velocities[0], MASSES, 1e-3)
    before, other = joint.wrench, copied(joint)
    result = other.step(turned[1], poses[1, :3], velocities[1], MASSES, 1e-3)
    np.testing.assert_array_equal(joint.wrench, before)
    np.testing.assert_array_equal(
        joint.step(turned[1], poses[1, :3], velocities[1], MASSES, 1e-3), result
    )
    assert joint.report() == other.report()


@pytest.mark.parametrize("copied", COPIES[1:], ids=["deepcopy", "pickle"])
def test_a_copy_of_a_mujoco_joint_has_a_scene_of_its_own(copied):
    joint = MujocoJoint(*scene(sphere(3, "0.02 0 0.03")), linear_table())
    joint.step()
    other = copied(joint)
    for _ in range(20):
        joint.step()
        other.step()
    np.testing.assert_array_equal(other._data.qpos, joint._data.qpos)
    assert other._data is not joint._data


def test_a_state_of_a_joint_is_that_of_its_pose_and_leaves_the_last_step():
    """In turned axes of the slides, and of each environment."""
    axes = "".join(f'<joint type="slide" axis="{axis}"/>' for axis in ("0 1 0", "0 0 1", "1 0 0"))
    model, _ = scene(sphere(3, "0.02 0 0.03"), joints=axes + '<joint type="ball"/>')
    joints = MujocoJoints(model, [mujoco.MjData(model) for _ in range(2)], linear_table())
    joints.step()
    pose = [1e-6, 2e-4, -3e-4], [1e-3, -2e-3, 3e-3]
    expected = Joint(linear_table()).state(*pose)
    for joint in joints.joints:
        before = joint.wrench, joint.displacement, joint.error
        np.testing.assert_allclose(joint.state(*pose)[0], expected[0], rtol=1e-9, atol=1e-9)
        np.testing.assert_array_equal((joint.wrench, joint.displacement, joint.error), before)


def test_a_joint_without_a_wrench_is_named_and_does_not_stop_the_others():
    poses, velocities, _ = states(6)
    masses = np.tile(MASSES, (6, 1, 1))
    alone = Joints(table(), 6).step(poses, velocities, masses, 1e-3)
    poses[1, 0], poses[2, :3], masses[4, 0, 0] = np.nan, 0.2, -1.0
    joints = Joints(table(), 6)
    with pytest.warns(JointWarning) as reported:
        result = joints.step(poses, velocities, masses, 1e-3)
    failed = {1: "not finite", 2: "beyond twice the range", 4: "no inverse mass"}
    assert {k: str(joints.status[k]) for k in np.flatnonzero(joints.failed)} == failed
    assert np.isnan(result[[1, 2, 4]]).all()
    np.testing.assert_array_equal(result[[0, 3, 5]], alone[[0, 3, 5]])
    assert "3 of 6 joints have no wrench in this step, NaN: 1 not finite" in str(
        reported[0].message
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        joints.step(poses, velocities, masses, 1e-3)  # appears once
        poses[1, 0] = 0.0
        joints.restart(joints.failed)
        assert not np.isnan(joints.step(poses, velocities, masses, 1e-3)[1]).any()


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"poses": np.zeros((3, 6))}, r"of 3 joints must have shapes \(3, 7\).*not \(3, 6\)"),
        ({"velocities": np.zeros(6)}, r"not \(3, 7\), \(6,\)"),
        ({"inverse_masses": np.zeros((2, 6, 6))}, r"and \(2, 6, 6\)$"),
        *(({"dt": dt}, "dt must be a finite number above 0") for dt in (0.0, "1")),
    ],
)
def test_a_batch_that_is_none_is_refused_by_name(changed, words):
    good = {"poses": states(3)[0], "velocities": np.zeros((3, 6)), "inverse_masses": MASSES}
    with pytest.raises(InvalidArgument, match=words):
        Joints(linear_table(), 3).step(**(good | {"dt": 1e-3} | changed))
    with pytest.raises(InvalidArgument, match="count, the number of joints, must be"):
        Joints(linear_table(), 0)


def test_joints_of_many_scenes_refuse_rk4_that_is_chosen_later():
    model, data = scene(sphere(3, "0.02 0 0.03"))
    joints = MujocoJoints(model, [data], linear_table())
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
    with pytest.raises(JointError, match="RK4"):
        joints.step()


@pytest.fixture
def in_float64():
    """JAX with float64."""
    jax = pytest.importorskip("jax", reason="the extra 'jax' is not installed")
    before = jax.config.jax_enable_x64
    jax.config.update("jax_enable_x64", True)
    yield jax
    jax.config.update("jax_enable_x64", before)


def test_a_step_in_jax_has_the_bits_of_joints_in_one_call_of_the_kernel(in_float64, monkeypatch):
    joints, (step, size) = Joints(table(), 6), arrays.jax_joint(table(), 1e-3)
    calls, counted = [], JointSteps.step
    monkeypatch.setattr(
        JointSteps, "step", lambda s, *a: calls.append(len(s.poses)) or counted(s, *a)
    )
    memory, each = np.zeros((6, size)), in_float64.jit(in_float64.vmap(step))
    poses, velocities, _ = states(6)
    for scale in (1.0, 0.9):
        poses[:, :3] *= scale
        result = each(memory, poses, velocities, np.tile(MASSES, (6, 1, 1)))
        expected, memory = joints.step(poses, velocities, MASSES, 1e-3), result.memory
        np.testing.assert_array_equal(result.wrench, expected)
        np.testing.assert_array_equal(result.error, joints.errors[1])
    assert calls == [6, 6, 6, 6]
    poses[2, 0] = np.nan
    result = step(memory, poses, velocities, np.tile(MASSES, (6, 1, 1)))
    assert result.status.tolist() == [0, 0, 1, 0, 0, 0]
    assert np.flatnonzero(np.isnan(result.wrench).all(axis=1)).tolist() == [2]
    with pytest.raises(InvalidArgument, match=r"\(6, 6\)\], in this order, not"):
        step(memory[0], poses[0], velocities[0], np.eye(5))
    with pytest.raises(InvalidArgument, match="dt must be a finite number above 0 s, not 0"):
        arrays.jax_joint(table(), dt=0.0)
    with pytest.raises(InvalidArgument, match=r"axes must have shape \(3, 3\), not \(2, 2\)"):
        arrays.jax_joint(table(), dt=1e-3, axes=np.eye(2))


def environments(count: int, model: Any) -> list[Any]:
    """Data of one scene, each pushed off in another way."""
    rng, datas = np.random.default_rng(7), [mujoco.MjData(model) for _ in range(count)]
    for data in datas:
        data.qvel[:] = rng.uniform(-0.2, 0.2, model.nv)
    return datas


@pytest.mark.parametrize("threads", [1, 3])
def test_many_environments_have_the_bits_of_each_alone(threads):
    slider = {
        "base": '<joint type="slide" axis="0 0 1"/>',
        "world": '<geom type="plane" size="5 5 .1"/>',
    }
    model, _ = scene(sphere(3, "0.02 0 0.01", 'solref="0.01 1"'), height=0.06, **slider)
    many, alone = environments(7, model), environments(7, model)
    joints = MujocoJoints(model, many, linear_table(), damping=0.05)
    single = [MujocoJoint(model, data, linear_table(), damping=0.05) for data in alone]
    for _ in range(60):
        joints.step(threads=threads)
        for one in single:
            one.step()
    for data, other, one, wrench in zip(many, alone, single, joints.wrenches, strict=True):
        assert data.qpos.tobytes() == other.qpos.tobytes()
        assert data.qacc.tobytes() == other.qacc.tobytes()
        assert wrench.tobytes() == one.wrench.tobytes()
    assert max(data.ncon for data in many) > 0


def test_two_parts_of_each_environment_step_together():
    second = f'<body name="far" pos="1 0 0">{FREEDOMS}{sphere(1, "0 0 0.01")}</body>'
    model, _ = scene(sphere(2, "0 0 0.01") + second)
    many, alone = environments(3, model), environments(3, model)
    names = ("base", "tip"), ("tip", "far")
    near, far = (MujocoJoints(model, many, linear_table(), *pair) for pair in names)
    single = [[MujocoJoint(model, data, linear_table(), *pair) for pair in names] for data in alone]
    for _ in range(20):
        near.step(far)
        for pair in single:
            step_joints(*pair)
    for data, other in zip(many, alone, strict=True):
        assert data.qpos.tobytes() == other.qpos.tobytes()
    with pytest.raises(JointError, match="without the others"):
        near.step()
    with pytest.raises(JointError, match="cannot step alone"):
        step_joints(near.joints[0], far.joints[0])


def test_further_inputs_are_those_of_all_environments():
    model, _ = scene(sphere(2, "0 0 0.01"))
    many, alone = environments(2, model), environments(2, model)
    joints = MujocoJoints(model, many, WARM, inputs={"temperature": 20.0})
    single = [MujocoJoint(model, data, WARM, inputs={"temperature": 20.0}) for data in alone]
    for degrees in (21.0, 22.0):
        joints.inputs = {"temperature": degrees}
        joints.step()
        for item in single:
            item.inputs = {"temperature": degrees}
            item.step()
    assert [d.qpos.tobytes() for d in many] == [d.qpos.tobytes() for d in alone]
    assert joints.joints[1].inputs == joints.inputs == {"temperature": 22.0}


def test_an_environment_whose_part_is_torn_stays_and_the_others_go_on():
    model, _ = scene(sphere(3, "0.02 0 0.01"))
    datas = environments(3, model)
    joints = MujocoJoints(model, datas, linear_table())
    datas[1].qpos[2] = 0.5  # m: far beyond the range
    with pytest.warns(JointWarning, match="1 of 3 joints"):
        joints.step()
    assert [data.time for data in datas] == [1e-3, 0.0, 1e-3]
    assert np.isnan(joints.wrenches).all(axis=1).tolist() == [False, True, False]
    assert [joint.report().steps for joint in joints.joints] == [1, 0, 1]
    mujoco.mj_resetData(model, datas[1])
    joints.restart(joints.failed)
    joints.step()
    assert [data.time for data in datas] == [2e-3, 1e-3, 2e-3]
    other = mujoco.MjData(mujoco.MjModel.from_xml_string("<mujoco/>"))
    for wrong, text in (
        (datas[0], "two are the same MjData"),
        (other, "belongs to another model"),
    ):
        with pytest.raises(InvalidArgument, match=text):
            MujocoJoints(model, [datas[0], wrong], linear_table())
    with pytest.raises(InvalidArgument, match="belongs to another model"):
        MujocoJoint(model, other, linear_table())
    with pytest.raises(InvalidArgument, match=r"a list .* \[mujoco\.MjData\(model\)\]"):
        MujocoJoints(model, datas[0], linear_table())
    with pytest.raises(InvalidArgument, match="a step of 3 environments cannot take joints of 1"):
        joints.step(MujocoJoints(model, [mujoco.MjData(model)], linear_table()))


def test_tensors_of_pytorch_give_a_tensor_of_their_type():
    torch = pytest.importorskip("torch", reason="the extra 'torch' is not installed")
    poses, velocities, _ = states(5)
    expected = Joints(table(), 5).step(poses, velocities, MASSES, 1e-3)
    tensors = [torch.tensor(array) for array in (poses, velocities, MASSES)]
    joints = Joints(table(), 5)
    np.testing.assert_array_equal(joints.step(*tensors, 1e-3).numpy(), expected)
    single = joints.step(*(tensor.float() for tensor in tensors), 1e-3)
    assert single.dtype == torch.float32
