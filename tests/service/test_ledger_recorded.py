"""Recordings in the ledger: files of earlier schemas, keys of blocks, what is bounded."""

from dataclasses import replace

import pytest

from wrenchbook.service.ledger import BlockKeyError, Kept, Ledger, block_of, recordings
from wrenchbook.service.ledger.packing import pack_vector

WRENCH = pack_vector((1.0, 2, 3, 4, 5, 6))


@pytest.fixture
def ledger(tmp_path):
    opened = Ledger(tmp_path / "ledger.sqlite")
    yield opened
    opened.close()


def add_one(now, _):
    return Kept(replace(now, offered=now.offered + 1), [], [])


def count(ledger, table):
    with ledger.reading() as db:
        return db.execute(f"SELECT count(*) FROM {table}").fetchone()[0]


def test_keys_of_a_client_are_kept_while_a_block_may_be_sent_again_and_no_longer(ledger):
    for number in range(600):
        ledger.record("plate", block_of("me", number, [WRENCH]), add_one)
    assert count(ledger, "blocks") == recordings.BLOCKS_OF_A_CLIENT
    assert ledger.record("plate", block_of("me", 599, [WRENCH]), add_one)[1]
    with pytest.raises(BlockKeyError, match="in order"):
        ledger.record("plate", block_of("me", 5, [WRENCH]), add_one)
    assert ledger.recording("plate")[0].offered == 600


def test_keys_of_any_number_of_clients_are_bounded(ledger, monkeypatch):
    monkeypatch.setattr(recordings, "BLOCKS", 20)
    for number in range(50):
        ledger.record("plate", block_of(f"client {number}", 0, [WRENCH]), add_one)
    assert count(ledger, "blocks") == 20


def test_a_block_whose_choice_fails_leaves_nothing_not_even_its_key(ledger):
    block = block_of("me", 1, [WRENCH])

    def fails(now, read):
        raise RuntimeError("no memory")

    with pytest.raises(RuntimeError):
        ledger.record("plate", block, fails)
    assert count(ledger, "blocks") == 0
    assert not ledger.record("plate", block, add_one)[1]


def test_the_same_key_counts_once_for_each_of_recording_and_envelope(ledger):
    block = block_of("me", 1, [WRENCH])
    for _ in range(2):
        ledger.record("plate", block, add_one)
        ledger.widen("plate", block, add_one)
    assert ledger.recording("plate")[0].offered == ledger.envelope("plate")[0].offered == 1
