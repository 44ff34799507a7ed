"""The joint's examples in C++: Gazebo's plugin runs on stubs of its headers, ROS's compiles."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.service.client.answers import bar_compliance
from tests.service.client.joint_scenes import HIGH, linear_table
from tests.service.fmu.made import need_compiler
from tests.service.fmu.test_library import SCENES, compiled
from wrenchbook.service.client.joint import Joints
from wrenchbook.surrogate.kernel import build as kernel_build

HERE = Path(__file__).parent
MAIN = """
#include "engine_stubs.hpp"
#include <cstdio>
#include <cstdlib>
static char **words;
static double number() { return std::strtod(*words++, nullptr); }
static gz::math::Vector3d vector() { double x = number(), y = number(); return {x, y, number()}; }
template <> std::string sdf::Element::Get(const std::string &key) const {
    return key == "table" ? "bar.wbt" : key;
}
template <> gz::math::Pose3d sdf::Element::Get(const std::string &) const { return {{1}, {}}; }
#include "gz_joint.cpp"
int main(int, char **given) {
    words = given + 1;
    for (auto *link = gz::sim::LINKS + 1; link < gz::sim::LINKS + 3; link++) {
        link->pose.p = vector(), link->pose.q.w = number(), link->pose.q.u = vector();
        link->linear = vector(), link->angular = vector(), link->centre = vector();
        link->inertia = vector(), link->mass = number();
    }
    gz::sim::EntityComponentManager ecm;
    gz::sim::EventManager events;
    wrenchbook::GzJoint plugin;
    plugin.Configure(0, std::make_shared<const sdf::Element>(), ecm, events);
    plugin.PreUpdate({std::chrono::milliseconds(1)}, ecm);
    for (auto *link = gz::sim::LINKS + 1; link < gz::sim::LINKS + 3; link++)
        for (auto &v : {link->force, link->torque})
            std::printf("%.17g %.17g %.17g ", v[0], v[1], v[2]);
}
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """Stubs of the headers that the examples include, the table, and the kernel's objects."""
    place, compiler = tmp_path_factory.mktemp("examples"), need_compiler()
    if shutil.which("g++") is None:
        pytest.skip("no g++")
    for name in ("gz_joint.cpp", "ros2_joint.cpp"):
        for header in re.findall(r"#include <(\w+/.*)>", (SCENES / name).read_text()):
            (place / header).parent.mkdir(parents=True, exist_ok=True)
            (place / header).write_text('#include "engine_stubs.hpp"')
    linear_table().save(place / "bar.wbt")
    flags = [flag for flag in kernel_build.FLAGS if flag != "-DWB_SHARED"]
    compiled([*compiler, *flags, "-c", *kernel_build.FOLDER.glob("*.c")], cwd=place)
    return place


def gxx(folder: Path, *words: object) -> None:
    places = (f"-I{place}" for place in (SCENES, kernel_build.FOLDER, folder, HERE))
    compiled(["g++", "-std=c++17", "-Wall", "-Wextra", "-Werror", *places, *words], cwd=folder)


@pytest.mark.slow
def test_the_node_of_ros_compiles(folder):
    gxx(folder, "-c", SCENES / "ros2_joint.cpp")


@pytest.mark.slow
def test_the_plugin_of_gazebo_pulls_on_two_free_links_as_joints_do(folder):
    (folder / "main.cpp").write_text(MAIN)
    gxx(folder, "-o", "main", "main.cpp", *folder.glob("*.o"), "-lm", "-lpthread")
    rng, undeformed = np.random.default_rng(3), np.array([1.0, 0, 0])
    base_turn, base_at = Rotation.from_rotvec([0.4, -0.9, 0.3]), np.array([0.3, 0.2, 1.0])
    displacement = bar_compliance() @ (HIGH * [0.1, 0.3, -0.2, 0.4, -0.3, 0.2])
    moved, bend = displacement[:3], Rotation.from_rotvec(displacement[3:])
    tip_at, tip_turn = base_at + base_turn.apply(undeformed + moved), base_turn * bend
    linear, angular, offset = rng.normal(size=(3, 2, 3))
    masses, inertias = np.array([4.0, 2.0]), rng.uniform(0.01, 0.05, (2, 3))
    places = zip((base_at, tip_at), (base_turn, tip_turn), strict=True)
    words, motion, inverse = [], np.zeros(6), np.zeros((6, 6))
    for k, (at, turn) in enumerate(places):
        centre, arm = at + 0.1 * offset[k], tip_at - at
        quaternion = turn.as_quat(scalar_first=True)
        parts = at, quaternion, linear[k], angular[k], centre, inertias[k], [masses[k]]
        words += np.concatenate(parts).tolist()
        motion += (-1, 1)[k] * np.concatenate([linear[k] + np.cross(angular[k], arm), angular[k]])
        to_point, lever = np.eye(6), tip_at - centre
        to_point[:3, 3:] = np.cross(np.eye(3), lever).T  # v + w x lever
        inverse += to_point @ np.diag([*[1 / masses[k]] * 3, *1 / inertias[k]]) @ to_point.T
    turned = np.kron(np.eye(2), base_turn.as_matrix())
    pose = np.concatenate([moved, bend.as_quat(scalar_first=True)])
    wrench = Joints(linear_table(), 1).step(
        pose[None], (turned.T @ motion)[None], turned.T @ inverse @ turned, 1e-3
    )[0]
    in_world = turned @ wrench
    run = subprocess.run(
        ["./main", *map(repr, words)], cwd=folder, capture_output=True, text=True, check=True
    )
    on_base, on_tip = np.array(run.stdout.split(), dtype=float).reshape(2, 6)
    np.testing.assert_allclose(on_tip, -in_world, rtol=1e-8)
    lever = np.cross(tip_at - base_at, in_world[:3])
    np.testing.assert_allclose(on_base, in_world + np.append(np.zeros(3), lever), rtol=1e-8)
