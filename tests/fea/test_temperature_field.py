"""Temperatures that differ from place to place: fields against closed forms, and bad files."""

import numpy as np
import pytest

from tests.fea.boxes import box
from tests.fea.test_temperature import table
from wrenchbook.fea.bundle.read import bundle_of
from wrenchbook.fea.component import build
from wrenchbook.fea.mesh.io.temperature_field import shape_on
from wrenchbook.fea.solve import Solver

REFERENCE, HOTTEST = 20.0, 120.0
SIZE = np.array([0.02, 0.02, 0.4])
EXPANSION = 23e-6
STEEL = {
    "region": "all",
    "youngs_modulus": 210e9,
    "poisson_ratio": 0.0,
    "thermal_expansion": EXPANSION,
}


def write(folder, points, rise):
    lines = [f"{x},{y},{z},{REFERENCE + one}" for (x, y, z), one in zip(points, rise, strict=True)]
    (folder / "hot.csv").write_text("x,y,z,T\n" + "\n".join(lines) + "\n")


def bar(folder, *, nonlinear=False, cells=(1, 2, 8)):
    inputs = {"temperature": {"range": [0, HOTTEST], "reference": REFERENCE, "field": "hot.csv"}}
    whole = table({"fixed": ["z0"]}, STEEL, nonlinear=nonlinear, inputs=inputs)
    whole["interface"]["coupling"] = "distributed"
    return Solver(build(bundle_of(whole, folder), box("hex20", cells, tuple(SIZE))))


def corners():
    return np.array(np.meshgrid(*zip([0.0] * 3, SIZE, strict=True))).reshape(3, -1).T


def warmed(solver, temperature=HOTTEST):
    return solver.solve({"": np.zeros(6), "temperature": temperature}).displacement


@pytest.mark.parametrize("nonlinear", [False, True])
def test_a_bar_that_is_warmer_towards_its_end_grows_by_the_mean_rise(tmp_path, nonlinear):
    points = corners()
    write(tmp_path, points, 100.0 * points[:, 2] / SIZE[2])
    moved = warmed(bar(tmp_path, nonlinear=nonlinear))
    assert moved[2] == pytest.approx(EXPANSION * 50.0 * SIZE[2], rel=3e-3 if nonlinear else 1e-3)


def test_a_bar_that_is_warmer_on_one_side_bends_to_an_arc(tmp_path):
    points = corners()
    write(tmp_path, points, 100.0 * points[:, 1] / SIZE[1])
    moved = warmed(bar(tmp_path))
    curvature = EXPANSION * 100.0 / SIZE[1]
    assert abs(moved[1]) == pytest.approx(curvature * SIZE[2] ** 2 / 2, rel=2e-3)
    assert abs(moved[3]) == pytest.approx(curvature * SIZE[2], rel=2e-3)


def test_the_input_is_the_temperature_of_the_hottest_point(tmp_path):
    points = corners()
    write(tmp_path, points, 7.0 * points[:, 2] / SIZE[2])
    other = tmp_path / "other"
    other.mkdir()
    write(other, points, 100.0 * points[:, 2] / SIZE[2])
    assert warmed(bar(tmp_path)) == pytest.approx(warmed(bar(other)), rel=1e-12, abs=1e-18)


def test_a_field_that_is_the_same_everywhere_answers_as_none(tmp_path):
    write(tmp_path, corners(), np.full(8, 100.0))
    field = warmed(bar(tmp_path, nonlinear=True))
    whole = table({"fixed": ["z0"]}, STEEL, nonlinear=True)
    whole["interface"]["coupling"] = "distributed"
    mesh = box("hex20", (1, 2, 8), tuple(SIZE))
    uniform = warmed(Solver(build(bundle_of(whole, tmp_path), mesh)))
    np.testing.assert_allclose(field, uniform, rtol=1e-9, atol=1e-15)


def test_another_field_is_another_fingerprint(tmp_path):
    found = []
    for rise in (10.0, 11.0):
        write(tmp_path, corners(), np.arange(8.0) * rise)
        found.append(bar(tmp_path).component.bundle.fingerprint)
    assert found[0] != found[1]


@pytest.mark.parametrize("kept", [[0, 1, 2], [0, 2], [0]], ids=["space", "plane", "line"])
def test_points_of_a_plane_or_a_line_are_interpolated_in_it(tmp_path, kept):
    rng = np.random.default_rng(1)
    points, slope = np.zeros((60, 3)), np.array([1.0, 0.7, -0.4])
    points[:, kept] = rng.uniform(-1, 1, (60, len(kept)))
    corners = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
    points[:8, kept] = corners[:, kept]
    nodes = rng.uniform(-0.9, 0.9, (40, 3))
    rise = 100 * (2 + points[:, kept] @ slope[kept])
    text = "\n".join(f"{x!r},{y!r},{z!r},{t!r}" for x, y, z, t in np.c_[points, rise].tolist())
    (tmp_path / "t.csv").write_text("x,y,z,T\n" + text + "\n")
    found = shape_on(nodes, tmp_path / "t.csv", 0.0) * rise.max()
    np.testing.assert_allclose(found, 100 * (2 + nodes[:, kept] @ slope[kept]), rtol=1e-9)
