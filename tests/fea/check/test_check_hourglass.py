"""Stacks of single hex20 cells of reduced integration: hourglass, told as itself."""

from dataclasses import replace

import numpy as np
import pytest

from tests.fea.boxes import box
from tests.fea.check.test_deck_comparison import TOML
from tests.fea.written_deck import deck_lines
from wrenchbook.fea.check import report as check
from wrenchbook.fea.inspection import stacked_singly


def arch(folder, across, integration):
    """Write a half circle of radius 0.3 m, 10 x 10 mm, of 40 cells along."""
    mesh = box("hex20", (across, across, 40), (0.01, 0.01, 1.0))
    x, y, z = mesh.points.T
    radius, angle = 0.3 + x, np.pi * (z - 0.5)
    points = np.column_stack([radius * np.cos(angle), y, radius * np.sin(angle)])
    lines = deck_lines(replace(mesh, points=points), 1e-3, integration)
    (folder / "block.inp").write_text("\n".join(lines) + "\n")
    text = TOML.replace("point = [0.01, 0.01, 0.06]\n", "").replace("rigid", "distributed")
    (folder / "component.toml").write_text(text)
    return check(folder)


def test_an_arch_of_single_reduced_cells_is_refused_as_an_hourglass(tmp_path):
    report = arch(tmp_path, 1, "reduced")
    (problem,) = report["problems"]
    assert problem["where"] == "analysis.integration"
    assert "40 hex20 cells" in problem["message"]
    assert "hourglass" in problem["message"]


@pytest.mark.parametrize(("across", "integration"), [(1, "full"), (2, "reduced")])
def test_full_integration_or_two_cells_across_make_it_ready_and_far_from_buckling(
    tmp_path, across, integration
):
    report = arch(tmp_path, across, integration)
    assert report["ok"]
    assert report["solver_error"]["buckling"] is None


@pytest.mark.parametrize(("cells", "count"), [((1, 1, 1), 0), ((1, 2, 5), 0), ((1, 1, 2), 2)])
def test_a_single_cell_and_a_layer_are_no_stack(cells, count):
    assert len(stacked_singly(box("hex20", cells, (0.01, 0.02, 0.05)))) == count
