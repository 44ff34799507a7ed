"""Scenes that get the joints of a part."""

from __future__ import annotations

import json

import numpy as np
import pytest
import typer

from tests import shipped_checks
from tests.service.client.joint_scenes import linear_table, mujoco
from wrenchbook.fea.bundle.read import read_bundle
from wrenchbook.fea.bundle.shipped import SHIPPED
from wrenchbook.service.cli.joint import _tip_interface
from wrenchbook.service.client.joint import JointError
from wrenchbook.service.client.joint.mujoco_joint import MujocoJoint
from wrenchbook.service.client.joint.mujoco_model import scene_with_joint

SCENE = """
<mujoco><default><joint damping="3" armature="1" ref="0.2"/></default>
<option timestep="0.001"/><worldbody>
<body name="base" pos="0 0 1"><freejoint/><geom size=".1" mass="3"/>
<body name="tip" pos="1 0 0" {turned}><site name="flange" pos=".1 0 0" quat=".6 .2 .7 .3"/>
<geom size=".05" mass="1" pos=".2 0 0"/>{inside}</body></body></worldbody></mujoco>
"""
BEAM = np.diag([1.0, 1.114, 1.114, 1e-3, 0.0286, 0.0286])
BEAM[1, 5] = BEAM[5, 1] = -0.157
BEAM[2, 4] = BEAM[4, 2] = 0.157


@pytest.fixture
def path(tmp_path):
    file = tmp_path / "scene.xml"
    file.write_text(SCENE.format(turned="", inside=""))
    return file


def compiled(text):
    model = mujoco.MjModel.from_xml_string(text)
    return model, mujoco.MjData(model)


@pytest.mark.parametrize("site", [None, "flange"])
def test_a_made_scene_has_a_joint(path, site):
    model, data = compiled(scene_with_joint(path, "base", "tip", site=site))
    joint = MujocoJoint(model, data, linear_table())
    joint.step()
    assert joint.coverage == "covered"


def test_the_slides_are_the_axes_of_the_site(path):
    model, data = compiled(scene_with_joint(path, "base", "tip", site="flange"))
    joint = MujocoJoint(model, data, linear_table())
    frame = np.zeros(9)
    mujoco.mju_quat2Mat(frame, model.site("flange").quat)
    np.testing.assert_allclose(joint.spin_axes, frame.reshape(3, 3), atol=1e-5)
    np.testing.assert_allclose(model.jnt_pos[1:], [[0.1, 0, 0]] * 4, atol=1e-6)


def test_the_parts_mass_is_a_body_of_the_tip(path):
    model, _ = compiled(scene_with_joint(path, "base", "tip", mass=BEAM))
    part = model.body("tip_part")
    assert part.mass[0] == pytest.approx(np.trace(BEAM[:3, :3]) / 3)
    np.testing.assert_allclose(part.ipos, [-0.157 / part.mass[0], 0, 0], atol=1e-6)
    # About the interface point: that of the matrix.
    bending = part.inertia[1] + part.mass[0] * part.ipos[0] ** 2
    assert bending == pytest.approx(0.0286, rel=1e-5)


def test_locked_freedoms_get_no_joint(path):
    text = scene_with_joint(path, "base", "tip", locked=["ux", "uy", "rx", "ry"])
    model, _ = compiled(text)
    assert [model.joint(k).name for k in range(1, model.njnt)] == ["tip_uz", "tip_rz"]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"tip": "hand"}, "no body 'hand'; name one of"),
        ({"base": "tip", "tip": "base"}, "a child of body 'tip', but it is a child of 'world'"),
        ({"site": "gripper"}, "no site 'gripper'; name one of: 'flange'"),
        ({"locked": ["rx"]}, "locks a single rotation, rx, for which MuJoCo"),
        ({"mass": np.full((6, 6), np.nan)}, "6 x 6 matrix of finite numbers"),
    ],
)
def test_a_scene_that_cannot_have_the_joint_is_refused_by_name(path, options, words):
    with pytest.raises(JointError, match=words):
        scene_with_joint(path, **({"base": "base", "tip": "tip"} | options))


def test_a_tip_with_joints_is_refused(path):
    path.write_text(SCENE.format(turned="", inside='<joint type="hinge"/>'))
    with pytest.raises(JointError, match="has joints"):
        scene_with_joint(path, "base", "tip")


def test_a_file_that_is_no_scene_is_refused_with_the_reason(tmp_path):
    (tmp_path / "a.xml").write_text("<nonsense/>")
    with pytest.raises(JointError, match="MuJoCo cannot compile"):
        scene_with_joint(tmp_path / "a.xml", "base", "tip")


@pytest.mark.parametrize(
    "folder", sorted(SHIPPED.glob("*/component.toml")), ids=lambda p: p.parent.name
)
def test_a_shipped_components_check_is_of_its_setup(folder):
    stored = json.loads((folder.parent / "check.json").read_text())
    assert stored["fingerprint"] == read_bundle(folder.parent).fingerprint


def test_the_shipped_bars_mass_and_frequency_are_those_of_its_check():
    stored = json.loads((SHIPPED / "bar" / "check.json").read_text())["vibration"]
    result = shipped_checks.shipped_check(SHIPPED / "bar")["vibration"]
    for name in ("mass", "first_frequency"):
        assert stored[name] == pytest.approx(result[name], rel=1e-6)
    np.testing.assert_allclose(stored["condensed_mass"], result["condensed_mass"], atol=1e-6)


def test_the_mass_of_a_link_is_that_of_the_end_that_moves():
    facts = json.loads((SHIPPED / "link" / "check.json").read_text())
    facts["interfaces"] = {"left": {"held": True}, "right": {"held": False}}
    mass = np.array(_tip_interface("link", facts)[1])
    assert mass.shape == (6, 6)
    assert (np.linalg.eigvalsh(mass) > 0).all()
    assert mass[0, 0] < facts["vibration"]["mass"]


def test_each_of_several_interfaces_has_its_own_mass_and_must_be_named():
    matrix = np.diag(np.arange(12.0)).tolist()
    facts = {"interfaces": {"left": {}, "right": {}}, "vibration": {"condensed_mass": matrix}}
    assert np.diag(_tip_interface("beam", facts, "left")[1]).tolist() == [
        0.0,
        1.0,
        2.0,
        3.0,
        4.0,
        5.0,
    ]
    with pytest.raises(typer.BadParameter, match="beam moves at left, right"):
        _tip_interface("beam", facts)
    with pytest.raises(typer.BadParameter, match="has no interface 'top' that moves; it moves at"):
        _tip_interface("beam", facts, "top")


def test_an_interface_of_a_part_with_a_single_one_is_refused():
    with pytest.raises(typer.BadParameter, match="leave --interface"):
        _tip_interface("bar", {}, "end")


def test_a_keyframe_has_the_new_freedoms_at_their_place(path):
    arm = '<body><joint type="hinge"/><geom size=".01"/></body>'
    key = '</worldbody><keyframe><key qpos="0 0 1 1 0 0 0 .7" qvel="1 2 3 4 5 6 7"/></keyframe>'
    path.write_text(SCENE.format(turned="", inside=arm).replace("</worldbody>", key))
    model, _ = compiled(scene_with_joint(path, "base", "tip"))
    assert model.key_qpos[0, 7:].tolist() == [0, 0, 0, 1, 0, 0, 0, 0.7]
    assert model.key_qvel[0].tolist() == [1, 2, 3, 4, 5, 6, 0, 0, 0, 0, 0, 0, 7]


def test_mujoco_reads_the_written_inertia_of_a_flat_part(path):
    for first, second in np.random.default_rng(0).uniform(1e-4, 1e-2, (20, 2)):
        mass = np.diag([1.0, 1.0, 1.0, first, second, first + second])
        compiled(scene_with_joint(path, "base", "tip", mass=mass))
