"""Poses and the conventions of other programs."""

from __future__ import annotations

import math
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from wrenchbook.service.client import Displacement
from wrenchbook.service.client import conventions as conv
from wrenchbook.service.client.errors import InvalidArgument
from wrenchbook.service.client.rotation import rotation_matrix

WRENCH = np.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
vectors = st.lists(st.floats(-3, 3), min_size=3, max_size=3).map(np.array)


def answer(translation, rotation) -> Displacement:
    body = {"component": "plate", "translation": translation, "rotation": rotation}
    body["coverage"] = "covered"
    return Displacement.read(body, np.zeros(6))


@given(vectors)
def test_the_rotation_matrix_and_quaternion_are_scipys(rotation):
    expected = Rotation.from_rotvec(rotation)
    assert np.allclose(rotation_matrix(rotation), expected.as_matrix(), rtol=0, atol=1e-14)
    w, x, y, z = conv.quaternion_wxyz(rotation)
    signed = np.array([x, y, z, w])
    other = expected.as_quat()
    assert min(np.abs(signed - other).max(), np.abs(signed + other).max()) < 1e-14


@pytest.mark.parametrize("angle", [0.0, 1e-300, 1e-160, 1e-12, 1e-5])
def test_small_rotations_lose_no_digits(angle: float):
    matrix = rotation_matrix([0.0, 0.0, angle])
    assert matrix[1, 0] == math.sin(angle)
    assert matrix[0, 0] == pytest.approx(math.cos(angle), rel=1e-15)


def test_a_displacement_moves_the_undeformed_pose_in_its_own_frame():
    # The interface looks along world y; a push along its x moves it along world y.
    R0 = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    R, p = answer([1e-3, 0, 0], [0, 0, 0.1]).apply(R0, [10, 20, 30])
    assert np.allclose(p, [10, 20.001, 30], rtol=0, atol=1e-15)
    turn = [[math.cos(0.1), -math.sin(0.1), 0], [math.sin(0.1), math.cos(0.1), 0], [0, 0, 1]]
    assert np.allclose(R, R0 @ turn, rtol=0, atol=1e-15)


def test_the_pose_as_one_matrix_equals_apply_at_the_origin():
    moved = answer([1, 2, 3], [0.1, -0.2, 0.05])
    R, p = moved.apply(np.eye(3), np.zeros(3))
    assert np.array_equal(moved.matrix[:3, :3], R)
    assert moved.matrix[:3, 3].tolist() == p.tolist() == [1, 2, 3]
    assert moved.matrix[3].tolist() == [0, 0, 0, 1]


@pytest.mark.parametrize(
    ("R0", "words"),
    [
        (np.eye(4), r"R0 must have shape \(3, 3\)"),
        (2 * np.eye(3), "R0 must be a right-handed rotation"),
    ],
)
def test_a_pose_that_is_none_is_refused(R0, words):
    with pytest.raises(ValueError, match=words):
        answer([1, 2, 3], [0, 0, 0]).apply(R0, np.zeros(3))


@pytest.mark.parametrize("R0", [2 * np.eye(3), np.diag([1, 1, -1]), np.full((3, 3), np.nan)])
def test_a_pose_that_is_no_rotation_is_refused(R0):
    with pytest.raises(ValueError, match="R0"):
        answer([1, 2, 3], [0, 0, 0]).apply(R0, np.zeros(3))


def test_ros_messages_are_read_as_mapping_object_or_stamped():
    mapping = conv.to_ros(WRENCH)
    assert mapping["force"] == {"x": 1.0, "y": 2.0, "z": 3.0}
    assert mapping["torque"] == {"x": 4.0, "y": 5.0, "z": 6.0}
    parts = {name: SimpleNamespace(**part) for name, part in mapping.items()}
    message = SimpleNamespace(**parts)
    for form in (mapping, message, SimpleNamespace(wrench=message), {"wrench": mapping}):
        assert conv.from_ros(form).tolist() == WRENCH.tolist()
    with pytest.raises(ValueError, match="no 'torque'"):
        conv.from_ros({"force": mapping["force"]})
    with pytest.raises(ValueError, match=r"no 'force\.y'"):
        conv.from_ros({"force": {"x": 1.0}})
    with pytest.raises(ValueError, match=r"force\.x must be a float, like 1.5, not 'one'"):
        conv.from_ros({"force": {"x": "one"}})


def test_drake_puts_torque_first():
    assert conv.from_drake([4, 5, 6, 1, 2, 3]).tolist() == WRENCH.tolist()
    assert conv.to_drake(WRENCH).tolist() == [4, 5, 6, 1, 2, 3]
    spatial = SimpleNamespace(
        rotational=lambda: np.array([[4.0], [5], [6]]),
        translational=lambda: np.array([[1.0], [2], [3]]),
    )
    assert conv.from_drake(spatial).tolist() == WRENCH.tolist()
    assert conv.from_drake(spatial, component="child").tolist() == WRENCH.tolist()
    assert conv.from_drake(spatial, component="parent").tolist() == (-WRENCH).tolist()


# What MuJoCo 4.0.0 and PyBullet 3.2.7 (joint frame) read for a 2 kg arm welded on a fixed stand,
# gravity 10 m/s^2 along -z, centre of mass at (0.1, 0, 0.05) m from the joint.
ARM_FORCE, ARM_TORQUE = [0.0, 0.0, 20.0], [0.0, -2.0, 0.0]
# Its weight as the stand feels it: 20 N down, and r x F = (0.1, 0, 0.05) x (0, 0, -20).
WEIGHT_ON_STAND = [0.0, 0.0, -20.0, 0.0, 2.0, 0.0]


def test_a_weight_on_the_component_gives_negative_fz_from_mujoco_and_pybullet():
    assert conv.from_mujoco(ARM_FORCE, ARM_TORQUE, "parent").tolist() == WEIGHT_ON_STAND
    assert conv.from_pybullet([*ARM_FORCE, *ARM_TORQUE], "parent").tolist() == WEIGHT_ON_STAND


def test_the_reaction_at_the_child_is_the_reading_itself():
    assert conv.from_mujoco(ARM_FORCE, ARM_TORQUE, "child").tolist() == ARM_FORCE + ARM_TORQUE
    assert conv.from_pybullet(ARM_FORCE + ARM_TORQUE, "child").tolist() == ARM_FORCE + ARM_TORQUE


def test_pybullets_default_mode_is_about_the_childs_centre_of_mass():
    # Read in the default mode: the same force, no moment.
    on_stand = conv.from_pybullet([0, 0, 20, 0, 0, 0], "parent")
    assert conv.moved(on_stand, point=[0.1, 0, 0.05]).tolist() == WEIGHT_ON_STAND


@pytest.mark.parametrize("side", ["parent", "child"])
def test_sensor_readings_convert_there_and_back(side):
    assert conv.from_mujoco(*conv.to_mujoco(WRENCH, side), side).tolist() == WRENCH.tolist()
    assert conv.from_pybullet(conv.to_pybullet(WRENCH, side), side).tolist() == WRENCH.tolist()


def test_an_unnamed_side_is_refused():
    with pytest.raises(ValueError, match="'parent' or 'child'"):
        conv.from_mujoco(ARM_FORCE, ARM_TORQUE, "stand")  # type: ignore[arg-type]


def test_a_wrench_moves_to_another_frame_and_point():
    quarter = rotation_matrix([0, 0, math.pi / 2])
    moved = conv.moved([1, 0, 0, 0, 0, 2], rotation=quarter, point=[0.5, 0, 0])
    assert np.allclose(moved, [0, 1, 0, 0, 0, 2.5], rtol=0, atol=1e-15)
    with pytest.raises(ValueError, match="right-handed"):
        conv.moved(WRENCH, rotation=np.ones((3, 3)))


@pytest.mark.parametrize("point", [[0.5, np.nan, 0], [0.5, 0], 0.5])
def test_a_point_that_is_none_is_refused(point):
    with pytest.raises(ValueError, match="point must"):
        conv.moved(WRENCH, point=point)


def test_power_does_not_depend_on_where_a_wrench_is_expressed():
    # A twist of the same body at both points: v_q = v_p + w x (q - p).
    rng = np.random.default_rng(0)
    wrench, twist, point = rng.normal(size=6), rng.normal(size=6), rng.normal(size=3)
    axes = rotation_matrix(rng.normal(size=3))
    there = conv.moved(wrench, rotation=axes, point=point)
    spin = axes @ twist[3:]
    velocity = axes @ twist[:3] - np.cross(spin, point)
    assert there @ np.concatenate([velocity, spin]) == pytest.approx(wrench @ twist, rel=1e-12)


@pytest.mark.parametrize("rotation", [[1, 2], [[0, 0, 0.1]], [np.nan, 0, 0]])
def test_a_quaternion_of_no_rotation_vector_is_refused(rotation):
    with pytest.raises(InvalidArgument, match="rotation"):
        conv.quaternion_wxyz(rotation)


def test_quaternions_come_in_both_orders():
    half = math.sqrt(0.5)
    assert np.allclose(conv.quaternion_wxyz([0, 0, math.pi / 2]), [half, 0, 0, half])
    assert np.allclose(conv.quaternion_xyzw([math.pi / 2, 0, 0]), [half, 0, 0, half])


SERVER_STACK = (
    "fastapi",
    "starlette",
    "pydantic",
    "uvicorn",
    "orjson",
    "scipy",
    "skfem",
    "meshio",
    "h5py",
    "typer",
    "rich",
    "pint",
    "sqlite3",
    "wrenchbook.fea",
    "wrenchbook.surrogate.build",
)
SHARED = tuple(f"wrenchbook.service.{name}" for name in ("client", "contract", "messages"))


IMPORTS = {
    "the client loads nothing of the server": (
        "import sys, wrenchbook.service.client, wrenchbook.service.client.conventions\n"
        f"print([name for name in {SERVER_STACK!r} if name in sys.modules])\n"
        "print(sorted(name for name in sys.modules if name.startswith('wrenchbook.service.')\n"
        f"             and not name.startswith({SHARED!r})))"
    ),
    "table files leave pint for its first use": (
        "import sys, wrenchbook.service.formats; print([x for x in ['pint'] if x in sys.modules])"
    ),
    "a server leaves the signals and statistics of scipy for their first use": (
        "import sys, wrenchbook.service.http.app\n"
        "print([name for name in ('scipy.signal', 'scipy.stats') if name in sys.modules])"
    ),
    "a packed table loads numpy and the standard library alone": (
        "import sys, wrenchbook.surrogate.kernel.binding, wrenchbook.surrogate.kernel.format\n"
        "roots = {name.partition('.')[0] for name in sys.modules}\n"
        "print([name for name in ('scipy', 'h5py', 'threadpoolctl') if name in roots])\n"
    ),
}


@pytest.mark.parametrize("code", IMPORTS.values(), ids=IMPORTS)
def test_an_import_loads_no_more_than_it_needs(code):
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert set(run.stdout.split()) == {"[]"}
