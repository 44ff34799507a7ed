"""The joint in other engines, by the recipes of data/scenes, against the joint in MuJoCo."""

from __future__ import annotations

import numpy as np
import pytest

from tests.acceptance.test_simulators import script
from tests.service.client.joint_scenes import FREEDOMS, SILENT, linear_table, mujoco
from wrenchbook.service.client.joint.mujoco_joint import MujocoJoint

TABLE = linear_table()
PENDULUM = f"""
<mujoco><option timestep="0.001"/><worldbody><body name="carriage">
  <joint type="slide" axis="0 0 1" stiffness="2e4"/><geom size=".1" mass="20" {SILENT}/>
  <body name="tip" pos="1 0 0">{FREEDOMS}<geom size=".03" mass="1" {SILENT}/>
    <body><joint type="hinge" axis="0 1 0"/><geom size=".05" pos="0 0 -.3" mass="2" {SILENT}/></body>
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
    off = np.sqrt(((np.array(here) - there) ** 2).mean(axis=0) / (np.array(there) ** 2).mean(axis=0))
    assert (off < 0.01).all(), off
