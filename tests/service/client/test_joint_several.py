"""A part that moves at several interfaces, a link between three bodies: one wrench at each."""

from __future__ import annotations

import copy
import pickle
import re
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.linalg import eigh

from tests.service.client.answers import bar_compliance
from tests.service.client.joint_scenes import FREEDOMS, SILENT, mujoco, packed_table, sphere
from wrenchbook.service.client import Table, arrays
from wrenchbook.service.client.errors import InvalidArgument
from wrenchbook.service.client.joint import Joint, JointError, Joints, LinearPart
from wrenchbook.service.client.joint.joint import quaternion, rotation_vector
from wrenchbook.service.client.joint.mujoco_joint import MujocoJoint, step_joints
from wrenchbook.service.client.joint.mujoco_joints import MujocoJoints
from wrenchbook.service.client.rotation import rotation_matrix
from wrenchbook.surrogate.table.rows import LoadRange, Rows
from wrenchbook.surrogate.table.space import Input, space_of

HIGH = np.tile([400.0, 400.0, 400.0, 200.0, 200.0, 200.0], 2)  # N and N·m
TIPS = {"left": "wheel_l", "right": "wheel_r"}
BALL, BOX = sphere(3, "0.03 0.02 0.05"), f'<geom type="box" size=".1 .05 .02" mass="2" {SILENT}/>'
FREE = f'<freejoint/><geom type="box" size=".1 .2 .1" mass="10" {SILENT}/>'
HEAVY = f'<geom size=".02" mass="50" {SILENT}/>'


def link_compliance() -> np.ndarray:
    """A stem of 1 m along x from the base, an arm of 1 m from its end to each side, (12, 12)."""
    bar, C, levers = bar_compliance(), np.zeros((12, 12)), np.tile(np.eye(6), (2, 1, 1))
    for k, side in enumerate((1.0, -1.0)):
        turn = np.kron(np.eye(2), [[0, -side, 0], [side, 0, 0], [0, 0, 1]])  # x to the side
        C[6 * k : 6 * k + 6, 6 * k : 6 * k + 6] = turn @ bar @ turn.T
        levers[k, :3, 3:] = [[0, 0, -side], [0, 0, 0], [side, 0, 0]]  # u + r x arm
    return C + levers.reshape(12, 6) @ bar @ levers.reshape(12, 6).T


C = link_compliance()


@cache
def link(moving: int = 2, heat: int = 0) -> Table:
    """The link as a table, other interfaces held; with heat it grows, and kriging answers."""
    space = space_of(tuple(TIPS), [Input("temperature", "degC", "scalar", zero=20.0)] * heat)
    ends = np.array([[*-HIGH, *[20.0] * heat], [*HIGH, *[120.0] * heat]])
    rows = np.random.default_rng(3).uniform(ends[0], ends[1], (40, 12 + heat))
    slope = np.hstack([C, np.full((12, heat), 1e-6)])
    moved, slopes = (rows - space.zero) @ slope.T, np.tile(slope, (40, 1, 1))
    solved = Rows.of(rows, moved, compliance=slopes, source=["fea"] * 40, space=space)
    locked = tuple(range(6 * moving, 12))
    return packed_table(solved, LoadRange(ends[0], ends[1], space), linear=not heat, locked=locked)


def car(left: str, right: str, dt: float, base: str = FREE, gravity: float = 0.0, world: str = ""):
    """A chassis and two wheels at the ends of the link's arms."""
    height, wheels = 0.06 if world else 1.0, zip((1, -1), TIPS.values(), (left, right), strict=True)
    bodies = [f'<body name="{n}" pos="1 {y} 0">{FREEDOMS}{w}</body>' for y, n, w in wheels]
    model = mujoco.MjModel.from_xml_string(f"""
<mujoco><option timestep="{dt}" gravity="0 0 {gravity}"/><worldbody>{world}
  <body name="chassis" pos="0 0 {height}">{base}{"".join(bodies)}</body>
</worldbody></mujoco>""")
    return model, mujoco.MjData(model)


def jointed(model, data, damping: float = 0.0, bodies=TIPS, moving: int = 2) -> MujocoJoint:
    return MujocoJoint(model, data, link(moving), "chassis", damping=damping, bodies=bodies)


@pytest.mark.parametrize("mode", range(6, 13, 2))
def test_a_free_link_between_three_bodies_has_the_modes_of_its_stiffness_and_masses(mode):
    model, data = car(BALL, BOX, 1.0)
    mujoco.mj_forward(model, data)
    mass, stiffness = np.zeros((18, 18)), np.zeros((18, 18))
    mujoco.mj_fullM(model, data, mass)
    stiffness[6:, 6:] = np.linalg.inv(C)
    squares, modes = eigh(stiffness, mass)
    period = 2 * np.pi / np.sqrt(squares[mode])
    model, data = car(BALL, BOX, dt := period / 200)
    joint, speed = jointed(model, data), np.empty(1800)
    data.qvel[:] = 1e-3 * modes[:, mode]
    for k in range(len(speed)):
        joint.step()
        speed[k] = modes[:, mode] @ mass @ data.qvel
    (up,) = np.nonzero((speed[:-1] < 0) & (speed[1:] >= 0))
    crossed = (up - speed[up] / (speed[up + 1] - speed[up])) * dt
    assert np.diff(crossed).mean() == pytest.approx(period, rel=1e-3)


def test_the_wrenches_on_the_three_bodies_are_those_of_the_part_and_their_sum_is_zero():
    model, data = car(BALL, BOX, 1e-3)
    joint, total = jointed(model, data, 0.05), np.zeros(6)
    data.qvel[:] = np.random.default_rng(1).uniform(-0.2, 0.2, 18)
    for _ in range(50):
        joint.step()
    then = copy.copy(data)  # the pose and the motion before a step, and the accelerations in it
    joint.step()
    then.qacc[:] = data.qacc
    for work in (mujoco.mj_fwdPosition, mujoco.mj_fwdVelocity, mujoco.mj_rnePostConstraint):
        work(model, then)
    base, limit = then.body("chassis"), 1e-9 * np.abs(joint.wrench).max()
    for body, wrench in zip(
        map(then.body, ("chassis", *TIPS.values())), [None, *joint.wrench], strict=True
    ):
        motion, moved, inertial = np.empty(6), np.empty(6), (mujoco.mjtObj.mjOBJ_BODY, body.id)
        mujoco.mj_objectAcceleration(model, then, *inertial, motion, 0)
        mujoco.mj_objectVelocity(model, then, *inertial, moved, 0)
        frame = body.ximat.reshape(3, 3)
        inertia = frame @ np.diag(model.body_inertia[body.id]) @ frame.T
        force = model.body_mass[body.id] * motion[3:]
        moment = inertia @ motion[:3] + np.cross(moved[:3], inertia @ moved[:3])
        total += [*force, *(moment + np.cross(body.xipos - base.xpos, force))]
        if wrench is not None:
            pulled = np.array([force, moment + np.cross(body.xipos - body.xpos, force)])
            turned = (pulled @ base.xmat.reshape(3, 3)).ravel()
            np.testing.assert_allclose(turned, -wrench, atol=limit)
    np.testing.assert_allclose(total, 0.0, atol=limit)


@pytest.mark.parametrize("dt", [1e-3, 2e-3])
def test_an_undamped_link_keeps_the_energy_of_its_swing_within_half_a_per_cent(dt):
    joint, most = jointed(*car(BALL, BOX, dt, HEAVY, -9.81)), 0.0
    for k in range(int(10 / dt)):
        joint.step()
        most = max(most, joint.report().stored or 0.0) if k % 50 == 0 else most
    assert abs(joint.report().energy_drift or np.nan) < 0.005 * most


@pytest.mark.parametrize(("axis", "dt"), [(0, 1e-3), (2, 2e-3)])
def test_an_undamped_link_keeps_the_energy_of_a_blow_to_a_tip(axis, dt):
    model, data = car(BALL, BOX, dt, HEAVY)
    joint, data.qvel[axis], drift = jointed(model, data), 0.05, []
    for _ in range(30):
        drift += [joint.step() for _ in range(int(0.1 / dt))] and [joint.report().energy_drift]
    assert np.abs(drift).max() < 0.002 * 0.5 * 3 * 0.05**2


def test_undamped_feet_at_the_tips_stay_within_the_range():
    base = f'<joint type="slide" axis="0 0 1" damping="200"/>{HEAVY}'
    plane, foot = '<geom type="plane" size="5 5 .1"/>', sphere(3, geom="")
    joint = jointed(*(scene := car(foot, foot, 2e-3, base, -9.81, plane)))
    for data in [scene[1]] * 500:
        data.qfrc_applied[0] = -1e5 * data.qpos[0] + 45 * 9.81
        joint.step()
    assert np.abs(joint.wrench[:, 2]).max() < 100


def test_a_second_interface_without_a_mass_leaves_the_answer_of_the_first_alone():
    light, places = f'<geom size=".01" mass="1e-5" {SILENT}/><body/>', []
    for moving, bodies in ((2, TIPS), (1, {"left": "wheel_l"})):
        model, data = car(BALL, light, 1e-3, HEAVY, -9.81)
        model.dof_armature[6:] = 0.0 if moving == 2 else 1e9  # the right wheel is held
        joint = jointed(model, data, 0.1, bodies, moving)
        for _ in range(400):
            joint.step()
        places.append(data.qpos[:7].copy())
    np.testing.assert_allclose(places[0], places[1], atol=1e-3 * np.abs(places[1][:3]).max())


@pytest.mark.parametrize("right", [SILENT, ""])
@pytest.mark.parametrize("dt", [1e-3, 2e-3])
def test_feet_at_the_tips_rest_on_a_default_contact(right, dt):
    base = f'<joint type="slide" axis="0 0 1" damping="200"/>{HEAVY}'
    plane, pressed = '<geom type="plane" size="5 5 .1"/>', []
    model, data = car(sphere(3, geom=""), sphere(3, geom=right), dt, base, -9.81, plane)
    joint = jointed(model, data, 0.05)
    for _ in range(int(3 / dt)):
        lower = -0.02 * min(data.time, 1.0)
        data.qfrc_applied[0] = 1e5 * (lower - data.qpos[0]) + 50 * 9.81
        joint.step()
        pressed += [joint.wrench[:, 2]] if data.time > 2 else []
    assert np.std(pressed, axis=0).max() < 0.5  # N; a bounce has 30


def states(count: int) -> Any:
    """Poses, velocities, inverse masses that couple the tips, and rotations."""
    rng = np.random.default_rng(5)
    moved = (rng.uniform(-0.3, 0.3, (count, 12)) * HIGH @ C).reshape(count, 2, 6)
    turned = np.array([[rotation_matrix(r[3:]) for r in pair] for pair in moved])
    quaternions = [[quaternion(rotation_vector(R)) for R in pair] for pair in turned]
    poses, root = np.dstack([moved[..., :3], quaternions]), rng.normal(size=(12, 12))
    masses = np.tile(root @ root.T + np.eye(12), (count, 1, 1))
    return poses, rng.normal(size=(count, 2, 6)), masses, turned


def test_many_links_have_the_bits_of_each_alone_and_go_on_from_what_was_kept():
    joints, (*given, turned) = Joints(link(), 5), states(5)
    assert joints.coverage.tolist() == [[None, None]] * 5
    results = joints.step(*given, 1e-3, threads=2)
    assert (joints.coverage == "covered").all()
    for wrench, pose, R, velocity, mass in zip(results, given[0], turned, *given[1:], strict=True):
        single = Joint(link())
        np.testing.assert_array_equal(wrench, single.step(R, pose[:, :3], velocity, mass, 1e-3))
        assert single.coverage == {"left": "covered", "right": "covered"}
    other, memory = pickle.loads(pickle.dumps(joints)), joints.memory.copy()
    again = joints.step(*given, 1e-3)
    np.testing.assert_array_equal(other.step(*given, 1e-3), again)
    joints.memory[:] = memory
    np.testing.assert_array_equal(joints.step(*given, 1e-3), again)


def test_links_in_jax_have_the_bits_of_joints():
    package, (*given, _) = pytest.importorskip("jax", reason="the extra 'jax'"), states(3)
    with package.enable_x64(True):
        step, size = arrays.jax_joint(link(), 1e-3)
        result = package.vmap(step)(np.zeros((3, size)), *given)
    np.testing.assert_array_equal(result.wrench, Joints(link(), 3).step(*given, 1e-3))
    assert result.coverage.tolist() == [[0, 0]] * 3


def test_links_of_many_environments_have_the_bits_of_each_alone():
    model, data = car(BALL, BOX, 1e-3)
    data.qvel[7:] = 0.01
    many, alone = ([copy.copy(data) for _ in range(2)] for _ in range(2))
    joints = MujocoJoints(model, many, link(), "chassis", bodies=TIPS)
    single = [jointed(model, scene, 0.02) for scene in alone]
    for _ in range(20):
        joints.step()
        for joint in single:
            joint.step()
    assert [scene.qpos.tobytes() for scene in many] == [scene.qpos.tobytes() for scene in alone]
    np.testing.assert_array_equal(joints.wrenches, [joint.wrench for joint in single])
    assert single[0].report().covered_at == {"left": 1.0, "right": 1.0}
    with pytest.raises(JointError, match="have the same tip"):
        step_joints(single[0], single[0])


def test_the_wrenches_of_a_warm_link_are_those_of_its_temperature():
    joint, (_, velocities, masses, _) = Joint(link(heat=1), inputs={"temperature": 80.0}), states(1)
    moved = (C @ (0.3 * HIGH) + 60e-6).reshape(2, 6)
    wrench, _ = joint.state(moved[:, :3], moved[:, 3:])
    np.testing.assert_allclose(wrench.ravel(), 0.3 * HIGH, rtol=1e-4)
    joint.step(
        [rotation_matrix(r[3:]) for r in moved], moved[:, :3], velocities[0], masses[0], 1e-3
    )
    largest = joint.report().wrench_error["right.mz"]
    assert largest == (joint.error[1, 5], 1, 0.0)


def with_bodies(bodies) -> MujocoJoint:
    return jointed(*car(BALL, BOX, 1e-3), bodies=bodies)


HALF, NONE = np.tril(np.ones((12, 12)) + np.eye(12)), np.zeros((2, 3))
UNFIT = [
    (lambda: with_bodies(None), "no body for 'left'; no body for 'right'. Write bodies={'left': B"),
    (lambda: with_bodies(["wheel_l", "wheel_r"]), "Write bodies={'left': BODY, 'right': BODY}"),
    (lambda: with_bodies(TIPS | {"top": "chassis"}), "no interface 'top' that moves"),
    (lambda: with_bodies(TIPS | {"right": "wheel_l"}), "one body at two interfaces"),
    (lambda: with_bodies(TIPS | {"right": "chassis"}), "'chassis' must be a child of body 'chas"),
    (
        lambda: Joint(link(), interface="left"),
        "interface='left' needs a part that moves at one interface",
    ),
    (
        lambda: Joint(link()).state([0, 0, 1e-3], [0, 0, 0]),
        "translation must have shape (2, 3), not (3,)",
    ),
    (lambda: Joint(link(), method="additive"), "needs one wrench at one interface"),
    (lambda: LinearPart.of(link()), "springs need a part that moves at one interface only, but"),
    (
        lambda: Joint(link()).step(np.eye(3), 0, 0, 0, 1e-3),
        "R must have shape (2, 3, 3), not (3, 3)",
    ),
    (lambda: Joints(link(), 1).step(*[np.zeros(1)] * 3, 1e-3), "(1, 2, 7), (1, 2, 6)"),
    (lambda: copy.copy(Joints(link(), 1)), "share states"),
    (
        lambda: Joint(link()).step([np.eye(3)] * 2, NONE, np.zeros((2, 6)), HALF, 1),
        "it differs from its transpose by 1",
    ),
]


@pytest.mark.parametrize(("make", "words"), UNFIT)
def test_what_is_not_that_of_several_interfaces_is_refused(make, words):
    with pytest.raises((InvalidArgument, JointError), match=re.escape(words)):
        make()
