"""The joint against scenes without one: a fine chain of rigid pieces, and parts that turn far."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from tests.service.client.joint_scenes import (
    SILENT,
    displacement_in,
    linear_table,
    mujoco,
    packed_table,
    scene,
)
from wrenchbook.service.client.joint.mujoco_joint import MujocoJoint
from wrenchbook.surrogate.table.rows import LoadRange, Rows

BENDING, LINK, PIECES = 600.0, 0.8, 40  # N m^2, kg
SWING = (
    '<body name="rod"><joint name="last" type="hinge" axis="0 1 0"/>'
    f'<geom type="capsule" fromto="0 0 0 0.3 0 0" size=".02" mass="1" {SILENT}/></body>'
)
BASE = '<joint name="first" type="hinge" axis="0 1 0" stiffness="150"/>'
HEAVY = f'<geom type="box" size=".1 .05 .05" mass="4" pos="-.1 0 0" {SILENT}/>'
TIP = f'<geom size=".04" mass="2" {SILENT}/>'


def link_compliance() -> np.ndarray:
    """du/dw of a link of 1 m along x, stiff along its axis."""
    C = np.diag([1e-8, 0, 0, 1e-4, 0, 0])
    for out, turn, sign in ((1, 5, 1.0), (2, 4, -1.0)):
        C[out, out], C[turn, turn] = 1 / (3 * BENDING), 1 / BENDING
        C[out, turn] = C[turn, out] = sign / (2 * BENDING)
    return C


def chain(dt):
    """The link as rigid pieces, with a hinge of its bending stiffness in each cell's middle."""
    cell, pieces = 1 / PIECES, ""
    for number in range(PIECES):
        at, centre = (
            cell * (0.5 if number == 0 else 1),
            cell * (0.5 if number < PIECES - 1 else 0.25),
        )
        pieces += (
            f'<body pos="{at} 0 0"><joint type="hinge" axis="0 1 0" stiffness="{BENDING / cell}"/>'
            f'<geom type="box" size="{cell / 2} .01 .01" pos="{centre} 0 0" '
            f'mass="{LINK / PIECES}" {SILENT}/>'
        )
    end = f'<body pos="{cell / 2} 0 0">{TIP}{SWING}</body>' + "</body>" * PIECES
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><option timestep="{dt}"/><worldbody><body name="base" pos="0 0 1">'
        f"{BASE}{HEAVY}{pieces}{end}</body></worldbody></mujoco>"
    )
    return model, mujoco.MjData(model)


def angles(model, data, step, every, count=1000):
    """Run 2 s and return the angles of the first and the last hinge, rad, each 2 ms."""
    data.joint("last").qpos[0] = 0.5
    results = []
    for _ in range(count):
        for _ in range(every):
            step()
        results.append([data.joint("first").qpos[0], data.joint("last").qpos[0]])
    return np.array(results)


def test_a_flexible_link_between_two_moving_bodies_moves_as_a_fine_chain():
    fine = chain(5e-6)
    truth = angles(*fine, lambda: mujoco.mj_step(*fine), 400)
    half = f'<geom size=".01" mass="{LINK / 2}" pos="{{}} 0 0" {SILENT}/>'
    model, data = scene(
        half.format(-0.25) + TIP + SWING, base=BASE, base_geom=HEAVY + half.format(0.25)
    )
    joint = MujocoJoint(model, data, linear_table(link_compliance()), damping=0.0)
    result = angles(model, data, joint.step, 2)
    error = np.sqrt(((result - truth) ** 2).mean(axis=0) / (truth**2).mean(axis=0))
    assert (error < 0.02).all(), error


# A part whose energy is quadratic in translation and rotation vector, and which turns far.
STIFF = np.diag([900.0, 700.0, 800.0, 3.0, 2.0, 2.5])  # N/m to N·m/rad
STIFF[1, 5] = STIFF[5, 1] = 12.0
STIFF[2, 4] = STIFF[4, 2] = -11.0
REACH = np.array([0.02, 0.02, 0.02, 0.2, 0.2, 0.2])  # m and rad


def spatial(moved):
    """The wrench of a displacement: F, and M = T^-T mu of the moment mu on the rotation vector."""
    result = STIFF @ moved
    # d(moved) = T d(angle), by central differences of the rotations themselves.
    turned, small = Rotation.from_rotvec(moved[3:]), 1e-6 * np.eye(3)
    ahead, behind = (Rotation.from_rotvec(sign * small) * turned for sign in (1, -1))
    result[3:] = (ahead.as_rotvec() - behind.as_rotvec()) / 2e-6 @ result[3:]
    return result


def turning_table():
    """A table of such a part, 120 rows with tangents."""
    rng = np.random.default_rng(2)
    moved = rng.uniform(-1, 1, (120, 6)) * REACH
    moved[0] = 0
    tangents = []
    for item in moved:
        steps = 1e-6 * REACH
        columns = [
            (spatial(item + step) - spatial(item - step)) / (2 * size)
            for step, size in zip(np.diag(steps), steps, strict=True)
        ]
        tangents.append(np.linalg.inv(np.array(columns).T))
    wrenches = np.array([spatial(item) for item in moved])
    high = np.abs(wrenches).max(axis=0)
    rows = Rows.of(wrenches, moved, compliance=np.array(tangents), source=["fea"] * len(moved))
    return packed_table(rows, LoadRange(-high, high))


def test_a_part_that_turns_far_keeps_the_energy_of_the_motion():
    """The spatial moment on the ball, whose velocity is in the axes of the tip."""
    box = f'<geom type="box" size=".05 .08 .06" mass="2" {SILENT}/>'
    model, data = scene(box + "<body/>", 2e-4, gravity="0 0 0")
    joint = MujocoJoint(model, data, turning_table(), damping=0.0)
    data.qvel[3:] = [3.0, 3.6, -3.0]
    data.qvel[:3] = [0.1, 0.05, -0.1]
    energies, turned = [], 0.0
    for _ in range(5000):
        mujoco.mj_energyVel(model, data)
        moved = displacement_in(data)
        turned = max(turned, float(np.linalg.norm(moved[3:])))
        energies.append(data.energy[1] + 0.5 * moved @ STIFF @ moved)
        joint.step()
    assert np.degrees(turned) > 12
    blocks = np.array(energies[1:4971]).reshape(10, -1).mean(axis=1)
    assert np.ptp(blocks) < 3e-3 * blocks[0]
