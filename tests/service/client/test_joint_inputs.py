"""The joint of a part whose displacement depends on its temperature too."""

from __future__ import annotations

import numpy as np
import pytest

from tests.service.client.answers import bar_compliance
from tests.service.client.joint_scenes import HIGH, linear_table, packed_table, scene, sphere
from wrenchbook.service.client.errors import InvalidArgument
from wrenchbook.service.client.joint import Joint, LinearPart
from wrenchbook.service.client.joint.mujoco_joint import MujocoJoint
from wrenchbook.surrogate.table.rows import LoadRange, Rows
from wrenchbook.surrogate.table.space import Input, space_of

C = bar_compliance()
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
    found = WARM.answer(wrench[:3], wrench[3:], inputs={"temperature": temperature})
    return np.concatenate([found.translation, found.rotation])


@pytest.mark.parametrize("temperature", [20.0, 70.0, 120.0])
def test_the_wrench_is_that_of_the_temperature(temperature):
    wrench = np.array([400.0, -80.0, 120.0, 5.0, -10.0, 8.0])
    moved = answer(wrench, temperature)
    found, stiffness = Joint(WARM, inputs={"temperature": temperature}).state(moved[:3], moved[3:])
    np.testing.assert_allclose(found, wrench, atol=1e-9 * np.abs(wrench).max())
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
    with pytest.warns(UserWarning, match="beyond the load range"):
        wrench, _ = joint.state(moved[:3], moved[3:])
    assert wrench[2] == pytest.approx(1.5 * HIGH[2], rel=1e-3)


def test_springs_are_those_of_the_temperature():
    part = LinearPart.of(WARM, inputs={"temperature": 120.0})
    np.testing.assert_allclose(np.linalg.inv(part.stiffness), 1.1 * C, atol=1e-3 * C[4, 4])
    np.testing.assert_allclose(part.unloaded, answer(np.zeros(6), 120.0), atol=1e-12)


@pytest.mark.parametrize(
    ("inputs", "words"),
    [
        (None, "temperature: missing; give its value in degC"),
        ({"heat": 30.0}, "no such input; there is temperature"),
        ({"temperature": 200.0}, "temperature is from 20 to 120 degC, not 200"),
    ],
)
def test_a_joint_without_its_inputs_is_refused(inputs, words):
    with pytest.raises(InvalidArgument, match=words):
        Joint(WARM, inputs=inputs)


@pytest.mark.parametrize("make", [Joint, LinearPart.of])
def test_what_is_no_table_is_refused(make):
    with pytest.raises(InvalidArgument, match="takes a Table"):
        make(None)


@pytest.mark.parametrize(
    ("options", "text"), [({"damping": "0.1"}, "damping"), ({"method": "x"}, "unknown method")]
)
def test_an_option_of_another_kind_is_refused(options: dict, text: str):
    with pytest.raises(InvalidArgument, match=text):
        Joint(linear_table(bar_compliance()), **options)
