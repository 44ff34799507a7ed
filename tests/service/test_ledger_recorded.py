"""Recordings in the ledger: keys of blocks, what is bounded."""

from types import SimpleNamespace

import numpy as np
import pytest

from wrenchbook.service.ledger import BlockKeyError
from wrenchbook.service.recording import store as recordings
from wrenchbook.service.recording.store import RecordingStore
from wrenchbook.surrogate.table.rows import LoadRange

WRENCH = np.array([[1.0, 2, 3, 4, 5, 6]])
RANGE = LoadRange(np.array([-10.0] * 6), np.array([10.0] * 6))


class Library(dict):
    def __missing__(self, name):
        return SimpleNamespace(name=name, load_range=RANGE, acting=lambda wrenches: wrenches)


def store_of(ledger):
    return RecordingStore(SimpleNamespace(library=Library(), ledger=ledger))


@pytest.fixture
def store(ledger):
    return store_of(ledger)


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
