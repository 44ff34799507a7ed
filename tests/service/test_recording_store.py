"""Recordings and envelopes in the ledger: keys of blocks, several interfaces, bounds."""

from itertools import product
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial import KDTree

from wrenchbook.service.ledger import BlockKeyError, packed
from wrenchbook.service.recording import store as recordings
from wrenchbook.service.recording import thinning
from wrenchbook.service.recording.bound import bound_of
from wrenchbook.service.recording.store import EnvelopeState, RecordingStore, Tally
from wrenchbook.service.recording.thinning import Subset, farthest_first, scaled_loads, spaced, take
from wrenchbook.surrogate.build import build
from wrenchbook.surrogate.packed.writer import packed_of
from wrenchbook.surrogate.table.rows import LoadRange, Rows, Tolerance
from wrenchbook.surrogate.table.space import Input, space_of

WRENCH = np.array([[1.0, 2, 3, 4, 5, 6]])
SINGLE = LoadRange(np.array([-10.0] * 6), np.array([10.0] * 6))
SPACE = space_of(["left", "right"], [Input("temperature", "degC", "scalar")])
RANGE = LoadRange(-np.ones(13), np.ones(13), SPACE)


class Library(dict):
    """Has one component, whose load range a test may change."""

    def __init__(self, load_range=SINGLE):
        self.load_range = load_range

    def __missing__(self, name):
        return SimpleNamespace(name=name, load_range=self.load_range, acting=lambda wrench: wrench)


@pytest.fixture
def store(ledger):
    return RecordingStore(SimpleNamespace(library=Library(), ledger=ledger))


@pytest.fixture
def workspace(ledger):
    return SimpleNamespace(library=Library(RANGE), ledger=ledger)


def count(ledger, table):
    with ledger.reading() as db:
        return db.execute(f"SELECT count(*) FROM {table}").fetchone()[0]


def test_keys_of_a_client_are_kept_while_a_block_may_be_sent_again_and_no_longer(ledger, store):
    for number in range(600):
        store.record("plate", WRENCH, ("me", number))
    assert count(ledger, "blocks") == recordings.BLOCKS_OF_A_CLIENT
    assert store.record("plate", WRENCH, ("me", 599)).known
    with pytest.raises(BlockKeyError, match="in order"):
        store.record("plate", WRENCH, ("me", 5))
    assert store.recording("plate").tally.offered == 600


def test_keys_of_any_number_of_clients_are_bounded(ledger, store, monkeypatch):
    monkeypatch.setattr(recordings, "BLOCKS", 20)
    for number in range(50):
        store.record("plate", WRENCH, (f"client {number}", 0))
    assert count(ledger, "blocks") == 20


def test_a_block_that_fails_leaves_nothing_not_even_its_key(ledger, store, monkeypatch):
    block = ("me", 1)

    def fails(*_):
        raise RuntimeError("no memory")

    with monkeypatch.context() as broken:
        broken.setattr(recordings, "take", fails)
        with pytest.raises(RuntimeError):
            store.record("plate", WRENCH, block)
    assert count(ledger, "blocks") == 0
    assert not store.record("plate", WRENCH, block).known


def test_the_same_key_counts_once_for_each_of_recording_and_envelope(store):
    block = ("me", 1)
    for _ in range(2):
        store.record("plate", WRENCH, block)
        store.widen("plate", WRENCH, block)
    assert store.recording("plate").tally.offered == store.envelope("plate").tally.offered == 1


def wrenches(count):
    return np.random.default_rng(3).uniform(-1.0, 1.0, (count, 13))


def test_a_load_range_that_moves_sorts_the_recorded_wrenches_again(workspace):
    workspace.library.load_range = SINGLE
    store = RecordingStore(workspace)
    store.record("plate", 15 * np.eye(6)[:1], None)
    workspace.library.load_range = LoadRange(np.zeros(6), np.full(6, 20.0))  # of the same scale
    assert store.record("plate", (15 + 1e-7) * np.eye(6)[:1], None).tally.merged == 1


def test_a_recording_of_13_inputs_keeps_its_wrenches(workspace):
    sent = wrenches(20)
    assert RecordingStore(workspace).record("link", sent, None).outside == 0
    assert np.array_equal(RecordingStore(workspace).recording("link").wrenches, sent)


def test_an_envelope_of_13_inputs_has_the_extremes_of_each(workspace):
    store, sent = RecordingStore(workspace), wrenches(20)
    assert np.isnan(store.envelope("link").box[0]).tolist() == [True] * 13
    store.widen("link", sent[:12], None)
    store.widen("link", sent[12:], None)
    low, high = store.envelope("link").box
    assert np.array_equal(low, sent.min(axis=0))
    assert np.array_equal(high, sent.max(axis=0))


def test_wrenches_of_a_setup_with_fewer_inputs_are_left_out(workspace):
    workspace.library.load_range = LoadRange(-np.ones(6), np.ones(6))
    RecordingStore(workspace).record("link", wrenches(5)[:, :6], None)
    RecordingStore(workspace).widen("link", wrenches(5)[:, :6], None)
    workspace.library.load_range = RANGE
    store = RecordingStore(workspace)
    assert store.recording("link").wrenches.shape == (0, 13)
    assert store.envelope("link").lowest.shape == (0, 13)
    store.record("link", wrenches(5), None)
    store.widen("link", wrenches(5), None)
    assert np.array_equal(store.recording("link").wrenches, wrenches(5))
    assert np.array_equal(store.envelope("link").box[0], wrenches(5).min(axis=0))


def test_the_bound_of_13_inputs_is_that_of_the_matrix_and_judges_each_output(workspace):
    matrix = np.random.default_rng(4).normal(size=(12, 13))
    rows = Rows.of(np.eye(13), matrix.T, SPACE, compliance=np.tile(matrix, (13, 1, 1)))
    built = build(rows, RANGE, tolerance=Tolerance(1.0, 1.0), linear=True)
    packed = packed_of(built)
    table = SimpleNamespace(load_range=RANGE, linear=True, fit=built.groups[0].fit, packed=packed)
    store = RecordingStore(workspace)
    store.widen("link", wrenches(20), None)
    envelope = store.envelope("link")
    low, high = envelope.box
    largest = np.maximum(matrix * low, matrix * high).sum(axis=1)
    result = bound_of(table, envelope, Tolerance(1e3, 1e3))
    assert (result.kind, result.negligible) == ("bound", True)
    assert (result.displacement >= largest * (1 - 1e-9)).all()
    assert bound_of(table, envelope, Tolerance(1e3, 1.0)).negligible is False


def test_the_bound_of_13_inputs_contains_the_error_bar_where_all_inputs_are_largest():
    """4,096 random corners of 8,192 may leave out the corner with the largest error bar."""
    random = np.random.default_rng(6)
    low, high = -random.uniform(1, 2, 13), random.uniform(1, 2, 13)
    outermost = np.where(-low > high, low, high)

    def batch(points):
        coverage = np.zeros(len(points), dtype=np.uint8)
        errors = np.tile(np.abs(points).sum(axis=1)[:, None], 12)
        return SimpleNamespace(
            outputs=np.zeros((len(points), 12)), errors=errors, coverage=coverage
        )

    table = SimpleNamespace(
        load_range=RANGE,
        linear=True,
        fit=SimpleNamespace(complete=True, matrix=np.zeros((12, 13))),
        packed=SimpleNamespace(batch=batch),
    )
    result = bound_of(table, EnvelopeState(Tally(), np.diag(low), np.diag(high)), None)
    assert np.allclose(result.displacement, np.abs(outermost).sum(), rtol=1e-12)


def test_the_bound_of_a_temperature_in_kelvin_starts_from_its_reference_not_from_0_kelvin():
    space = space_of([""], [Input("temperature", "K", "scalar", zero=293.15)])
    low, high = np.append(-np.ones(6), 290.0), np.append(np.ones(6), 310.0)
    matrix = np.random.default_rng(7).normal(size=(6, 7))

    def batch(points):
        moved = (points - space.zero) @ matrix.T
        errors, coverage = np.zeros(moved.shape), (points < low).any(axis=1) * 2
        return SimpleNamespace(outputs=moved, errors=errors, coverage=coverage)

    table = SimpleNamespace(
        load_range=LoadRange(low, high, space),
        linear=True,
        fit=SimpleNamespace(complete=True, matrix=matrix),
        packed=SimpleNamespace(batch=batch),
    )
    envelope = EnvelopeState(Tally(), np.where(np.eye(7), low, space.zero), np.tile(high, (7, 1)))
    corners = np.array(list(product(*zip(low, high, strict=True))))
    result = bound_of(table, envelope, None)
    assert np.allclose(result.displacement, np.abs(batch(corners).outputs).max(axis=0))
    assert result.coverage == "covered"


def test_the_bound_of_a_matrix_is_the_largest_at_the_corners_of_the_box():
    """By all 64 corners, of a complete compliance without an error bar and with zero at rest."""
    random = np.random.default_rng(5)
    low, high, matrix = (
        -random.uniform(1, 2, 6),
        random.uniform(1, 2, 6),
        random.normal(size=(6, 6)),
    )

    def batch(points):
        errors = np.zeros((len(points), 6))
        coverage = np.zeros(len(points), dtype=np.uint8)
        return SimpleNamespace(outputs=points @ matrix.T, errors=errors, coverage=coverage)

    fit = SimpleNamespace(complete=True, matrix=matrix)
    span = LoadRange(-np.ones(6), np.ones(6))
    packed = SimpleNamespace(batch=batch)
    table = SimpleNamespace(load_range=span, linear=True, fit=fit, packed=packed)
    envelope = EnvelopeState(Tally(), np.diag(low), np.diag(high))
    corners = np.array(list(product(*zip(low, high, strict=True))))
    expected = np.abs(corners @ matrix.T).max(axis=0)
    result = bound_of(table, envelope, Tolerance(1e3, 1e3)).displacement
    assert np.allclose(result, expected, rtol=1e-12)


# -- farthest-point thinning: what is kept lies apart, and all are counted -----------------------

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
    assert subset.radius < 5
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
        if all(np.abs(point - points[item]).max() > 0.15 for item in kept):
            kept.append(place)
    assert np.flatnonzero(spaced(points, 0.15)).tolist() == kept


def test_the_farthest_from_what_is_known_comes_first():
    points = np.zeros((3, 6))
    points[:, 0] = [0.1, 0.9, 0.5]
    assert farthest_first(points, np.zeros((1, 6)), 2) == [1, 2]
    assert farthest_first(points, np.zeros((1, 6)), 9) == [1, 2, 0]
    assert farthest_first(np.empty((0, 6)), np.zeros((1, 6)), 2) == []
