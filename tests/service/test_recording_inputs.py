"""Recordings and envelopes of components with several interfaces and further inputs."""

from itertools import product
from types import SimpleNamespace

import numpy as np
import pytest

from wrenchbook.service.ledger import Ledger
from wrenchbook.service.recording.store import EnvelopeState, RecordingStore, Tally, bound_of
from wrenchbook.surrogate.build import build
from wrenchbook.surrogate.packed.writer import packed_of
from wrenchbook.surrogate.table.rows import LoadRange, Rows, Tolerance
from wrenchbook.surrogate.table.space import Input, space_of

SPACE = space_of(["left", "right"], [Input("temperature", "degC", "scalar")])
RANGE = LoadRange(-np.ones(13), np.ones(13), SPACE)


class Library(dict):
    """Has one component, whose load range a test may change."""

    load_range = RANGE

    def __missing__(self, name):
        return SimpleNamespace(name=name, load_range=self.load_range, acting=lambda wrench: wrench)


@pytest.fixture
def workspace(tmp_path):
    ledger = Ledger(tmp_path / "ledger.sqlite")
    yield SimpleNamespace(library=Library(), ledger=ledger)
    ledger.close()


def wrenches(count):
    return np.random.default_rng(3).uniform(-1.0, 1.0, (count, 13))


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
    found = bound_of(table, envelope, Tolerance(1e3, 1e3))
    assert (found.kind, found.negligible) == ("bound", True)
    assert (found.displacement >= largest * (1 - 1e-9)).all()
    assert bound_of(table, envelope, Tolerance(1e3, 1.0)).negligible is False


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
    found = bound_of(table, envelope, Tolerance(1e3, 1e3)).displacement
    assert np.allclose(found, expected, rtol=1e-12)
