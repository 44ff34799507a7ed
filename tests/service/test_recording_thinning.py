"""Farthest-point thinning: what is kept lies apart, what is not lies near, and all are counted."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial import KDTree

from wrenchbook.service.ledger import packed
from wrenchbook.service.recording import thinning
from wrenchbook.service.recording.thinning import Subset, farthest_first, scaled_loads, spaced, take

ONE = np.ones(6)


def points_of(count, seed=1):
    return np.random.default_rng(seed).uniform(-1, 1, (count, 6))


def taken(blocks):
    """Take blocks in turn; return the net and what became of the wrenches in all."""
    subset, merged, thinned = Subset(limit=50), 0, 0
    for block in blocks:
        step = take(subset, scaled_loads(block, ONE), packed(block))
        assert len(step.subset.keys) == len(subset.keys) + len(step.added) - len(step.dropped)
        subset, merged, thinned = step.subset, merged + step.merged, thinned + step.thinned
    return subset, merged, thinned


@pytest.fixture
def small(monkeypatch):
    monkeypatch.setattr(thinning, "CHUNK", 16)


def test_wrenches_within_a_millionth_of_the_range_are_one(small):
    block = np.zeros((3, 6))
    block[1, 2], block[2, 2] = 0.9e-6, 1.1e-6
    subset, merged, thinned = taken([block])
    assert (len(subset.keys), merged, thinned) == (2, 1, 0)
    assert subset.keys == packed(block[[0, 2]])


def test_below_the_bound_every_wrench_is_kept_in_its_order(small):
    block = points_of(50)
    subset, merged, thinned = taken([block[:20], block[20:]])
    assert (subset.keys, merged, thinned) == (packed(block), 0, 0)


@pytest.mark.parametrize("size", [1, 7, 16, 300])
def test_beyond_the_bound_all_are_counted_and_none_is_far_from_one_kept(small, size):
    block = points_of(300)
    subset, merged, thinned = taken([block[at : at + size] for at in range(0, 300, size)])
    assert len(subset.keys) <= 50
    assert len(subset.keys) + merged + thinned == 300
    assert merged == 0
    apart = KDTree(subset.points).query(block, p=np.inf)[0]
    assert apart.max() <= subset.within + 1e-12
    assert np.isfinite(subset.within)


def test_what_is_kept_lies_farther_apart_than_the_reach(small):
    subset, _, _ = taken([points_of(300)])
    nearest = KDTree(subset.points).query(subset.points, k=2, p=np.inf)[0][:, 1]
    assert subset.reach > 1e-6
    assert nearest.min() > subset.reach


def test_thinning_leaves_a_recording_as_evenly_spread_as_a_choice_of_the_farthest(small):
    """Its covering is at most four times that of the greedy choice of as many (2-approximate)."""
    block = points_of(400)
    subset, _, _ = taken([block])
    greedy = block[farthest_first(block, np.empty((0, 6)), len(subset.keys))]
    cover = KDTree(subset.points).query(block, p=np.inf)[0].max()
    best = KDTree(greedy).query(block, p=np.inf)[0].max()
    assert cover <= 4 * best


def test_blows_of_any_strength_are_thinned_to_what_differs_by_a_share_of_itself(small):
    """In plain numbers the strongest alone would say what is far."""
    blows = [np.abs(points_of(40, seed)) * 10.0**seed for seed in range(1, 9)]
    subset, _, _ = taken(blows)
    sizes = np.abs(subset.points).max(axis=1)
    assert subset.reach < 5
    assert sizes.min() < 5
    assert sizes.max() > 15


def test_a_wrench_of_any_size_is_taken(small):
    block = np.array([[1e308] * 6, [-1e308] * 6, [5e-324] * 6, [0.0] * 6])
    subset = take(Subset(), scaled_loads(block, np.full(6, 1e-6)), packed(block)).subset
    assert len(subset.keys) == 3
    assert np.isfinite(subset.points).all()


@settings(max_examples=60)
@given(arrays(float, (40, 6), elements=st.sampled_from([0.0, 0.1, 0.2, 0.5])))
def test_spaced_is_the_greedy_choice_one_by_one(points):
    kept: list[int] = []
    for place, point in enumerate(points):
        if all(np.abs(point - points[one]).max() > 0.15 for one in kept):
            kept.append(place)
    assert np.flatnonzero(spaced(points, 0.15)).tolist() == kept


def test_the_farthest_from_what_is_known_comes_first():
    points = np.zeros((3, 6))
    points[:, 0] = [0.1, 0.9, 0.5]
    assert farthest_first(points, np.zeros((1, 6)), 2) == [1, 2]
    assert farthest_first(points, np.zeros((1, 6)), 9) == [1, 2, 0]
    assert farthest_first(np.empty((0, 6)), np.zeros((1, 6)), 2) == []
