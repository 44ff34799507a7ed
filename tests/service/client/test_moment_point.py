"""A moment is about the interface point where it is now: a column bends as a beam-column does.

A load that compresses a column bends it further by push times deflection. The solver has that
share already, so a moment about the undeformed point would count it twice.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.column import LENGTH, MESH, TIP, column_table, deflection, slope
from tests.service.client.scenes import SENSORS, mujoco
from wrenchbook.service.client import conventions
from wrenchbook.service.client.errors import InvalidArgument
from wrenchbook.service.client.mount import Mount
from wrenchbook.service.client.mount.mujoco_mount import MujocoMount

FORCE = 5.0  # N, across the column
PUSHES = [-100.0, 50.0, 100.0, 150.0, 200.0]  # N, along it; below zero is tension
WITH_LEVER = PUSHES[:-1]  # by 200 N on a lever it bends by 28 mm: not a small deflection
UPRIGHT = Rotation.from_rotvec([0.2, -1.1, 0.4]).as_matrix()
OFFSET = np.array([0.04, -0.03, 0.06])  # m, of a sensor from the interface point
ASKEW = Rotation.from_rotvec([0.7, 0.5, -0.9]).as_matrix()  # of its axes
MASS = 20.0  # kg


@pytest.fixture(scope="module")
def column():
    return column_table()


def assert_bends(displacement, push, moment=0.0):
    """Compare with the beam-column, to the error of the mesh."""
    assert displacement[2] == pytest.approx(deflection(push, FORCE, moment), rel=MESH)
    assert -displacement[4] == pytest.approx(slope(push, FORCE, moment), rel=MESH)
    assert np.abs(displacement[[1, 3, 5]]).max() < 1e-6


def sensor_on_the_tip(R, p, force):
    """What a sensor on the moving side reads, child from parent, of a force at the tip."""
    at, axes = p + R @ OFFSET, R @ ASKEW
    return axes.T @ -force, axes.T @ np.cross(p - at, -force), at, axes


@pytest.mark.parametrize("push", PUSHES)
@pytest.mark.parametrize("relaxation", ["aitken", "newton"])
def test_a_column_under_a_dead_load_settles_at_the_beam_column(column, push, relaxation):
    mount = Mount(column, "column", UPRIGHT, TIP, relaxation=relaxation)
    force = UPRIGHT @ [-push, 0.0, FORCE]
    mount.settle(lambda R, p: mount.wrench_of(force, np.zeros(3), p))
    assert_bends(mount.displacement, push)


@pytest.mark.parametrize("push", PUSHES)
def test_a_turned_sensor_beside_the_interface_tells_the_same(column, push):
    mount = Mount(column, "column", UPRIGHT, TIP)
    force = UPRIGHT @ [-push, 0.0, FORCE]

    def scene(R, p):
        read, moment, at, axes = sensor_on_the_tip(R, p, force)
        on_component = conventions.from_mujoco(read, moment, "parent")
        turned = conventions.moved(on_component, rotation=axes)
        return mount.wrench_of(turned[:3], turned[3:], at)

    mount.settle(scene)
    assert_bends(mount.displacement, push)


@pytest.mark.parametrize("push", PUSHES)
def test_the_conventions_by_hand_tell_the_same(column, push):
    mount = Mount(column, "column", UPRIGHT, TIP)
    force = UPRIGHT @ [-push, 0.0, FORCE]

    def scene(R, p):
        read, moment, at, axes = sensor_on_the_tip(R, p, force)
        on_component = conventions.from_mujoco(read, moment, "parent")
        point = UPRIGHT.T @ (at - p)
        return conventions.moved(on_component, rotation=UPRIGHT.T @ axes, point=point)

    mount.settle(scene)
    assert_bends(mount.displacement, push)


@pytest.mark.parametrize("push", PUSHES)
def test_a_load_cell_on_the_ground_tells_the_same(column, push):
    mount = Mount(column, "column", UPRIGHT, TIP)
    force = UPRIGHT @ [-push, 0.0, FORCE]
    mount.settle(lambda R, p: mount.wrench_of(force, np.cross(p - TIP, force), TIP))
    assert_bends(mount.displacement, push)


@pytest.mark.parametrize("push", PUSHES)
def test_a_column_in_a_stepped_loop_comes_to_the_beam_column(column, push):
    mount = Mount(column, "column", UPRIGHT, TIP)
    force, (R, p) = UPRIGHT @ [-push, 0.0, FORCE], mount.pose
    for _ in range(30):
        read, moment, at, axes = sensor_on_the_tip(R, p, force)
        R, p = mount.step(mount.wrench_of(axes @ -read, axes @ -moment, at))
    assert_bends(mount.displacement, push)


@pytest.mark.parametrize("push", WITH_LEVER)
def test_a_load_beside_the_tip_bends_the_column_by_its_lever_alone(column, push):
    mount, beside = Mount(column, "column", np.eye(3), TIP), 0.01
    force = np.array([-push, 0.0, FORCE])
    mount.settle(lambda R, p: mount.wrench_of(force, np.zeros(3), p + R @ [0.0, 0.0, beside]))
    turned = -mount.displacement[4]
    lever = beside * (push * np.cos(turned) - FORCE * np.sin(turned))
    assert_bends(mount.displacement, push, lever)


def column_scene(push: float, offset: str = "0 0 0", quat: str = "1 0 0 0"):
    """A mass on the column, which gravity pushes along -x and pulls along z."""
    model = mujoco.MjModel.from_xml_string(f"""
<mujoco><option gravity="{-push / MASS} 0 {FORCE / MASS}" timestep="0.001"/><worldbody>
  <body name="base" mocap="true" pos="{LENGTH} 0 0" quat="{quat}"><body name="mounted">
    <site name="mount" pos="{offset}" quat="0.8 0.3 -0.4 0.33"/>
    <geom type="sphere" size=".05" mass="{MASS}" contype="0" conaffinity="0"/></body></body>
</worldbody>{SENSORS}</mujoco>""")
    return model, mujoco.MjData(model)


@pytest.mark.parametrize("offset", ["0 0 0", "0.04 -0.03 0.06"])
@pytest.mark.parametrize("push", PUSHES)
def test_a_mass_on_the_column_settles_at_the_beam_column_in_mujoco(column, push, offset):
    scene = column_scene(push, offset)
    mount = MujocoMount(*scene, source=column, component="column")
    mount.settle()
    assert_bends(mount.mount.displacement, push)


@pytest.mark.parametrize("push", PUSHES)
def test_a_mass_on_the_column_comes_to_the_beam_column_in_mujocos_steps(column, push):
    model, data = column_scene(push, "0.04 -0.03 0.06")
    mount = MujocoMount(model, data, source=column, component="column")
    for _ in range(50):
        mujoco.mj_step(model, data)
        mount.step()
    assert_bends(mount.mount.displacement, push)


@pytest.mark.parametrize("push", WITH_LEVER)
def test_the_mocap_body_may_stand_apart_from_the_interface(column, push):
    quat = Rotation.from_matrix(ASKEW).as_quat(scalar_first=True)
    scene = column_scene(push, "0.04 -0.03 0.06", " ".join(map(str, quat)))
    low = TIP - [0.0, 0.0, 0.01]  # the mass is 10 mm above the interface point
    mount = MujocoMount(*scene, source=column, component="column", R0=np.eye(3), p0=low)
    mount.settle()
    turned = -mount.mount.displacement[4]
    lever = 0.01 * (push * np.cos(turned) - FORCE * np.sin(turned))
    assert_bends(mount.mount.displacement, push, lever)


def test_a_reading_belongs_to_the_pose_in_which_mujoco_took_it(column):
    model, data = column_scene(100.0, "0.04 -0.03 0.06")
    mount = MujocoMount(model, data, source=column, component="column")
    mujoco.mj_step(model, data)
    data.mocap_pos[0] += [0.0, 0.0, 0.2]  # after the sensors were read
    mount.step()
    np.testing.assert_allclose(mount.wrench, [-100, 0, FORCE, 0, 0, 0], rtol=0, atol=1e-9)


def test_a_mirrored_sensor_frame_is_refused():
    with pytest.raises(InvalidArgument, match="right-handed rotation matrix"):
        conventions.moved(np.ones(6), rotation=np.diag([1.0, 1.0, -1.0]))
