"""A damaged ledger accepts nothing, says so, and what it has acknowledged can be had again."""

import errno
import os
import random
import sqlite3

import pytest
from starlette.testclient import TestClient

from tests.service.ledger_rows import NewRow, insert, noted, stored
from wrenchbook.service.http.app import create_app
from wrenchbook.service.ledger import (
    About,
    Ledger,
    LedgerDamagedError,
    LedgerUnavailableError,
)
from wrenchbook.service.workspace import Settings

PAGE = 4096  # bytes, SQLite's


def new_rows(first, last):
    return [NewRow((i, 0, 0, 0, 0, 1), (i * 1e-6, 0, 0, 0, 0, 1e-7)) for i in range(first, last)]


def displacements(ledger):
    return {row.displacement for row in stored(ledger, "rig")}


@pytest.fixture
def path(tmp_path):
    path = tmp_path / "ledger.sqlite"
    ledger = Ledger(path)
    for first in range(0, 480, 40):
        insert(ledger, "rig", "", new_rows(first, first + 40))
    ledger.accept_many("rig", "f", [(float(i), 1, 0, 0, 0, 0) for i in range(50)])
    ledger.close()
    return path


@pytest.mark.timeout(120)
def test_rows_accepted_by_a_ledger_with_damaged_bytes_are_there_after_a_restart(path):
    """11 of 300 damaged ledgers answered 200 and had lost the rows at the next start."""
    whole, refused = path.read_bytes(), 0
    for seed in [9, 11, 40, 63, 83, 130, 159, 163, 179, 245, 267, *range(300, 360)]:
        chance, damaged = random.Random(seed), bytearray(whole)
        for _ in range(1 + seed % 6):
            damaged[chance.randrange(len(damaged))] ^= chance.randrange(1, 256)
        path.write_bytes(damaged)
        ledger = Ledger(path, patient=True)
        try:
            insert(ledger, "rig", "", new_rows(1000, 1030))
        except LedgerUnavailableError:
            refused += 1
            assert str(path) in ledger.trouble()
        else:
            ledger.close()
            ledger = Ledger(path)
            assert {row.displacement for row in new_rows(1000, 1030)} <= displacements(ledger)
            ledger.row_changes("rig", 0)
        finally:
            ledger.close()
    assert refused > 10


def changed(path, *statements):
    db = sqlite3.connect(path)
    for statement in statements:
        db.execute(statement)
    db.commit()
    db.close()


_LAST_KEY = "CAST(substr(key, 1, 16 * count - 16) || zeroblob(16) AS BLOB)"


@pytest.mark.parametrize(
    "statement",
    [
        "DELETE FROM row_keys WHERE seq = (SELECT max(seq) FROM row_keys)",
        "DELETE FROM row_keys",
        "UPDATE row_keys SET hash = hash + 1 WHERE seq = 41",
        f"UPDATE rows SET key = {_LAST_KEY} WHERE seq = 41",
        "UPDATE rows SET key = zeroblob(16 * count)",
    ],
)
def test_damaged_keys_are_written_anew_from_the_rows(path, statement):
    ledger = Ledger(path)
    job = ledger.claim("me")
    ledger.commit(job.id, 1, (0.5,) * 6)
    before, digest = stored(ledger, "rig"), ledger.digest("rig", 10**9)
    assert len(before) == 481
    ledger.close()
    changed(path, statement)
    ledger = Ledger(path)
    assert stored(ledger, "rig") == before
    assert (ledger.digest("rig", 10**9), ledger.damaged_rows()) == (digest, {})
    assert insert(ledger, "rig", "", new_rows(0, 490)) == (10, 480)
    assert ledger.job(job.id).row == 481
    ledger.close()


def test_rows_that_have_keys_and_are_gone_are_damage(path):
    changed(path, "DELETE FROM rows WHERE seq = 41")
    with pytest.raises(LedgerDamagedError, match="40 rows that have keys are not there"):
        Ledger(path)


def test_keys_of_a_damaged_record_take_no_other_record_along(path):
    changed(path, f"UPDATE rows SET key = {_LAST_KEY}, origin = 'x' WHERE seq = 41")
    for _ in range(2):
        ledger = Ledger(path)
        assert ledger.trouble() is None
        assert ledger.damaged_rows() == dict.fromkeys(range(41, 81), "rig")
        assert len(stored(ledger, "rig")) == 440
        ledger.close()


def test_keys_are_left_to_an_import_that_runs(path):
    """Its rows get theirs at its end."""
    ledger = Ledger(path)

    def blocks():
        yield noted(new_rows(1000, 1010))
        Ledger(path).close()
        changed(path, "DELETE FROM row_keys WHERE seq = 3")
        Ledger(path).close()

    assert ledger.import_rows("rig", blocks(), About())[:2] == (10, 0)
    ledger.close()
    ledger = Ledger(path)
    assert insert(ledger, "rig", "", [*new_rows(0, 480), *new_rows(1000, 1010)]) == (0, 490)
    ledger.close()


def test_a_ledger_seen_to_be_damaged_while_it_is_open_takes_no_more_rows(path):
    ledger = Ledger(path)
    with path.open("r+b") as file:
        for page in range(1, path.stat().st_size // PAGE):
            file.seek(page * PAGE)
            file.write(b"\xff")  # no kind of page
    with pytest.raises(LedgerUnavailableError, match="malformed"):
        stored(ledger, "rig")
    assert "damaged" in ledger.trouble()
    for _ in range(2):
        with pytest.raises(LedgerUnavailableError, match="Nothing is written into it"):
            insert(ledger, "rig", "", new_rows(1000, 1030))
    ledger.close()


def test_a_server_with_a_damaged_ledger_says_so_and_answers_from_its_table_file(folder, stand_in):
    rows = [{"wrench": [0] * 6, "displacement": [0] * 6}]
    rows.append({"wrench": [1, 0, 0, 0, 0, 0], "displacement": [1e-6, 0, 0, 0, 0, 0]})
    table, body = "/v1/components/rig/table", {"rows": rows}
    with TestClient(create_app(Settings(folder, solvers=0))) as http:
        span = {"force": [1] * 3, "moment": [1] * 3}
        assert http.post(
            "/v1/components", json={"name": "rig", "title": "a rig", "range": span}
        ).is_success
        assert http.post(table, json=body).is_success
    path = folder / "ledger.sqlite"
    raw = path.read_bytes()
    path.write_bytes(raw[: 3 * PAGE] + bytes([0xFF] * 50) + raw[3 * PAGE + 50 :])
    with TestClient(create_app(Settings(folder, solvers=0))) as http:
        ready = http.get("/health/ready")
        assert ready.status_code == 503
        assert "damaged" in ready.json()["faults"][0]
        refused = http.post(table, json=body)
        assert refused.status_code == 503
        assert "damaged" in refused.json()["detail"]
        asked = {"force": [0.5, 0, 0], "moment": [0, 0, 0], "on_thin": "estimate"}
        found = http.post("/v1/components/rig/displacement", json=asked).json()
        assert found["translation"][0] == pytest.approx(5e-7)


@pytest.mark.parametrize(
    ("number", "status", "remedy"),
    [
        (errno.EROFS, 503, "remount it writable"),
        (errno.ENOLCK, 503, "move the data directory to a local disk"),
        (errno.EIO, 503, "its disk fails"),
        (errno.ENOSPC, 507, "make room on its disk"),
    ],
)
def test_an_import_on_a_disk_that_takes_no_lock_answers_500_with_a_trace_each_time(
    folder, stand_in, monkeypatch, caplog, number, status, remedy
):
    def take(path):
        raise OSError(number, os.strerror(number), str(path))

    span = {"force": [1] * 3, "moment": [1] * 3}
    row = {"wrench": [1, 0, 0, 0, 0, 0], "displacement": [1e-6, 0, 0, 0, 0, 0]}
    with TestClient(create_app(Settings(folder, solvers=0))) as http:
        made = {"name": "rig", "title": "a rig", "range": span}
        assert http.post("/v1/components", json=made).is_success
        monkeypatch.setattr("wrenchbook.service.ledger.imports.take", take)
        caplog.clear()
        for _ in range(3):
            refused = http.post("/v1/components/rig/table", json={"rows": [row]})
            assert refused.status_code == status
            assert remedy in refused.json()["detail"]
            assert os.strerror(number) in refused.json()["detail"]
        assert [one.levelname for one in caplog.records if one.exc_info] == []
        errors = [one for one in caplog.records if one.levelname == "ERROR"]
        assert len(errors) == 1
        monkeypatch.undo()
        assert http.post("/v1/components/rig/table", json={"rows": [row]}).is_success


def test_a_write_to_a_read_only_ledger_names_the_disk(path, caplog):
    ledger = Ledger(path)
    ledger._writer.execute("PRAGMA query_only = ON")
    for _ in range(3):
        with pytest.raises(LedgerUnavailableError, match="remount it writable"):
            insert(ledger, "rig", "", new_rows(1000, 1001))
    assert len(caplog.records) == 1
    ledger._writer.execute("PRAGMA query_only = OFF")
    assert insert(ledger, "rig", "", new_rows(1000, 1001)) == (1, 0)
    ledger.close()
