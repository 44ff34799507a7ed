"""The mount in MuJoCo: the wrench is the closed form's, the pose is written, traps are named."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.service.client.answers import LinearTable, bar_compliance
from tests.service.client.scenes import GRAVITY, SENSORS, made, mujoco, pendulum_wrench
from wrenchbook.service.client.mount import CouplingDiverged, MountWarning, SensorError
from wrenchbook.service.client.mount.mujoco_mount import MujocoMount

RIGID = np.zeros((6, 6))
TURNED = "0.8 0.3 -0.4 0.33"


def mounted(scene, table=None, **options) -> MujocoMount:
    table = table or LinearTable(RIGID)
    return MujocoMount(*scene, source=table, component="plate", **options)


def frame(quat: str) -> np.ndarray:
    w, x, y, z = (float(part) for part in quat.split())
    return Rotation.from_quat([x, y, z, w]).as_matrix()


@pytest.mark.parametrize("integrator", ["Euler", "implicitfast", "RK4"])
@pytest.mark.parametrize("quat", ["1 0 0 0", TURNED])
def test_the_wrench_is_that_of_a_pendulum_in_closed_form(integrator, quat):
    model, data = made(quat=quat, option=f'integrator="{integrator}"')
    mount = mounted((model, data))
    data.qpos[0], data.qvel[0] = 1.0, 2.0
    for _ in range(500):
        # Sensors describe the state before the step.
        expected = pendulum_wrench(data.qpos[0], data.qvel[0], frame(quat))
        mujoco.mj_step(model, data)
        mount.step()
        off = np.abs(mount.wrench - expected).reshape(2, 3).max(axis=1)
        assert (off < 1e-9 * np.abs(expected).reshape(2, 3).max(axis=1)).all()
    assert abs(data.qpos[0] - 1.0) > 0.1


def test_the_reading_describes_the_time_before_the_step():
    model, data = made()
    mount = mounted((model, data))
    data.qpos[0] = 1.0
    for _ in range(3):
        mujoco.mj_step(model, data)
        mount.step()
        assert mount.read_at == pytest.approx(data.time - 0.001)
    late = mount.wrench
    mujoco.mj_forward(model, data)
    now = pendulum_wrench(data.qpos[0], data.qvel[0], np.eye(3))
    assert np.abs(late - now).max() > 1e-3


def test_an_interface_apart_from_the_mocap_bodys_frame_is_moved_rigidly_with_it():
    R0, p0 = frame("0.5 0.5 -0.5 0.5"), np.array([0.1, 0.2, 1.0])
    scene = made(quat=TURNED)
    mount = mounted(scene, LinearTable(), R0=R0, p0=p0)
    model, data = scene
    before = frame(TURNED), np.array([0.4, -0.2, 1.5])
    for _ in range(3):
        mujoco.mj_step(model, data)
        mount.step()
    R, p = mount.mount.pose
    turn = R @ R0.T
    assert np.allclose(data.mocap_pos[0], p + turn @ (before[1] - p0), rtol=0, atol=1e-14)
    w, x, y, z = data.mocap_quat[0]
    result = Rotation.from_quat([x, y, z, w]).as_matrix()
    assert np.allclose(result, turn @ before[0], rtol=0, atol=1e-14)
    assert np.abs(mount.mount.displacement).max() > 1e-6


def test_a_base_that_is_placed_elsewhere_takes_the_scene_along():
    model, data = made()
    mounted((model, data)).place(frame(TURNED), [1.0, 2.0, 3.0])
    np.testing.assert_allclose(data.mocap_pos[0], [1.0, 2.0, 3.0], rtol=1e-15)
    w, x, y, z = data.mocap_quat[0]
    result = Rotation.from_quat([x, y, z, w]).as_matrix()
    np.testing.assert_allclose(result, frame(TURNED), atol=1e-14)


def test_a_scene_at_rest_settles_where_the_closed_form_of_the_coupling_says():
    model, data = made(rod='gravcomp="0"')
    mount = mounted((model, data), LinearTable())
    settled = mount.settle(accuracy=1e-6)
    # At the settled pose the hanging rod's wrench, solved apart, gives the same displacement.
    u = settled.displacement
    turn, point = Rotation.from_rotvec(u[3:]).as_matrix(), np.array([0.02, -0.03, 0.1])
    mujoco.mj_forward(model, data)
    spin_up = data.qacc[0]
    axis = turn @ np.array([0.0, 1.0, 0.0])
    centre = turn @ np.array([0.0, 0.0, -0.3])
    rod = 2.0 * (GRAVITY - spin_up * np.cross(axis, centre))
    block = 0.5 * GRAVITY
    moment = np.cross(turn @ point + centre, rod) - 0.02 * spin_up * axis
    moment += np.cross(turn @ np.array([0.01, 0, 0.02]), block)
    expected = np.concatenate([rod + block, moment])
    assert np.allclose(settled.wrench, expected, rtol=0, atol=1e-9 * 25)
    assert np.allclose(bar_compliance() @ expected, u, rtol=0, atol=1e-11)
    assert data.time == 0.0


def test_settling_that_fails_leaves_the_scene_where_it_was():
    model, data = made()
    mount = mounted((model, data), LinearTable(), relaxation="off")
    before = data.mocap_pos[0].copy()
    with pytest.raises(CouplingDiverged, match="not settled after 1 answers"):
        mount.settle(most=1)
    assert np.array_equal(data.mocap_pos[0], before)


def test_five_milliseconds_are_five_steps():
    model, data = made()
    table = LinearTable(RIGID)
    mount = mounted((model, data), table, sync=0.005)
    synced = []
    for _ in range(1000):
        mujoco.mj_step(model, data)
        synced.append(mount.step())
    assert np.flatnonzero(synced).tolist() == list(range(4, 1000, 5))
    assert len(table.asked) == 200


def test_before_the_first_step_the_sensors_have_nothing_to_tell_and_nothing_is_asked():
    model, _ = made()
    data, table = mujoco.MjData(model), LinearTable(RIGID)  # never evaluated: its sensors read 0
    mount = mounted((model, data), table)
    assert not mount.step()
    mujoco.mj_step(model, data)
    assert mount.step()
    assert not mount.step()  # no step since
    assert len(table.asked) == 1
    assert table.asked[0][2] == pytest.approx(-2.5 * 9.81)


def test_a_reset_of_the_scene_begins_anew_at_the_undeformed_pose():
    model, data = made()
    mount = mounted((model, data), LinearTable())
    for _ in range(10):
        mujoco.mj_step(model, data)
        mount.step()
    mujoco.mj_resetData(model, data)
    for _ in range(2):
        mujoco.mj_step(model, data)
        mount.step()
    assert mount.mount.coverage.answers == 2


def test_a_scene_that_mujoco_has_reset_since_it_was_unstable_is_named(capfd, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # MuJoCo writes a log where it runs
    model, data = made()
    mount = mounted((model, data), LinearTable())
    for _ in range(5):
        mujoco.mj_step(model, data)
        mount.step()
    data.qvel[0] = np.nan
    mujoco.mj_step(model, data)
    with pytest.raises(SensorError, match="reset the unstable scene"):
        mount.step()


def test_a_reading_that_is_not_finite_moves_nothing():
    model, data = made(option="", extra="")
    mount = mounted((model, data), LinearTable())
    mujoco.mj_step(model, data)
    before = data.mocap_pos[0].copy()
    data.sensordata[1] = np.nan
    with pytest.raises(SensorError, match="must be finite"):
        mount.step()
    assert np.array_equal(data.mocap_pos[0], before)


def test_gravcomp_reads_the_full_weight_and_must_be_told():
    scene = made(rod='gravcomp="1"')
    with pytest.raises(SensorError, match=r"gravcomp is set on 'rod', .* full weight"):
        mounted(scene)
    felt, outside = (mounted(scene, gravcomp=what) for what in ("motors", "float"))
    for mount in (felt, outside):
        mujoco.mj_step(*scene)
        mount.step()
    assert felt.wrench[2] == pytest.approx(-2.5 * 9.81)
    block = np.cross([0.01, 0, 0.02], 0.5 * GRAVITY)
    expected = np.concatenate([0.5 * GRAVITY, block])
    assert np.allclose(outside.wrench, expected, rtol=0, atol=1e-12)
    with pytest.raises(ValueError, match="RK4"):
        mounted(made(rod='gravcomp="1"', option='integrator="RK4"'), gravcomp="float")


def test_what_pushes_by_xfrc_applied_is_felt():
    model, data = made()
    mount = mounted((model, data))
    data.xfrc_applied[model.body("mounted").id, :3] = [3.0, 0.0, 0.0]
    mujoco.mj_step(model, data)
    mount.step()
    assert mount.wrench[0] == pytest.approx(3.0)


def test_a_site_on_the_mocap_body_itself_feels_all_that_hangs_on_it():
    on_base = SENSORS.replace('"mount"', '"root"')
    beside = '<site name="root"/><body name="second"><geom size="0.1" mass="3"/></body>'
    scene = made(base=beside, sensors=on_base)
    mount = mounted(scene)
    mujoco.mj_step(*scene)
    mount.step()
    assert mount.wrench[2] == pytest.approx(-5.5 * 9.81)


def test_the_check_at_rest_changes_nothing_of_the_scene():
    model, data = made()
    data.qpos[0], data.qvel[0] = 1.0, 2.0
    flags, before = model.opt.disableflags, (data.qpos.copy(), data.qvel.copy(), data.qacc.copy())
    mounted((model, data))
    assert model.opt.disableflags == flags
    after = (data.qpos, data.qvel, data.qacc)
    assert all(np.array_equal(a, b) for a, b in zip(before, after, strict=True))


def test_without_mujoco_it_is_said_how_to_install_it():
    code = (
        "import sys, wrenchbook; wrenchbook.Mount\n"
        "assert 'mujoco' not in sys.modules\n"
        "sys.modules['mujoco'] = None\n"
        "try:\n    wrenchbook.MujocoMount\n"
        "except ImportError as error:\n    print(error)\n"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "pip install 'wrenchbook[mujoco]'" in run.stdout


LOOSE = '<body name="loose" pos="0 0 3"><freejoint/><geom size="0.1"/><site name="free"/></body>'
WELD = '<equality><weld body1="base" body2="loose"/></equality>'
REFUSED = {  # pieces of the scene, options of the mount, and words of the error
    "a base with a free joint": (
        {"worldbody": LOOSE, "sensors": SENSORS.replace('"mount"', '"free"')}, {},
        r"has a free joint, so .* its sensors read 0; attach the"),
    "a scene welded to the mocap body": (
        {"worldbody": LOOSE, "extra": WELD}, {}, "the equality constraint '#0' holds the scene"),
    "a body beside the mounted one": (
        {"base": '<body name="second"><geom size="0.1"/></body>'}, {},
        "mocap body 'base' also carries 'second', which the sensors on 'mounted' do not feel"),
    "sensors at a joint": (
        {"sensors": SENSORS.replace('"mount"', '"tip"')}, {},
        "'rod', where the sensors are, must be a child of"),
    "no sensors": ({"sensors": ""}, {}, "no sensor 'mount_force'; it has none"),
    "two sites": (
        {"sensors": SENSORS.replace('torque" site="mount"', 'torque" site="tip"')}, {},
        "at different sites"),
    "a cutoff": (
        {"sensors": SENSORS.replace('site="mount"', 'site="mount" cutoff="10"')}, {},
        "has cutoff, so its reading is not the present wrench"),
    "no such body": (
        {}, {"mocap": "bse"}, "no body 'bse'; it has 'world', 'base', 'mounted', 'rod'"),
    "a body without a name": (
        {}, {"mocap": None}, "no body None; it has 'world', 'base', 'mounted', 'rod'"),
    "not a mocap body": ({}, {"mocap": "rod"}, "body 'rod' is not a mocap body"),
    "no such sensor": (
        {}, {"force": "f"}, "no sensor 'f'; it has 'mount_force', 'mount_torque'"),
    "another kind of sensor": (
        {}, {"force": "mount_torque"}, "sensor 'mount_torque' must be a force sensor"),
}  # fmt: skip


@pytest.mark.parametrize(("pieces", "options", "words"), REFUSED.values(), ids=REFUSED)
def test_a_scene_whose_sensors_do_not_read_the_whole_wrench_is_refused(pieces, options, words):
    with pytest.raises(SensorError, match=words):
        mounted(made(**pieces), **options)


def test_sensors_that_are_switched_off_and_a_sync_below_a_step_are_refused():
    model, data = made()
    with pytest.raises(ValueError, match="must be at least the step"):
        mounted((model, data), sync=1e-4)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_SENSOR
    with pytest.raises(SensorError, match="the scene disables its sensors"):
        mounted((model, data))


@pytest.mark.parametrize(
    ("pieces", "words"),
    [
        (
            {"extra": '<actuator><general name="jet" site="tip" gear="1 0 0 0 0 0"/></actuator>'},
            "leaves these out .* actuator 'jet' at a site",
        ),
        ({"option": 'density="1.2" viscosity="2e-5"'}, "drag"),
    ],
)
def test_what_mujocos_sensors_leave_out_is_warned_of(pieces, words):
    with pytest.warns(MountWarning, match=words):
        mounted(made(**pieces))
