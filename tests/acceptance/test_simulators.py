"""The scripts of data/scenes: right wrenches from each simulator, and each runs as it stands."""

from __future__ import annotations

import importlib.util
import runpy
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import wrenchbook
from tests.service.client.answers import LinearTable, bar_compliance
from tests.service.client.scenes import pendulum_wrench
from tests.service.live import add_rows, as_rows, served

SCENES = Path(__file__).parents[2] / "data" / "scenes"
TURNED = Rotation.from_rotvec([0.3, -0.2, 0.5]).as_matrix()
POINT = np.array([0.1, 0.2, 1.0])
pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")


def script(name: str) -> ModuleType:
    """A script of the scenes, as a module."""
    spec = importlib.util.spec_from_file_location(name, SCENES / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def rigid() -> wrenchbook.Mount:
    return wrenchbook.Mount(LinearTable(np.zeros((6, 6))), "plate", TURNED, POINT)


def test_pybullet_reads_the_wrench_of_the_closed_form_of_the_state_before_the_step():
    pytest.importorskip("pybullet", reason="has no wheel here")
    module = script("pybullet_pendulum")
    on, engine = module.scene(rigid(), angle=0.5)
    for _ in range(200):
        before = module.pybullet.getJointState(on._robot, 1, physicsClientId=engine)[:2]
        module.pybullet.stepSimulation(physicsClientId=engine)
        expected = pendulum_wrench(*before, TURNED)
        assert np.abs(on.step() - expected).max() < 1e-9 * np.abs(expected).max()
    assert abs(before[1]) > 0.1
    module.pybullet.disconnect(physicsClientId=engine)


def test_drake_reads_the_wrench_of_the_closed_form():
    pytest.importorskip("pydrake", reason="has no wheel here")
    module = script("drake_pendulum")
    on, plant, context = module.scene(rigid(), angle=0.5)
    simulator = module.drake.Simulator(plant, context)
    for sync in range(1, 20):
        simulator.AdvanceTo(0.01 * sync)
        angle, speed = plant.GetPositions(context)[0], plant.GetVelocities(context)[0]
        expected = pendulum_wrench(angle, speed, TURNED)
        assert np.abs(on.step() - expected).max() < 1e-9 * np.abs(expected).max()
    assert abs(speed) > 0.1


@pytest.fixture(scope="module")
def url(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """A server with the bar's exact table."""
    with served(tmp_path_factory.mktemp("workspace")) as client:
        wrench = np.full((1, 6), 1.0)
        rows = as_rows(wrench, wrench @ bar_compliance().T, bar_compliance()[None])
        add_rows(client, "bar", rows)
        yield client.url


@pytest.mark.parametrize(
    ("name", "package", "seconds"),
    [
        ("mujoco_arm", "mujoco", 2.0),
        ("pybullet_pendulum", "pybullet", 0.2),
        ("drake_pendulum", "pydrake", 0.2),
    ],
)
def test_a_script_runs_as_it_stands(name, package, seconds, url: str, capsys) -> None:
    pytest.importorskip(package, reason="has no wheel here")
    script(name).main(url, seconds)
    reported = capsys.readouterr().out
    assert "0 thin, 0 outside, 0 unknown" in reported
    assert " 0 answers" not in reported


@pytest.mark.parametrize(
    ("name", "package", "seconds"),
    [
        ("mujoco_arm", "mujoco", "2"),
        ("mujoco_joint", "mujoco", "0.02"),
        ("pybullet_pendulum", "pybullet", "0.02"),
    ],
)
def test_a_script_without_options_asks_the_server_of_the_environment(
    name, package, seconds, url: str, monkeypatch
) -> None:
    pytest.importorskip(package, reason="has no wheel here")
    monkeypatch.setenv("WRENCHBOOK_SERVER", url)
    monkeypatch.setattr(sys, "argv", [name, "--seconds", seconds])
    runpy.run_path(str(SCENES / f"{name}.py"), run_name="__main__")


@pytest.fixture(scope="module")
def solving(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """A server with a solver and empty tables."""
    with served(tmp_path_factory.mktemp("solving"), solvers=1) as client:
        yield client.url


# Gravity on the tool bends the link by some millimetres. The bracket's arm curls under 100 K by
# 1.2 mm, and sags by its load on top.
@pytest.mark.parametrize(
    ("name", "smallest", "largest"),
    [("mujoco_link", 5e-4, 7e-3), ("mujoco_hot_bracket", 1e-3, 3e-3)],
)
def test_a_script_moves_a_shipped_part_as_far_as_it_bends(
    name, smallest, largest, solving: str, capsys
) -> None:
    pytest.importorskip("mujoco", reason="has no wheel here")
    assert smallest < script(name).main(solving, 0.5) < largest
    assert "largest translation: " in capsys.readouterr().out


def test_the_joints_script_runs_as_it_stands(solving: str, capsys) -> None:
    pytest.importorskip("mujoco", reason="has no wheel here")
    low, high = script("mujoco_joint").main(solving, 0.5)
    # 3 kg and the bar's own share, 41 N, hang on it from the first step on: twice that at most,
    # and as much as the carriage shakes them.
    assert -2.6 * 41.0 < low < -41.0 < high < 0.6 * 41.0
    assert "coverage: covered" in capsys.readouterr().out
