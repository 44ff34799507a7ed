"""Rows that are almost one, found without measuring all distances."""

from typing import Any

import numpy as np
import pytest
from scipy.spatial import KDTree

from wrenchbook.surrogate.table import merging
from wrenchbook.surrogate.table.merging import NEAR, close_groups, merge
from wrenchbook.surrogate.table.rows import LoadRange, Rows, unknown_column


@pytest.mark.parametrize("dimensions", [1, 3, 7])
def test_groups_are_those_that_all_distances_give(dimensions):
    rng = np.random.default_rng(dimensions)
    points = rng.uniform(-1, 1, (1500, dimensions))
    steps = rng.choice([0.0, 0.4, 0.99, 1.01, 3.0], (500, dimensions)) * NEAR
    points[1000:] = points[:500] + steps * rng.choice([-1, 1], (500, dimensions))
    groups = close_groups(points)
    for first, second in KDTree(points).query_pairs(0.995 * NEAR, p=np.inf):
        assert groups[first] == groups[second]
    for one in np.unique(groups):
        members = points[groups == one]
        if len(members) == 2:
            assert np.abs(members[0] - members[1]).max() <= 1.0001 * NEAR
    assert 1000 < len(np.unique(groups)) < 1500


def test_merging_rows_without_tangents_makes_none_up():
    wrenches = np.zeros((5, 6))
    wrenches[:, 0] = [0.0, 1.0, 1.0, 2.0, 3.0]
    rows = Rows.of(wrenches, 1e-6 * (wrenches + np.arange(5)[:, None]))
    merged = merge(rows, LoadRange(-5 * np.ones(6), 5 * np.ones(6)))
    assert merged.members == ((1,), (2, 3), (4,), (5,))
    assert np.isnan(merged.rows.compliance).all()
    assert merged.rows.uncertainty[1] == pytest.approx(0.5e-6)
    assert np.isnan(merged.rows.uncertainty[[0, 2, 3]]).all()


@pytest.mark.parametrize("known", [[1], [0, 1]])
def test_merged_rows_have_the_mean_of_the_third_derivatives_they_bring(known):
    wrenches = np.zeros((4, 6))
    wrenches[:, 0] = [1.0, 1.0, 2.0, 3.0]
    thirds = np.full((4, 56), np.nan)
    thirds[known] = np.arange(len(known))[:, None] + np.arange(56.0)
    rows = Rows.of(wrenches, 1e-6 * wrenches, curvature=thirds)
    merged = merge(rows, LoadRange(-5 * np.ones(6), 5 * np.ones(6))).rows
    assert merged.curvature[0].tolist() == rows.curvature[known].mean(axis=0).tolist()
    assert np.isnan(merged.curvature[1:]).all()


def test_a_column_nobody_knows_takes_no_memory_however_rows_are_picked_and_joined():
    rows = Rows.of(np.eye(6), np.eye(6))
    both = rows.take([0, 2, 4]) + rows.take(np.arange(6) > 3)
    assert both.compliance.strides == (0, 0, 0)
    assert (both.compliance.shape, both.uncertainty.shape) == ((5, 6, 6), (5, 6))
    known = Rows.of(np.eye(6), np.eye(6), compliance=np.ones((6, 6, 6)))
    joined = rows + known
    assert np.isnan(joined.compliance[:6]).all()
    assert (joined.compliance[6:] == known.compliance).all()
    assert np.isnan(unknown_column(3, 6)).all()


def test_readings_of_a_held_load_are_one_row_in_memory_that_does_not_grow_by_their_square(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(merging, "MAX_PAIRS", 1000)
    rng = np.random.default_rng(4)
    held = np.repeat(rng.uniform(-1, 1, (3, 6)), 400, axis=0)
    points = held + rng.uniform(-1e-7, 1e-7, held.shape)
    asked: list[int] = []

    class Counting(merging.KDTree):
        def query_pairs(self, *args: Any, **options: Any) -> np.ndarray:
            pairs = super().query_pairs(*args, **options)
            asked.append(len(pairs))
            return pairs

    monkeypatch.setattr(merging, "KDTree", Counting)
    assert merging.close_groups(points).tolist() == [0] * 400 + [1] * 400 + [2] * 400
    assert max(asked) <= 1000
