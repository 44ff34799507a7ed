"""What the ledger promises about rows and about its file."""

import errno
import os
import random
import sqlite3
from dataclasses import replace

import numpy as np
import pytest
from starlette.testclient import TestClient

from tests.service.ledger_rows import NewRow, claim, insert, noted, stored
from wrenchbook.service.http.app import create_app
from wrenchbook.service.ledger import (
    DamagedRowError,
    ImportOrigin,
    Ledger,
    LedgerDamagedError,
    LedgerUnavailableError,
    RowStatusError,
    UnknownRowError,
    connection,
)
from wrenchbook.service.ledger.records import LedgerFileError
from wrenchbook.service.workspace import Settings

ROWS = [
    NewRow((i, 0, 0, 0, 0, 0.1 * i), (i * 1e-6, 0, 0, 0, 0, 1e-7), origin=f"t.csv:{i}")
    for i in range(10)
]


def test_inserted_rows_come_back_bit_for_bit_in_their_order(ledger):
    rng = np.random.default_rng(1)
    new = NewRow(
        rng.normal(size=6),
        rng.normal(size=6),
        "measured",
        rng.normal(size=(6, 6)),
        rng.random(6),
        "bench 3",
    )
    assert insert(ledger, "plate", "f1", [new, *ROWS]) == (11, 0)
    rows = stored(ledger, "plate")
    first = rows[0]
    assert np.array_equal(first.wrench, new.wrench)
    assert np.array_equal(first.displacement, new.displacement)
    assert np.array_equal(first.compliance, new.compliance)
    assert np.array_equal(first.uncertainty, new.uncertainty)
    assert (first.source, first.origin, first.job) == ("measured", "bench 3", None)
    assert [row.wrench[0] for row in rows[1:]] == list(range(10))
    assert [row.seq for row in rows] == sorted(row.seq for row in rows)


def test_a_row_differs_by_displacement_uncertainty_source_component_and_fingerprint(ledger):
    row = ROWS[1]
    variants = [
        replace(row, displacement=(9, 0, 0, 0, 0, 0)),
        replace(row, uncertainty=(1, 1, 1, 1, 1, 1)),
        replace(row, source="fea"),
    ]
    assert insert(ledger, "plate", "f1", [row, *variants]) == (4, 0)
    assert insert(ledger, "plate", "f2", [row]) == (1, 0)
    assert insert(ledger, "bar", "f1", [row]) == (1, 0)


def test_a_table_that_comes_back_without_its_compliance_is_the_same_table(ledger):
    row = replace(ROWS[1], compliance=np.eye(6))
    insert(ledger, "plate", "f1", [row])
    assert insert(ledger, "plate", "f1", [replace(row, compliance=None)]) == (0, 1)


def test_a_measured_row_may_lack_outputs_and_is_known_again(ledger):
    row = replace(ROWS[0], displacement=(float("nan"), 0, 1e-3, 0, -float("nan"), 0))
    assert insert(ledger, "plate", "f1", [row]) == (1, 0)
    again = replace(row, displacement=(-float("nan"), 0, 1e-3, 0, float("nan"), 0))
    assert insert(ledger, "plate", "f1", [again]) == (0, 1)
    np.testing.assert_array_equal(stored(ledger, "plate")[0].displacement, row.displacement)


@pytest.mark.parametrize(
    "bad",
    [
        replace(ROWS[0], displacement=(float("nan"),) * 6),
        replace(ROWS[0], displacement=(float("inf"), 0, 0, 0, 0, 0)),
        replace(ROWS[0], displacement=(float("nan"), 0, 0, 0, 0, 0), source="fea"),
        replace(ROWS[0], compliance=np.full((6, 6), np.inf)),
    ],
)
def test_one_bad_row_keeps_all_of_them_out(ledger, bad):
    with pytest.raises(ValueError, match=r"displacement|ux|compliance"):
        insert(ledger, "plate", "f1", [*ROWS, bad])
    assert stored(ledger, "plate") == []


def test_a_row_that_is_not_there_is_named(ledger):
    with pytest.raises(UnknownRowError, match="no row 3"):
        ledger.row(3)


def test_withdrawing_what_is_not_there_or_twice_is_refused_by_name(ledger):
    insert(ledger, "plate", "f1", ROWS[:1])
    for component, seq in (("plate", 2), ("bar", 1)):
        with pytest.raises(UnknownRowError, match=f"no row {seq}"):
            ledger.withdraw(component, seq)
    with pytest.raises(RowStatusError, match=r"row 1 of .* is already in the table"):
        ledger.withdraw("plate", 1, withdrawn=False)
    ledger.withdraw("plate", 1)
    with pytest.raises(RowStatusError, match=r"row 1 of .* is already withdrawn"):
        ledger.withdraw("plate", 1)


def damage(ledger, column, seq=2):
    """Flip one bit of a row, as a bad disk would."""
    file = sqlite3.connect(ledger.path)
    (old,) = file.execute(f"SELECT {column} FROM rows WHERE seq = ?", (seq,)).fetchone()
    raw = bytearray(old.encode() if isinstance(old, str) else old)
    raw[-1] ^= 1
    new = raw.decode() if isinstance(old, str) else bytes(raw)
    file.execute(f"UPDATE rows SET {column} = ? WHERE seq = ?", (new, seq))
    file.commit()
    file.close()


@pytest.mark.parametrize(
    "column",
    [
        "fingerprint",
        "source",
        "wrench",
        "displacement",
        "compliance",
        "uncertainty",
        "origin",
        "key",
        "seal",
    ],
)
def test_a_row_with_a_flipped_bit_is_served_by_no_reader_and_named(ledger, column, caplog):
    full = [replace(row, compliance=np.eye(6), uncertainty=(1e-9,) * 6) for row in ROWS[:3]]
    for row in full:
        insert(ledger, "plate", "f1", [row])
    damage(ledger, column)
    assert [row.seq for row in stored(ledger, "plate")] == [1, 3]
    assert ledger.row_changes("plate", 0).rows.seq.tolist() == [1, 3]
    assert ledger.damaged == {2: "plate"}
    assert "row 2 of plate is damaged" in caplog.text
    with pytest.raises(DamagedRowError, match="row 2"):
        ledger.row(2)


@pytest.mark.parametrize("column", ["wrench", "displacement", "uncertainty"])
def test_a_flipped_bit_in_a_record_of_several_rows_takes_its_own_row_alone(ledger, column):
    full = [replace(row, uncertainty=(1e-9,) * 6, origin="t.csv") for row in ROWS]
    insert(ledger, "plate", "f1", full)
    damage(ledger, column, 1)
    assert [row.seq for row in stored(ledger, "plate")] == list(range(1, 10))
    assert ledger.damaged == {10: "plate"} == ledger.damaged_rows()
    row = noted(full[9:], "f1").rows
    assert ledger.rewrite("plate", 10, row)
    assert [row.wrench for row in stored(ledger, "plate")] == [row.wrench for row in full]
    assert insert(ledger, "plate", "f1", full) == (0, 10)


def test_a_repaired_row_that_was_withdrawn_alone_stays_so_when_its_import_is_restored(ledger):
    new = noted(ROWS[:3], "f1")
    number = ledger.import_rows("rig", [new], ImportOrigin())[2]
    ledger.withdraw("rig", 2)
    damage(ledger, "displacement", 2)
    assert ledger.rewrite("rig", 2, new.rows.take([1]))
    ledger.edit_import("rig", number, withdrawn=True)
    ledger.edit_import("rig", number, withdrawn=False)
    assert [row.seq for row in stored(ledger, "rig")] == [1, 3]


def test_a_damaged_row_of_a_job_is_solved_again_when_it_is_asked_for(ledger):
    wrench, displacement = ROWS[1].wrench, ROWS[1].displacement
    job, _ = ledger.accept("plate", "f1", wrench)
    claim(ledger, "me")
    seq = ledger.commit(job.id, 1, displacement).seq
    damage(ledger, "displacement", seq)
    seen = ledger.row_changes("plate", 0).last_seq
    assert ledger.accept("plate", "f1", wrench)[0].status == "waiting"
    claim(ledger, "me")
    assert ledger.commit(job.id, 2, displacement).displacement == displacement
    assert [row.seq for row in stored(ledger, "plate")] == [seq]
    assert ledger.row_changes("plate", seen).rows.seq.tolist() == [seq]


@pytest.mark.parametrize("replaced", [False, True])
def test_a_ledger_deleted_while_it_is_open_takes_nothing_and_says_so(ledger, replaced):
    """Imports went on into a file that nobody could ever open again."""
    assert ledger.trouble() is None
    if replaced:
        other = ledger.path.with_name("other.sqlite")
        Ledger(other).close()
        other.replace(ledger.path)
    else:
        ledger.path.unlink()
    with pytest.raises(LedgerUnavailableError, match="deleted or replaced"):
        insert(ledger, "plate", "f1", ROWS)
    with pytest.raises(LedgerUnavailableError, match="deleted or replaced"):
        ledger.accept("plate", "f1", ROWS[0].wrench)
    assert "deleted or replaced" in ledger.trouble()


def test_a_ledger_that_cannot_be_opened_now_is_opened_by_a_later_write(tmp_path):
    path = tmp_path / "ledger.sqlite"
    path.mkdir()
    patient = Ledger(path, patient=True)
    for call in (patient.version, patient.jobs, lambda: insert(patient, "plate", "f", ROWS)):
        with pytest.raises(LedgerUnavailableError, match="cannot be opened"):
            call()
    assert "cannot be opened" in patient.trouble()
    path.rmdir()
    assert insert(patient, "plate", "f1", ROWS) == (10, 0)
    assert (patient.trouble(), len(stored(patient, "plate"))) == (None, 10)
    patient.close()


def test_a_ledger_that_cannot_be_written_is_read_and_later_written(tmp_path, monkeypatch):
    path = tmp_path / "ledger.sqlite"
    whole = Ledger(path)
    insert(whole, "plate", "f1", ROWS[:3])
    whole.close()

    def full(_):
        raise sqlite3.OperationalError("database or disk is full")

    monkeypatch.setattr(connection, "_upgrade", full)
    patient = Ledger(path, patient=True)
    assert [len(stored(patient, "plate")), patient.last_seq("plate")] == [3, 3]
    assert "full" in patient.trouble()
    with pytest.raises(LedgerUnavailableError, match="full"):
        insert(patient, "plate", "f1", ROWS)
    monkeypatch.undo()
    assert insert(patient, "plate", "f1", ROWS) == (7, 3)
    assert (len(stored(patient, "plate")), patient.trouble()) == (10, None)
    patient.close()


def database(path, *statements):
    file = sqlite3.connect(path)
    for statement in statements:
        file.execute(statement)
    file.commit()
    file.close()


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda path: database(path, "CREATE TABLE notes (text)"), "another program"),
        (
            lambda path: path.write_bytes(b"long enough to be read as a database" * 20),
            "put back a copy",
        ),
        (
            lambda path: [Ledger(path).close(), database(path, "PRAGMA user_version = 99")],
            "newer w",
        ),
        (lambda path: path.mkdir(), "Is a directory.*move the folder away"),
    ],
    ids=["of another program", "no database", "of a newer version", "a folder"],
)
def test_a_file_that_is_no_ledger_of_this_version_is_refused_and_left_as_it_is(
    tmp_path, make, says
):
    path = tmp_path / "foreign"
    make(path)
    before = path.is_file() and path.read_bytes()
    with pytest.raises(LedgerFileError, match=says):
        Ledger(path)
    assert path.is_dir() or path.read_bytes() == before


def test_a_job_whose_row_is_withdrawn_may_be_solved_to_another_row(ledger):
    job, _ = ledger.accept("plate", "f1", ROWS[1].wrench)
    claim(ledger, "me")
    first = ledger.commit(job.id, 1, ROWS[1].displacement)
    ledger.withdraw("plate", first.seq)
    ledger.accept("plate", "f1", ROWS[1].wrench)
    claim(ledger, "me")
    second = ledger.commit(job.id, 2, (1, 0, 0, 0, 0, 0))
    assert [row.seq for row in stored(ledger, "plate")] == [second.seq]


def test_new_rows_of_a_setup_are_counted_beyond_any_limit(ledger):
    insert(ledger, "rig", "f", [NewRow((i, 0, 0, 0, 0, 0), (1e-6,) * 6) for i in range(660)])
    insert(ledger, "rig", "g", [NewRow((1, 2, 0, 0, 0, 0), (1e-6,) * 6)])
    assert (ledger.count_new("rig", "f", 0), ledger.count_new("rig", "f", 660)) == (660, 0)


# -- a damaged ledger ----------------------------------------------------------------------------

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
    job = claim(ledger, "me")
    ledger.commit(job.id, 1, (0.5,) * 6)
    before, digest = stored(ledger, "rig"), ledger.digest("rig", 10**9)
    assert len(before) == 481
    ledger.close()
    database(path, statement)
    ledger = Ledger(path)
    assert stored(ledger, "rig") == before
    assert (ledger.digest("rig", 10**9), ledger.damaged_rows()) == (digest, {})
    assert insert(ledger, "rig", "", new_rows(0, 490)) == (10, 480)
    assert ledger.job(job.id).row == 481
    ledger.close()


def test_rows_that_have_keys_and_are_gone_are_damage(path):
    database(path, "DELETE FROM rows WHERE seq = 41")
    with pytest.raises(LedgerDamagedError, match="40 rows that have keys are not there"):
        Ledger(path)


def test_keys_of_a_damaged_record_take_no_other_record_along(path):
    database(path, f"UPDATE rows SET key = {_LAST_KEY}, origin = 'x' WHERE seq = 41")
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
        database(path, "DELETE FROM row_keys WHERE seq = 3")
        Ledger(path).close()

    assert ledger.import_rows("rig", blocks(), ImportOrigin())[:2] == (10, 0)
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
        with pytest.raises(LedgerUnavailableError, match="It stays unchanged"):
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
        result = http.post("/v1/components/rig/displacement", json=asked).json()
        assert result["translation"][0] == pytest.approx(5e-7)


@pytest.mark.parametrize(
    ("code", "remedy"),
    [
        (sqlite3.SQLITE_BUSY, "another program holds its lock: end that program"),
        (sqlite3.SQLITE_CANTOPEN, "make its folder and files writable"),
        (sqlite3.SQLITE_IOERR_WRITE, "make room on its disk"),
        (sqlite3.SQLITE_MISMATCH, "check that its disk has space"),
    ],
)
def test_an_error_of_sqlite_has_the_remedy_of_its_cause(tmp_path, code, remedy):
    error = sqlite3.OperationalError("as SQLite says")
    error.sqlite_errorcode = code
    assert remedy in str(connection.unavailable(tmp_path / "ledger.sqlite", error))


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
        created = {"name": "rig", "title": "a rig", "range": span}
        assert http.post("/v1/components", json=created).is_success
        monkeypatch.setattr("wrenchbook.service.ledger.imports.take", take)
        caplog.clear()
        for _ in range(3):
            refused = http.post("/v1/components/rig/table", json={"rows": [row]})
            assert refused.status_code == status
            assert remedy in refused.json()["detail"]
            assert os.strerror(number) in refused.json()["detail"]
        assert [record.levelname for record in caplog.records if record.exc_info] == []
        errors = [record for record in caplog.records if record.levelname == "ERROR"]
        assert len(errors) == 1
        monkeypatch.undo()
        assert http.post("/v1/components/rig/table", json={"rows": [row]}).is_success
