"""What a joint says of its table and its scene before its numbers can be wrong."""

from __future__ import annotations

import copy
import warnings

import numpy as np
import pytest

from tests.service.client.answers import bar_compliance
from tests.service.client.joint_scenes import (
    FREEDOMS,
    HIGH,
    SILENT,
    linear_table,
    mujoco,
    packed_table,
    scene,
    sphere,
)
from tests.service.client.test_joint_scenes import turning_table
from wrenchbook.service.client.errors import InvalidArgument
from wrenchbook.service.client.joint import Joint, JointError, JointWarning, LinearPart
from wrenchbook.service.client.joint.joint import quaternion
from wrenchbook.service.client.joint.mujoco_joint import MujocoJoint, step_joints
from wrenchbook.surrogate.kernel.replies import Status
from wrenchbook.surrogate.table.rows import LoadRange, Rows
from wrenchbook.surrogate.table.space import Input, space_of

C = bar_compliance()
SPAN = LoadRange(-HIGH, HIGH)


def stiffening(wrenches: np.ndarray) -> Rows:
    """Rows with tangents of a bar whose side force meets more stiffness the further it bends."""
    moved, slopes = wrenches @ C.T, np.tile(C, (len(wrenches), 1, 1))
    share = wrenches[:, 2] / HIGH[2]
    moved[:, 2] -= 0.1 * C[2, 2] * HIGH[2] * share**3
    slopes[:, 2, 2] -= 0.3 * C[2, 2] * share**2
    return Rows.of(wrenches, moved, compliance=slopes, source=["fea"] * len(wrenches))


def with_one_negative(place: int) -> np.ndarray:
    """A compliance that is not positive definite in one freedom."""
    matrix = np.diag(np.abs(np.diag(C)))
    matrix[place, place] *= -1
    return matrix


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            lambda model, data: setattr(model.opt, "timestep", np.inf),
            "is inf s; set model.opt.timestep to a finite number",
        ),
        (lambda model, data: data.qpos.fill(0.0), "the quaternion of the pose is zero"),
        (
            lambda model, data: setattr(model.opt, "integrator", 1),
            "RK4 evaluates forces four times",
        ),
    ],
)
def test_a_step_of_a_scene_that_has_none_is_refused_by_name(change, words):
    model, data = scene(sphere(3, "0.02 0 0.03"))
    joint = MujocoJoint(model, data, linear_table())
    change(model, data)
    with pytest.raises((JointError, InvalidArgument), match=words):
        joint.step()


def test_a_table_without_rows_is_refused_by_name():
    table = packed_table(Rows.of(np.empty((0, 6)), np.empty((0, 6))), SPAN)
    with pytest.raises(InvalidArgument, match=r"bar has no stiffness.*solve more rows"):
        Joint(table)


def test_measured_rows_without_a_stiffness_are_corrected_first():
    table = packed_table(Rows.of(np.empty((0, 6)), np.empty((0, 6))), SPAN)
    table.packed.meta["provenance"]["sources"] = {"measured": 9}
    with pytest.raises(InvalidArgument, match=r"\(wrenchbook withdraw bar\), measure more"):
        LinearPart.of(table)


def test_a_table_with_rows_beyond_its_range_alone_is_refused_by_name():
    table = packed_table(stiffening(3.0 * np.diag(HIGH)), SPAN)
    with pytest.raises(InvalidArgument, match=r"bar has no stiffness, because no row"):
        Joint(table)


def test_a_wrench_that_a_thin_table_does_not_cover_is_warned_of_once():
    model, data = scene(sphere(5))
    wrenches = np.random.default_rng(1).uniform(-0.1, 0.1, (2, 6)) * HIGH
    joint = MujocoJoint(model, data, packed_table(stiffening(wrenches), SPAN))
    with pytest.warns(
        JointWarning, match=r"bar at tip 'tip': the wrench of a step is thin.*more rows"
    ):
        joint.step()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        joint.step()


def test_coverage_is_that_of_the_method_of_the_joint():
    wrenches = np.random.default_rng(2).uniform(-1, 1, (40, 6)) * HIGH
    table = packed_table(stiffening(wrenches), SPAN)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", JointWarning)
        joint = Joint(table, method="linear")
    assert (table.packed.answer([0.0] * 6).coverage, joint.coverage) == ("covered", "thin")


def test_a_compliance_that_is_not_positive_definite_is_warned_of_with_its_direction():
    table = linear_table(with_one_negative(2))
    with pytest.warns(JointWarning, match=r"at the wrench.*along \(\+1 F_z,.*solve more rows"):
        Joint(table)


def test_a_step_where_the_part_moves_against_a_load_is_refused_by_direction_and_remedy():
    model, data = scene(sphere(5))
    with pytest.warns(JointWarning):
        joint = MujocoJoint(model, data, linear_table(with_one_negative(4)))
    with pytest.raises(JointError, match=r"along \(\+1 M_y,.*solve more rows"):
        joint.step()


def test_a_freedom_of_no_compliance_is_no_indefinite_one():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        Joint(linear_table(np.diag([*np.diag(C)[:5], 0.0])))


def test_a_step_of_a_freedom_of_no_compliance_is_refused_by_name():
    joint = Joint(linear_table(np.diag([*np.diag(C)[:5], 0.0])))
    with pytest.raises(JointError, match=r"bar: the compliance has no inverse.*lock the"):
        joint.state([0.0, 0.0, 1e-3], np.zeros(3))


def mocap_scene():
    """A mass on the bar, whose base is a mocap body."""
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><option gravity="0 0 0"/><worldbody><body name="base" mocap="true">'
        f'<body name="tip" pos="1 0 0">{FREEDOMS}{sphere(5)}</body></body></worldbody></mujoco>'
    )
    data = mujoco.MjData(model)
    return data, MujocoJoint(model, data, linear_table())


def test_a_mocap_base_that_moves_is_warned_of_once_by_name():
    data, joint = mocap_scene()
    joint.step()
    data.mocap_pos[0, 2] += 1e-3
    with pytest.warns(
        JointWarning, match="base 'base' follows the mocap body 'base'.*does not feel"
    ):
        joint.step()
    data.mocap_pos[0, 2] += 1e-3
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        joint.step()


def test_a_mocap_base_that_is_placed_before_the_first_step_is_not_warned_of():
    data, joint = mocap_scene()
    data.mocap_pos[0, 2] = 1.0
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        joint.step()
        joint.step()


def two_joints():
    """Two masses on two bars in one scene."""
    bodies = "".join(
        f'<body name="base{k}" pos="0 {k} 1"><geom size=".02" mass="50" {SILENT}/>'
        f'<body name="tip{k}" pos="1 0 0">{FREEDOMS}{sphere(1)}</body></body>'
        for k in range(2)
    )
    model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{bodies}</worldbody></mujoco>")
    data, table = mujoco.MjData(model), linear_table()
    return data, [MujocoJoint(model, data, table, f"base{k}", f"tip{k}") for k in range(2)]


def test_a_step_of_one_of_two_joints_is_refused_and_names_the_right_call():
    data, joints = two_joints()
    with pytest.raises(JointError, match=r"'tip0' and 'tip1'.*step_joints\(a, b\)"):
        joints[0].step()
    assert data.time == 0.0
    step_joints(*joints)
    assert data.time > 0.0


def test_joints_of_a_scene_are_copied_together_and_one_alone_is_not_stepped():
    data, joints = two_joints()
    step_joints(*joints)
    with pytest.raises(JointError, match=r"without the joint at 'tip1'; copy all"):
        copy.deepcopy(joints[0]).step()
    both = copy.deepcopy(joints)
    step_joints(*both)
    step_joints(*joints)
    np.testing.assert_array_equal(both[0]._data.qpos, data.qpos)


def test_each_of_two_joints_warns_by_the_name_of_its_tip_at_the_line_of_the_step():
    data, joints = two_joints()
    data.qpos[[0, 7]] = 1.2 * C[0, 0] * HIGH[0]  # along the bars
    with warnings.catch_warnings(record=True) as issued:
        warnings.simplefilter("default")
        step_joints(*joints)
    assert [str(item.message).split(":")[0] for item in issued] == [
        "bar at tip 'tip0'",
        "bar at tip 'tip1'",
    ]
    assert {item.filename for item in issued} == {__file__}


def test_a_joint_steps_by_itself_once_the_other_is_gone():
    data, joints = two_joints()
    joints.pop()
    joints[0].step()
    assert data.time > 0.0


# -- a part that depends on its temperature -------------------------------------------------------


GROWTH = np.array([1.2e-5, 0.0, 3e-6, 0.0, 1e-6, 0.0])  # m/K and rad/K
SOFTER = 1e-3  # 1/K
SPACE = space_of(scalars=[Input("temperature", "degC", "scalar", zero=20.0)])


def warm_table():
    """A bar that grows, and bends 0.1 % more a kelvin, from 20 to 120 degrees Celsius."""
    rng, low = np.random.default_rng(3), np.append(-HIGH, 20.0)
    high = np.append(HIGH, 120.0)
    inputs = np.vstack([rng.uniform(low, high, (40, 7)), np.append(np.zeros(6), 20.0)])
    warmth = inputs[:, 6] - 20.0
    moved = (1 + SOFTER * warmth)[:, None] * (inputs[:, :6] @ C.T) + np.outer(warmth, GROWTH)
    slopes = np.zeros((len(inputs), 6, 7))
    slopes[:, :, :6] = (1 + SOFTER * warmth)[:, None, None] * C
    slopes[:, :, 6] = SOFTER * inputs[:, :6] @ C.T + GROWTH
    rows = Rows.of(inputs, moved, compliance=slopes, source=["fea"] * len(inputs), space=SPACE)
    return packed_table(rows, LoadRange(low, high, SPACE))


WARM = warm_table()


def answer(wrench, temperature):
    result = WARM.answer(wrench[:3], wrench[3:], inputs={"temperature": temperature})
    return np.concatenate([result.translation, result.rotation])


@pytest.mark.parametrize("temperature", [20.0, 70.0, 120.0])
def test_the_wrench_is_that_of_the_temperature(temperature):
    wrench = np.array([400.0, -80.0, 120.0, 5.0, -10.0, 8.0])
    moved = answer(wrench, temperature)
    result, stiffness = Joint(WARM, inputs={"temperature": temperature}).state(moved[:3], moved[3:])
    np.testing.assert_allclose(result, wrench, atol=1e-9 * np.abs(wrench).max())
    softer = 1 + SOFTER * (temperature - 20.0)
    assert stiffness[0, 0] == pytest.approx(1 / C[0, 0] / softer, rel=1e-3)


def test_a_part_that_gets_warm_moves_its_tip():
    model, data = scene(sphere(5), option='integrator="implicitfast"', gravity="0 0 0")
    joint = MujocoJoint(model, data, WARM, damping=0.5, inputs={"temperature": 20.0})
    for count in range(4000):
        joint.inputs = {"temperature": 20.0 + min(count / 20, 100.0)}
        joint.step()
    np.testing.assert_allclose(data.qpos[:3], answer(np.zeros(6), 120.0)[:3], atol=1e-7)
    assert joint.inputs == {"temperature": 120.0}


def test_beyond_the_load_range_the_temperature_stays():
    joint = Joint(WARM, inputs={"temperature": 70.0})
    edge = np.array([0.0, 0.0, HIGH[2], 0.0, 0.0, 0.0])
    moved = answer(edge, 70.0) + 1.05 * 0.5 * C @ edge
    with pytest.warns(UserWarning, match="outside the load range"):
        wrench, _ = joint.state(moved[:3], moved[3:])
    assert wrench[2] == pytest.approx(1.5 * HIGH[2], rel=1e-3)


def test_a_damping_below_zero_is_refused_later_too():
    joint = Joint(linear_table())
    with pytest.raises(InvalidArgument, match="0 or more"):
        joint.damping = -0.1
    assert joint.damping == 0.02


def test_a_temperature_that_is_written_into_the_inputs_is_refused():
    joint = Joint(WARM, inputs={"temperature": 20.0})
    with pytest.raises(TypeError):
        joint.inputs["temperature"] = 80.0  # type: ignore[index]
    joint.inputs = {**joint.inputs, "temperature": 80.0}
    assert joint.inputs == {"temperature": 80.0}


def test_springs_are_those_of_the_temperature():
    part = LinearPart.of(WARM, inputs={"temperature": 120.0})
    np.testing.assert_allclose(np.linalg.inv(part.stiffness), 1.1 * C, atol=1e-3 * C[4, 4])
    np.testing.assert_allclose(part.unloaded, answer(np.zeros(6), 120.0), atol=1e-12)


@pytest.mark.parametrize(
    ("inputs", "words"),
    [
        (None, "temperature: missing; give its value in degC"),
        ({"heat": 30.0}, "no such input; use temperature"),
        ({"temperature": 200.0}, "temperature must be 20 to 120 degC, not 200"),
        ({"temperature": "80"}, "temperature must be 20 to 120 degC, not 80"),
    ],
)
def test_a_joint_without_its_inputs_is_refused(inputs, words):
    with pytest.raises(InvalidArgument, match=words):
        Joint(WARM, inputs=inputs)


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda: Joint(None), "needs a Table"),
        (lambda: LinearPart.of(None), "needs a Table"),
        (lambda: LinearPart.of(linear_table(), [0.0] * 5), "wrench must have shape"),
        (
            lambda: LinearPart.of(linear_table(), [1e9, 0, 0, 0, 0, 0]),
            "fx of wrench must be within the load range",
        ),
        (lambda: Joint(linear_table(), inputs=80.0), "inputs must map names"),
        (lambda: Joint(linear_table(), interface="end"), "has no name; leave interface"),
        (
            lambda: MujocoJoint(None, None, linear_table()),
            "not builtins.NoneType and builtins.NoneType; with dm_control, pass physics.model.ptr",
        ),
        (lambda: Joint(linear_table(), damping="0.1"), "damping"),
        (lambda: Joint(linear_table(), method="x"), "unknown method"),
    ],
)
def test_an_argument_of_another_kind_is_refused(make, text: str):
    with pytest.raises(InvalidArgument, match=text):
        make()


def test_a_joint_keeps_the_version_of_its_table_after_a_refresh():
    table, moved = linear_table(), ([0.0, 0.0, 1e-3], [0.0] * 3)
    joint = Joint(table)
    table._now = linear_table(2.0 * bar_compliance()).packed, ""
    np.testing.assert_array_equal(joint.state(*moved)[0], Joint(linear_table()).state(*moved)[0])


@pytest.mark.parametrize("threads", [1, 3])
def test_many_joints_in_one_call_have_the_bits_of_each_alone(threads):
    table, rng = turning_table(), np.random.default_rng(5)
    many = table.packed.joints(40)
    single = [table.packed.joints(1) for _ in range(40)]
    for _ in range(3):
        moved = rng.uniform(-0.8, 0.8, (40, 6)) * [0.02, 0.02, 0.02, 0.2, 0.2, 0.2]
        many.poses[:, :3], many.poses[:, 3:] = moved[:, :3], [quaternion(r) for r in moved[:, 3:]]
        many.velocities[:] = rng.normal(size=(40, 6))
        many.inverse_masses[:] = np.diag([1, 1, 1, 9, 9, 9])
        many.step(1e-3, 0.05, threads)
        for k, one in enumerate(single):
            one.poses[0], one.velocities[0] = many.poses[k], many.velocities[k]
            one.inverse_masses[0] = many.inverse_masses[k]
            one.step(1e-3, 0.05)
            assert one.replies.tobytes() == many.replies[k : k + 1].tobytes()
    assert (many.replies["status"] == 0).all()


@pytest.mark.parametrize(
    ("dt", "damping", "array", "place"),
    [
        (0.0, 0.02, None, None),
        (-1e-3, 0.02, None, None),
        (np.nan, 0.02, None, None),
        (np.inf, 0.02, None, None),
        (1e-3, -1.0, None, None),
        (1e-3, np.nan, None, None),
        (1e-3, 0.02, "inverse_masses", (0, 0, 1)),
        (1e-3, 0.02, "velocities", (0, 0)),
    ],
)
def test_the_kernel_has_no_wrench_of_a_step_that_it_refuses(dt, damping, array, place):
    steps = linear_table().packed.joints(1)
    steps.poses[0, 2] = 1e-3
    steps.inverse_masses[0] = np.eye(6)
    if array is not None:
        getattr(steps, array)[place] = np.nan
    steps.step(dt, damping)
    (reply,) = steps.replies
    assert reply["status"] == Status.NOT_FINITE
    assert all(np.isnan(reply[name]).all() for name in ("wrench", "force", "rate"))
    assert np.isfinite(reply["still"]).all()
