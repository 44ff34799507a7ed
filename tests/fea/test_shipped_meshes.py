"""The mesh files of `link` and `hot_bracket`, and what their solves are known to be."""

from __future__ import annotations

import numpy as np
import pytest

from tests.fea.shipped_meshes import COMPONENTS, hot_bracket, link
from wrenchbook.fea.bundle.read import read_bundle
from wrenchbook.fea.solve import Solver


@pytest.mark.parametrize(("name", "text"), [("link", link()), ("hot_bracket", hot_bracket())])
def test_a_shipped_mesh_file_is_what_its_generator_writes(name, text):
    assert (COMPONENTS / name / f"{name}.inp").read_text() == text


def test_the_link_bends_less_than_a_tube_without_flanges_and_more_than_with_rigid_ones():
    """Euler's beam with the shear of a thin tube, over its whole length and between flanges."""
    found = Solver(read_bundle(COMPONENTS / "link")).linear.compliance
    inertia, area = np.pi / 4 * (0.0125**4 - 0.011**4), np.pi * (0.0125**2 - 0.011**2)

    def deflection(near: float, far: float) -> float:
        bent = ((0.35 - near) ** 3 - (0.35 - far) ** 3) / 3 / (70e9 * inertia)
        return bent + (far - near) * 2 / (70e9 / 2.66 * area)

    assert deflection(0.006, 0.344) < found[8, 8] < deflection(0, 0.35)
    assert not found[:6].any()


def test_the_hot_bracket_bends_down_when_heated_as_timoshenkos_strip():
    """Aluminium above, steel below, each 3 mm: the arm's curvature, 5 %."""
    found = Solver(read_bundle(COMPONENTS / "hot_bracket")).linear.compliance[:, 6]
    ratio, thickness = 210 / 70, 0.006
    curvature = 24 * (23.5e-6 - 12e-6) / thickness / (14 + ratio + 1 / ratio)
    turned = curvature * (0.1 - 0.006)
    assert found[4] == pytest.approx(turned, rel=5e-2)
    assert found[2] < 0
