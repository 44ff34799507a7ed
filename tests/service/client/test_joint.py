"""The joint against closed forms, in MuJoCo and by its own law."""

from __future__ import annotations

import math
import warnings

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.service.client.answers import bar_compliance
from tests.service.client.joint_scenes import (
    FREEDOMS,
    HIGH,
    SILENT,
    SLIDES,
    displacement_in,
    linear_table,
    mujoco,
    packed_table,
    scene,
    sphere,
)
from wrenchbook.service.client.errors import InvalidArgument
from wrenchbook.service.client.joint import Joint, JointError, JointRangeError, JointWarning
from wrenchbook.service.client.joint.joint import rotation_vector
from wrenchbook.service.client.joint.mujoco_joint import MujocoJoint, step_joints
from wrenchbook.service.client.rotation import rotation_matrix
from wrenchbook.surrogate.table.rows import LoadRange, Rows

C = bar_compliance()
K = np.linalg.inv(C)
WEIGHT = 5 * 9.81
TABLE = linear_table()


def reference_rate(stiffness, inverse_mass, dt, damping):
    """The law of the kernel's joint_rate, in numpy."""
    half = np.linalg.cholesky(inverse_mass)
    squares, modes = np.linalg.eigh(half.T @ stiffness @ half)
    theta = np.clip(1 - 0.5 / np.maximum(squares * dt * dt, 1e-30), 0, 1)
    back = np.linalg.solve(half.T, modes)
    return (back * (dt * theta * squares + 2 * damping * np.sqrt(squares))) @ back.T


@pytest.mark.parametrize("dt", [1e-4, 1e-3, 5e-3])
def test_the_kernels_rate_is_the_sum_over_the_modes(dt):
    rng = np.random.default_rng(1)
    half = rng.normal(size=(6, 6))
    mass = half @ half.T + 0.1 * np.eye(6)
    result = TABLE.packed.joint_rate(K, mass, dt, 0.03)
    expected = reference_rate(K, mass, dt, 0.03)
    np.testing.assert_allclose(result, expected, rtol=1e-9, atol=1e-12 * np.abs(expected).max())


@pytest.mark.parametrize(
    ("dt", "at"), [(1e-3, "0 0 0"), (1e-3, "0.02 0 0.03"), (5e-3, "0.02 0 0.03")]
)
def test_a_hanging_mass_sags_as_its_weight_bends_the_bar(dt, at):
    model, data = scene(sphere(5, at), dt)
    joint = MujocoJoint(model, data, TABLE, damping=0.3)
    for _ in range(int(8 / dt)):
        joint.step()
    lever = np.array([float(part) for part in at.split()])
    moved, turned = joint.displacement[:3], joint.displacement[3:]
    arm = rotation_matrix(turned) @ lever
    load = np.concatenate([[0, 0, -WEIGHT], np.cross(arm, [0, 0, -WEIGHT])])
    np.testing.assert_allclose(np.concatenate([moved, turned]), C @ load, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(joint.wrench, load, atol=1e-7)


@pytest.mark.parametrize("dt", [1e-3, 2e-3])
@pytest.mark.parametrize("at", ["0 0 0", "1e-6 0 0"], ids=["diagonal", "full"])
def test_a_mass_on_a_bar_swings_at_its_frequency_and_keeps_its_amplitude(dt, at):
    point = f'<inertial mass="5" pos="{at}" diaginertia="1e-4 1e-4 1e-4"/>'
    model, data = scene(point, dt)
    joint, sag = MujocoJoint(model, data, TABLE, damping=0.0), WEIGHT * C[2, 2]
    seconds = 101 * 2 * math.pi * math.sqrt(5 * C[2, 2])
    heights = []
    for _ in range(int(seconds / dt)):
        joint.step()
        heights.append(data.qpos[2] + sag)
    z = np.array(heights)
    up = np.flatnonzero((z[:-1] < 0) & (z[1:] >= 0))
    period = np.diff(up - z[up] / (z[up + 1] - z[up])).mean() * dt
    assert 1 / period == pytest.approx(1 / (2 * math.pi * math.sqrt(5 * C[2, 2])), rel=5e-3)
    assert z[-int(1.2 * period / dt) :].max() == pytest.approx(sag, rel=1e-2)


def test_the_damping_asked_for_is_the_decay():
    model, data = scene('<inertial mass="5" pos="1e-6 0 0" diaginertia="1e-4 1e-4 1e-4"/>', 2e-4)
    joint, sag = MujocoJoint(model, data, TABLE, damping=0.02), WEIGHT * C[2, 2]
    period, heights = 2 * math.pi * math.sqrt(5 * C[2, 2]), []
    for _ in range(int(10.5 * period / 2e-4)):
        joint.step()
        heights.append(data.qpos[2] + sag)
    last = np.max(heights[-int(1.0 * period / 2e-4) :])
    assert last == pytest.approx(sag * math.exp(-0.02 * 2 * math.pi * 10), rel=2e-2)


def test_a_base_shaken_through_resonance_moves_the_mass_as_the_closed_form():
    model, data = scene(
        '<inertial mass="3" pos="0 0 0" diaginertia="1e-5 1e-5 1e-5"/>',
        base='<joint type="slide" axis="0 0 1"/>',
        base_geom=f'<geom size=".02" mass="1e7" {SILENT}/>',
        gravity="0 0 0",
    )
    joint, omega = MujocoJoint(model, data, TABLE, damping=0.02), math.sqrt(1 / (3 * C[2, 2]))
    # A sweep of 4 s from 0.8 to 1.2 of the resonance of the linear mass on its bar.
    sweep = np.linspace(0, 4, 4001)
    phase = omega * (0.8 * sweep + 0.05 * sweep**2)
    pushed = 0.5 * np.sin(phase)  # m/s^2
    results = []
    for item in pushed[:-1]:
        data.qfrc_applied[0] = 1e7 * item
        joint.step()
        results.append(data.qpos[3])

    def law(t, y):
        return [y[1], -(omega**2) * y[0] - 2 * 0.02 * omega * y[1] - np.interp(t, sweep, pushed)]

    truth = solve_ivp(law, (0, 4), [0, 0], t_eval=sweep[1:], rtol=1e-9, atol=1e-12, max_step=1e-3)
    error = np.sqrt(np.mean((np.array(results) - truth.y[0]) ** 2))
    assert error < 0.02 * np.sqrt(np.mean(truth.y[0] ** 2))


def test_the_wrench_of_a_moving_base_has_the_inertia_of_the_mass():
    """3 kg on the bar, base 5 cm at 2 Hz: F_z is not the weight alone."""
    model, data = scene(
        sphere(3),
        base='<joint type="slide" axis="0 0 1"/>',
        base_geom=f'<geom size=".02" mass="1e7" {SILENT}/>',
    )
    joint, omega, forces = MujocoJoint(model, data, TABLE, damping=0.05), 2 * math.pi * 2, []
    data.qvel[0] = 0.05 * omega
    data.qpos[3] = -3 * 9.81 * C[2, 2]
    for step in range(4000):
        data.qfrc_applied[0] = 1e7 * (9.81 - 0.05 * omega**2 * math.sin(omega * step * 1e-3))
        joint.step()
        forces.append(joint.wrench[2])
    own = math.sqrt(1 / (3 * C[2, 2]))
    ratio = omega / own
    gain = math.sqrt((1 + (0.1 * ratio) ** 2) / ((1 - ratio**2) ** 2 + (0.1 * ratio) ** 2))
    swing = 3 * 0.05 * omega**2 * gain
    last = np.array(forces[-1000:])
    assert last.min() == pytest.approx(-29.43 - swing, rel=0.02)
    assert last.max() == pytest.approx(-29.43 + swing, abs=0.02 * swing)


FOOT = {
    "base": '<joint name="lift" type="slide" axis="0 0 1" damping="200"/>',
    "world": '<geom type="plane" size="5 5 .1"/>',
    "height": 0.06,
}


@pytest.mark.parametrize("solref", ["0.02 1", "0.01 1", "0.004 1"])
@pytest.mark.parametrize("dt", [1e-3, 4e-3])
def test_a_foot_pressed_on_a_contact_does_not_chatter(solref, dt):
    model, data = scene(sphere(3, geom=f'solref="{solref}"'), dt, **FOOT)
    joint, forces = MujocoJoint(model, data, TABLE, damping=0.05), []
    for step in range(int(4 / dt)):
        target = -0.03 * min(step * dt, 1)
        data.qfrc_applied[0] = 1e5 * (target - data.qpos[0]) + 50 * 9.81
        joint.step()
        if step * dt > 3:
            forces.append(joint.wrench[2])
    assert np.std(forces) < 0.01 * abs(np.mean(forces))
    assert np.mean(forces) == pytest.approx(150, abs=10)


def free_pair(dt=1e-3, gravity="0 0 0"):
    tip = f'<geom type="box" size=".05 .08 .03" mass="1" pos="0.03 0 .05" {SILENT}/>'
    heavy = f'<geom size=".1" mass="2" pos=".02 .03 0" {SILENT}/>'
    model, data = scene(tip, dt, base="<freejoint/>", base_geom=heavy, gravity=gravity)
    joint = MujocoJoint(model, data, TABLE, damping=0.02)
    return model, data, joint


def test_a_falling_pair_that_swings_keeps_its_momentum():
    model, data, joint = free_pair(gravity="0 0 -9.81")
    data.qvel[6:9] = [0, 0.05, 0.02]
    mujoco.mj_forward(model, data)
    mujoco.mj_subtreeVel(model, data)
    before = 3 * data.subtree_linvel[1].copy()
    for _ in range(100):
        joint.step()
    mujoco.mj_forward(model, data)
    mujoco.mj_subtreeVel(model, data)
    after = 3 * data.subtree_linvel[1]
    assert after[2] == pytest.approx(before[2] - 3 * 9.81 * 0.1, rel=2e-4)
    np.testing.assert_allclose(after[:2], before[:2], atol=2e-4)


def test_the_part_adds_nothing_to_the_rate_of_linear_and_angular_momentum():
    """MuJoCo's own integrator drifts by its step; the forces of the joint are internal."""
    model, data, joint = free_pair()
    data.qvel[3:6] = [0.3, 0.7, 0.5]
    data.qvel[6:9] = [0, 0.05, 0.02]
    for _ in range(50):
        joint.step()
    with_part = data.qacc.copy()
    free = mujoco.MjData(model)
    free.qpos[:], free.qvel[:] = data.qpos, data.qvel
    mujoco.mj_forward(model, free)
    data2 = mujoco.MjData(model)
    data2.qpos[:], data2.qvel[:] = data.qpos, data.qvel
    joint.attach(data2, joint._steps, 0)
    joint.step()
    with_part = data2.qacc - free.qacc
    moved, turned, force = np.zeros(3), np.zeros(3), np.zeros(3)
    for body in (1, 2):
        linear, angular = np.zeros((3, model.nv)), np.zeros((3, model.nv))
        mujoco.mj_jacBodyCom(model, free, linear, angular, body)
        push = model.body_mass[body] * linear @ with_part
        inertia = free.ximat[body].reshape(3, 3)
        spin = inertia @ np.diag(model.body_inertia[body]) @ inertia.T @ angular @ with_part
        moved += push
        turned += spin + np.cross(free.xipos[body], push)
        force += np.abs(push)
    np.testing.assert_allclose(moved, 0, atol=1e-9 * force.max())
    np.testing.assert_allclose(turned, 0, atol=1e-9 * force.max())


def test_energy_never_grows_without_input():
    model, data, joint = free_pair(dt=5e-4)
    data.qvel[3:6] = [0.0, 0.4, 0.2]
    data.qvel[6:9] = [0, 0.1, 0.05]
    energies = []
    for _ in range(4000):
        joint.step()
        moved = displacement_in(data)
        mujoco.mj_energyVel(model, data)
        energies.append(data.energy[1] + 0.5 * moved @ K @ moved)
    blocks = np.array(energies).reshape(8, -1).max(axis=1)
    assert (np.diff(blocks) <= 1e-3 * blocks[0]).all()


def test_two_arms_closed_by_a_connect_run():
    arm = (
        '<body name="base{n}" pos="{x} 0 1">'
        f'<geom size=".02" mass="5" {SILENT}/><body name="tip{{n}}" pos="0 0 -0.5">{FREEDOMS}'
        f'<geom size=".05" mass="1" {SILENT}/><body name="hand{{n}}" pos="0 0 -0.3">'
        f'<joint type="hinge" axis="0 1 0"/><geom size=".03" mass="0.5" {SILENT}/></body></body>'
        "</body>"
    )
    model = mujoco.MjModel.from_xml_string(f"""
<mujoco><option timestep="0.002"/><worldbody>{arm.format(n=1, x=0)}{arm.format(n=2, x=0.2)}
</worldbody><equality><connect body1="hand1" body2="hand2" anchor="0.1 0 0" solref="0.004 1"/>
</equality></mujoco>""")
    data = mujoco.MjData(model)
    joints = [MujocoJoint(model, data, TABLE, f"base{n}", f"tip{n}", damping=0.1) for n in (1, 2)]
    for _ in range(3000):
        step_joints(*joints)
    assert np.abs(data.qvel).max() < 1e-3
    pull = sum(joint.wrench[2] for joint in joints)
    assert pull == pytest.approx(-2 * 1.5 * 9.81, rel=1e-3)


def test_the_law_for_other_simulators_is_that_in_mujoco():
    """A point mass on a fixed base by semi-implicit Euler, against MuJoCo's scene."""
    inertia = np.array([5, 5, 5, 1e-2, 1e-2, 1e-2])
    model, data = scene('<inertial mass="5" pos="0 0 0" diaginertia="1e-2 1e-2 1e-2"/>')
    there, here = MujocoJoint(model, data, TABLE), Joint(TABLE)
    u, v, R = np.zeros(3), np.zeros(6), np.eye(3)
    for _ in range(200):
        there.step()
        free = v + 1e-3 * np.array([0, 0, -9.81, 0, 0, 0])
        wrench = here.step(R, u, free, np.diag(1 / inertia), 1e-3)
        v = free - 1e-3 * wrench / inertia
        u, R = u + 1e-3 * v[:3], rotation_matrix(1e-3 * v[3:]) @ R
    np.testing.assert_allclose(u, data.qpos[:3], rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(here.wrench, there.wrench, rtol=1e-6, atol=1e-6)


STATE = {"R": np.eye(3), "p": np.zeros(3), "velocity": np.zeros(6), "inverse_mass": np.eye(6)}


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        *(
            ({"dt": dt}, "dt must be a finite number of seconds above 0, not")
            for dt in (0.0, -1e-3)
        ),
        ({"dt": np.nan}, "dt must be a finite number of seconds above 0, not nan"),
        ({"velocity": np.full(6, np.nan)}, "velocity must be finite"),
        ({"p": np.zeros(2)}, r"p must have shape \(3,\), not \(2,\)"),
        ({"velocity": np.zeros(3)}, r"velocity must have shape \(6,\), not \(3,\)"),
        ({"inverse_mass": np.eye(3)}, r"\(3, 3\)$"),
        ({"inverse_mass": -np.eye(6)}, "smallest eigenvalue is -1, .* Give every freedom"),
        ({"p": np.full(3, np.nan)}, "p must be finite, not"),
        *(({name: "x"}, f"{name} must be numbers of shape") for name in ("R", "p", "dt")),
        ({"R": np.diag([1.0, 1.0, -1.0])}, "right-handed"),
    ],
)
def test_a_state_that_is_none_is_refused_by_name(changed, words):
    with pytest.raises(InvalidArgument, match=words):
        Joint(TABLE).step(*(STATE | {"dt": 1e-3} | changed).values())


@pytest.mark.parametrize(
    ("pieces", "options", "words"),
    [
        ({"joints": SLIDES}, {}, "a ball, in this order, but it has slide, slide, slide"),
        ({"joints": '<joint type="ball"/>' + SLIDES}, {}, "3 slides and a ball, in this order"),
        ({"joints": FREEDOMS.replace('"1 0 0"', '"0 1 1"', 1)}, {}, "have the axes x, y, z"),
        (
            {"joints": FREEDOMS.replace('"ball"', '"ball" damping="1" armature="1"')},
            {},
            "damping and armature",
        ),
        ({"joints": FREEDOMS.replace('"slide"', '"slide" stiffness="9"', 1)}, {}, "has stiffness"),
        ({"joints": FREEDOMS.replace('"slide"', '"slide" ref="1"', 1)}, {}, "has a reference"),
        ({"joints": FREEDOMS.replace('"ball"', '"ball" armature="1"')}, {}, "has armature"),
        ({"option": 'integrator="RK4"'}, {}, "RK4"),
        ({}, {"tip": "hand"}, "no body 'hand'; its bodies: 'base', 'tip'"),
        ({}, {"base": None}, "no body None; its bodies: 'base', 'tip'"),
        ({}, {"bodies": {"end": "tip"}}, "has one interface; give tip=BODY"),
        ({}, {"damping": -0.1}, "damping"),
        ({}, {"damping": math.nan}, "damping"),
    ],
)
def test_a_scene_that_has_not_the_parts_freedoms_is_refused_by_name(pieces, options, words):
    model, data = scene(sphere(1), **pieces)
    with pytest.raises((JointError, InvalidArgument), match=words):
        MujocoJoint(model, data, TABLE, **options)


def test_two_joints_of_one_tip_or_of_two_scenes_are_refused():
    one, other = (MujocoJoint(*scene(sphere(3)), TABLE) for _ in range(2))
    for joints, text in (
        ((), "pass all joints of the scene: step_joints"),
        ((one, one), "two of the joints at 'tip', 'tip' have the same tip"),
        (
            (one, other),
            "the 2 joints belong to 2 different MjData; call step_joints once for each",
        ),
    ):
        with pytest.raises(JointError, match=text):
            step_joints(*joints)


def test_a_joint_whose_tip_has_a_later_joint_is_not_stepped():
    model, data = scene(sphere(3))
    first, later = (MujocoJoint(model, data, TABLE) for _ in range(2))
    later.step()
    with pytest.raises(JointError, match="a newer joint at 'tip' replaced this one"):
        first.step()


def test_beyond_the_range_the_wrench_goes_on_linearly_with_one_warning():
    joint = Joint(linear_table(high=HIGH / 100))
    with pytest.warns(JointWarning, match="outside the load range"):
        wrench, _ = joint.state(C[:3] @ [0, 0, 12, 0, 0, 0], C[3:] @ [0, 0, 12, 0, 0, 0])
    np.testing.assert_allclose(wrench, [0, 0, 12, 0, 0, 0], atol=1e-9)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        joint.state(C[:3] @ [0, 0, 13, 0, 0, 0], C[3:] @ [0, 0, 13, 0, 0, 0])


def test_a_pose_a_little_beyond_the_range_is_not_said_to_need_once_the_range():
    joint = Joint(linear_table(high=HIGH / 100))
    moved = C @ [0, 0, 8.0008, 0, 0, 0]
    with pytest.warns(JointWarning, match=r"needs 0\.01 % more than .* F_z = 8\.0008, beyond -8"):
        joint.state(moved[:3], moved[3:])


@pytest.mark.parametrize("corner", [[0, 0, -1, 0, 0, 0], [1, 1, 1, 1, 1, 1], [-1, 1, -1, 1, -1, 1]])
def test_a_pose_on_the_boundary_of_the_range_is_not_beyond_it(corner):
    wrench = np.array(corner) * HIGH
    moved = C @ wrench
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        np.testing.assert_allclose(Joint(TABLE).state(moved[:3], moved[3:])[0], wrench, atol=1e-6)


def test_a_range_that_holds_no_state_without_load_has_a_joint_that_starts_there():
    low, high = -HIGH, np.append(HIGH[:2], [-700.0, *HIGH[3:]])
    wrenches = np.random.default_rng(4).uniform(low, high, (12, 6))
    slopes = np.tile(C, (12, 1, 1))
    rows = Rows.of(wrenches, wrenches @ C.T, compliance=slopes, source=["fea"] * 12)
    model, data = scene(sphere(5))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        joint = MujocoJoint(model, data, packed_table(rows, LoadRange(low, high), linear=True))
        joint.step()
    assert joint.coverage == "covered"


def test_a_pose_beyond_twice_the_range_is_raised_by_name():
    joint = Joint(linear_table(high=HIGH / 100))
    with pytest.raises(JointRangeError, match=r"bar: .* needs 200 % more than .* F_z = 24"):
        joint.state(C[:3] @ [0, 0, 24, 0, 0, 0], C[3:] @ [0, 0, 24, 0, 0, 0])


def test_a_heavy_mass_ends_with_an_error_and_not_with_a_pose_far_away():
    model, data = scene(sphere(5000))
    joint = MujocoJoint(model, data, TABLE)

    def run():
        for _ in range(2000):
            joint.step()

    with pytest.raises(JointRangeError), pytest.warns(JointWarning):
        run()
    assert np.abs(data.qpos).max() < 10


def test_a_rotation_vector_is_the_inverse_of_its_matrix():
    for vector in ([0, 0, 0], [1e-9, 0, 0], [0.3, -0.2, 0.1], [1.5, 1.5, 1.5]):
        np.testing.assert_allclose(rotation_vector(rotation_matrix(vector)), vector, atol=1e-15)


@pytest.mark.parametrize("size", [1e-6, 9e-4, 1.1e-3, 0.3])
def test_the_stiffness_is_the_change_of_the_moment_with_the_angle_about_fixed_axes(size):
    vector, spin, step = size * np.array([0.6, -0.5, 0.62]), np.array([0.2, 0.7, -0.4]), 1e-6
    joint = Joint(linear_table(high=1e4 * HIGH))
    moments = [
        joint.state(
            np.zeros(3), rotation_vector(rotation_matrix(turn * spin) @ rotation_matrix(vector))
        )
        for turn in (step, -step)
    ]
    change = (moments[0][0] - moments[1][0])[3:] / (2 * step)
    stiffness = joint.state(np.zeros(3), vector)[1][3:, 3:]
    assert spin @ stiffness @ spin == pytest.approx(spin @ change, rel=1e-7)
