"""The joint in other engines, by the recipes of data/scenes, against the joint in MuJoCo."""

from __future__ import annotations

import numpy as np
import pytest

from tests.acceptance.test_simulators import script
from tests.service.client.joint_scenes import (
    FREEDOMS,
    SILENT,
    linear_table,
    mujoco,
    scene,
    sphere,
)
from tests.service.client.test_joints import in_float64 as in_float64
from wrenchbook.service.client.joint.mujoco_joint import MujocoJoint

TABLE = linear_table()
PENDULUM = f"""
<mujoco><option timestep="0.001"/><worldbody><body name="carriage">
  <joint type="slide" axis="0 0 1" stiffness="2e4"/><geom size=".1" mass="20" {SILENT}/>
  <body name="tip" pos="1 0 0">{FREEDOMS}<geom size=".03" mass="1" {SILENT}/>
    <body><joint type="hinge" axis="0 1 0"/>
      <geom size=".05" pos="0 0 -.3" mass="2" {SILENT}/></body>
  </body>
</body></worldbody></mujoco>"""


def test_a_carriage_and_a_pendulum_on_a_part_move_in_drake_as_in_mujoco():
    """A shaken base, and a part in the middle of a chain."""
    pytest.importorskip("pydrake", reason="has no wheel here")
    module = script("drake_joint")
    simulator, plant, context = module.scene(TABLE, angle=0.5)
    model = mujoco.MjModel.from_xml_string(PENDULUM)
    data = mujoco.MjData(model)
    data.qpos[-1], joint = 0.5, MujocoJoint(model, data, TABLE, base="carriage")
    here, there = [], []
    for step in range(1, 601):
        data.qfrc_applied[0] = module.PUSH * np.sin(2 * np.pi * module.HERTZ * data.time)
        joint.step()
        simulator.AdvanceTo(1e-3 * step)
        pose = plant.GetFrameByName("tip").CalcPose(context, plant.GetFrameByName("undeformed"))
        angles = (plant.GetJointByName(name) for name in ("lift", "hinge"))
        lift, hinge = (angles_of.GetOnePosition(context) for angles_of in angles)
        here.append([lift, *pose.translation()[[0, 2]], hinge])
        there.append([data.qpos[0], data.qpos[1], data.qpos[3], data.qpos[-1]])
    off = np.sqrt(np.square(np.array(here) - there).sum(axis=0) / np.square(there).sum(axis=0))
    assert (off < 1e-6).all(), off


def test_environments_of_mjx_move_as_in_mujoco(in_float64):
    pytest.importorskip("mujoco.mjx", reason="mujoco-mjx is not installed")
    module = script("mjx_joint")
    hertz, heights = module.main(TABLE, 3, 100)
    model = mujoco.MjModel.from_xml_string(module.SCENE)
    for frequency, height in zip(hertz, heights, strict=True):
        data = mujoco.MjData(model)
        joint = MujocoJoint(model, data, TABLE, base="carriage")
        for _ in range(100):
            data.qfrc_applied[0] = 1e7 * (9.81 + 2 * np.sin(2 * np.pi * frequency * data.time))
            joint.step()
        assert height == pytest.approx(data.qpos[3], rel=1e-9)


def test_a_foot_on_a_contact_of_mjx_feels_the_part_as_in_mujoco(in_float64):
    mjx = pytest.importorskip("mujoco.mjx", reason="mujoco-mjx is not installed")
    module, jnp = script("mjx_joint"), in_float64.numpy
    foot = {"world": '<geom type="plane" size="5 5 .1"/>', "height": 0.04}
    model, data = scene(sphere(3, "0.01 0 0", ""), option='jacobian="dense"', **foot)
    joint = MujocoJoint(model, data, TABLE)
    step, size = module.stepper(model, TABLE)
    step, there, memory = in_float64.jit(step), mjx.put_data(model, data), jnp.zeros(size)
    for _ in range(60):
        joint.step()
        there, memory, part = step(there, memory)
    np.testing.assert_allclose(there.qpos, data.qpos, rtol=1e-9, atol=1e-12)
    assert data.ncon == 1
    assert (int(part.status), int(part.coverage)) == (0, 0)
    assert data.qpos[2] > 1e-3  # m: the contact lifts the tip
