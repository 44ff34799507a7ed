"""Writers of several processes: who waits gets the ledger as soon as it is free, or an error."""

import sqlite3
import threading

import pytest

from tests.service.ledger_rows import NewRow, noted
from wrenchbook.service.ledger import About, Ledger, connection
from wrenchbook.service.ledger.records import LedgerUnavailableError

WRENCH = (1.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@pytest.fixture
def path(tmp_path):
    return tmp_path / "ledger.sqlite"


def test_a_writer_that_waits_begins_once_the_other_has_ended(path):
    ledger, other = Ledger(path), connection.connect(path)
    other.execute("BEGIN IMMEDIATE")
    waiting = threading.Thread(target=lambda: ledger.accept("bar", "f", WRENCH))
    waiting.start()
    assert ledger.jobs() == []
    other.execute("COMMIT")
    waiting.join(60)
    assert [job.wrench for job in ledger.jobs()] == [WRENCH]
    other.close()
    ledger.close()


def test_a_ledger_that_stays_busy_is_told_of_and_usable_afterwards(path, monkeypatch):
    ledger, other = Ledger(path), connection.connect(path)
    other.execute("BEGIN IMMEDIATE")
    monkeypatch.setattr(connection, "BUSY_SECONDS", 0.05)
    with pytest.raises(LedgerUnavailableError, match="locked"):
        ledger.accept("bar", "f", WRENCH)
    monkeypatch.undo()
    other.execute("ROLLBACK")
    assert ledger.accept("bar", "f", WRENCH)[0].id == 1
    other.close()
    ledger.close()


def test_what_is_no_lock_is_told_at_once(path):
    db = connection.connect(path)
    db.execute("BEGIN")
    with pytest.raises(sqlite3.OperationalError, match="within a transaction"):
        connection.begin(db)
    assert db.execute("PRAGMA busy_timeout").fetchone() == (30_000,)
    db.close()


def test_each_part_of_an_import_is_on_the_disk_before_the_next_begins(path, monkeypatch):
    """Else the next durable transaction, which is somebody else's, waits for all of them."""
    ledger, told = Ledger(path), []
    sync = Ledger.sync

    def heard(self):
        with self.writing():  # nobody holds the ledger meanwhile
            told.append("synced")
        sync(self)

    monkeypatch.setattr(Ledger, "sync", heard)
    blocks = [noted([NewRow((number, 0, 0, 0, 0, 0), (0.0,) * 6)]) for number in range(3)]
    assert ledger.import_rows("rig", blocks, About())[:2] == (3, 0)
    assert len(told) == 4  # three blocks, and the keys
    ledger.close()
