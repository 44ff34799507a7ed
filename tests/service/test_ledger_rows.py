"""What the ledger promises about rows and about its file."""

import sqlite3
from dataclasses import replace

import numpy as np
import pytest

from tests.service.ledger_rows import NewRow, insert, noted, stored
from wrenchbook.service.ledger import (
    DamagedRowError,
    Ledger,
    LedgerFileError,
    LedgerUnavailableError,
    RowStatusError,
    UnknownRowError,
    connection,
)
from wrenchbook.service.ledger.packing import pack_vector

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


def test_inserting_a_table_twice_changes_nothing_the_second_time(ledger):
    assert insert(ledger, "plate", "f1", ROWS) == (10, 0)
    version = ledger.last_seq()
    assert insert(ledger, "plate", "f1", [*ROWS, ROWS[0]]) == (0, 11)
    assert ledger.last_seq() == version
    assert len(stored(ledger, "plate")) == 10


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


def test_rows_after_a_seq_and_of_a_fingerprint_are_what_a_follower_reads(ledger):
    insert(ledger, "plate", "f1", ROWS[:3])
    seen = ledger.last_seq("plate")
    insert(ledger, "bar", "f1", ROWS[:2])
    insert(ledger, "plate", "f2", ROWS[3:5])
    assert ledger.last_seq("plate") == ledger.last_seq() > seen
    assert [row.wrench[0] for row in stored(ledger, "plate", after=seen)] == [3, 4]
    assert [row.fingerprint for row in stored(ledger, "plate", "f1")] == ["f1"] * 3
    assert (ledger.last_seq("spring"), stored(ledger, "spring")) == (0, [])


def test_a_job_whose_very_row_was_imported_before_is_done_with_that_row(ledger):
    insert(ledger, "plate", "f1", [replace(ROWS[1], source="fea")])
    imported = stored(ledger, "plate")[0]
    job, _ = ledger.accept("plate", "f1", ROWS[1].wrench)
    ledger.claim("me")
    assert ledger.commit(job.id, 1, ROWS[1].displacement) == imported
    assert ledger.job(job.id).row == imported.seq
    assert stored(ledger, "plate") == [imported]


def test_a_row_that_is_not_there_is_named(ledger):
    with pytest.raises(UnknownRowError, match="no row 3"):
        ledger.row(3)


def test_a_fresh_ledger_beside_older_tables_numbers_its_rows_after_theirs(ledger):
    insert(ledger, "plate", "f1", ROWS[:1], above=500)
    assert ledger.last_seq() == 501
    insert(ledger, "plate", "f1", ROWS[:2], above=100)
    assert ledger.last_seq() > 501


def test_the_version_differs_after_own_commits_and_not_after_reading(ledger):
    before = ledger.version()
    stored(ledger, "plate")
    ledger.jobs()
    assert ledger.version() == before
    insert(ledger, "plate", "f1", ROWS)
    assert ledger.version() != before


def test_twenty_thousand_rows_go_in_and_come_out(ledger):
    compliance = np.eye(6).tolist()
    many = [
        NewRow((i, 0, 0, 0, 0, 0), (i * 1e-6, 0, 0, 0, 0, 0), "measured", compliance)
        for i in range(20_000)
    ]
    assert insert(ledger, "plate", "f1", many) == (20_000, 0)
    assert len(stored(ledger, "plate")) == 20_000


def test_a_file_of_another_program_is_refused_and_left_as_it_is(tmp_path):
    path = tmp_path / "ledger.sqlite"
    foreign = sqlite3.connect(path)
    foreign.execute("CREATE TABLE notes (text)")
    foreign.commit()
    foreign.close()
    before = path.read_bytes()
    with pytest.raises(LedgerFileError, match="another program"):
        Ledger(path)
    assert path.read_bytes() == before


def test_a_file_that_is_no_database_is_refused_with_what_to_do(tmp_path):
    path = tmp_path / "ledger.sqlite"
    path.write_bytes(b"not a database at all, but long enough to be read as one" * 20)
    with pytest.raises(LedgerFileError, match="Move it away"):
        Ledger(path)


def test_a_ledger_of_a_newer_schema_is_refused_with_what_to_do(tmp_path):
    path = tmp_path / "ledger.sqlite"
    Ledger(path).close()
    newer = sqlite3.connect(path)
    newer.execute("PRAGMA user_version = 99")
    newer.close()
    with pytest.raises(LedgerFileError, match="newer wrenchbook"):
        Ledger(path)


def test_a_folder_that_cannot_be_opened_is_named(tmp_path):
    (tmp_path / "ledger.sqlite").mkdir()
    with pytest.raises(LedgerFileError, match="cannot open"):
        Ledger(tmp_path / "ledger.sqlite")


def test_a_withdrawn_row_is_gone_for_readers_and_followers_and_comes_back(ledger):
    insert(ledger, "plate", "f1", ROWS[:3])
    seen = ledger.last_seq("plate")
    ledger.withdraw("plate", 2)
    assert [row.seq for row in stored(ledger, "plate")] == [1, 3]
    assert ledger.row(2).origin == "t.csv:1"
    row_changes = ledger.row_changes("plate", seen)
    assert (len(row_changes.rows), row_changes.gone) == (0, {2})
    assert row_changes.last_seq == ledger.last_seq("plate") == ledger.last_seq() > seen
    ledger.restore("plate", 2)
    assert [row.seq for row in stored(ledger, "plate")] == [1, 2, 3]
    back = ledger.row_changes("plate", row_changes.last_seq)
    assert (back.rows.seq.tolist(), back.gone) == ([2], {2})
    insert(ledger, "plate", "f1", ROWS[3:4])
    assert ledger.row_changes("plate", back.last_seq).rows.seq.tolist() == [back.last_seq + 1]


def test_withdrawing_what_is_not_there_or_twice_is_refused_by_name(ledger):
    insert(ledger, "plate", "f1", ROWS[:1])
    for component, seq in (("plate", 2), ("bar", 1)):
        with pytest.raises(UnknownRowError, match=f"no row {seq}"):
            ledger.withdraw(component, seq)
    with pytest.raises(RowStatusError, match="row 1 is in the table"):
        ledger.restore("plate", 1)
    ledger.withdraw("plate", 1)
    with pytest.raises(RowStatusError, match="row 1 is withdrawn already"):
        ledger.withdraw("plate", 1)


@pytest.mark.parametrize("same", [True, False])
def test_a_job_whose_row_is_withdrawn_is_solved_again_when_it_is_asked_for(ledger, same):
    job, _ = ledger.accept("plate", "f1", ROWS[1].wrench)
    ledger.claim("me")
    first = ledger.commit(job.id, 1, ROWS[1].displacement)
    key = pack_vector(ROWS[1].wrench)
    assert ledger.jobs_for("plate", "f1", [key])[key].row == first.seq
    ledger.withdraw("plate", first.seq)
    assert ledger.jobs_for("plate", "f1", [key]) == {}
    again, created = ledger.accept("plate", "f1", ROWS[1].wrench)
    assert (again.id, again.status, again.row, created) == (job.id, "waiting", None, False)
    ledger.claim("me")
    second = ledger.commit(job.id, 2, ROWS[1].displacement if same else (1, 0, 0, 0, 0, 0))
    assert (second.seq == first.seq) == same
    assert [row.seq for row in stored(ledger, "plate")] == [second.seq]


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


def test_a_damaged_row_of_a_job_is_solved_again_when_it_is_asked_for(ledger):
    wrench, displacement = ROWS[1].wrench, ROWS[1].displacement
    job, _ = ledger.accept("plate", "f1", wrench)
    ledger.claim("me")
    seq = ledger.commit(job.id, 1, displacement).seq
    damage(ledger, "displacement", seq)
    seen = ledger.row_changes("plate", 0).last_seq
    assert ledger.accept("plate", "f1", wrench)[0].status == "waiting"
    ledger.claim("me")
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
        with pytest.raises(LedgerUnavailableError, match="cannot open"):
            call()
    assert "cannot open" in patient.trouble()
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

    monkeypatch.setattr(connection, "_use_wal", full)
    patient = Ledger(path, patient=True)
    assert [len(stored(patient, "plate")), patient.last_seq("plate")] == [3, 3]
    assert "full" in patient.trouble()
    with pytest.raises(LedgerUnavailableError, match="full"):
        insert(patient, "plate", "f1", ROWS)
    monkeypatch.undo()
    assert insert(patient, "plate", "f1", ROWS) == (7, 3)
    assert (len(stored(patient, "plate")), patient.trouble()) == (10, None)
    patient.close()


def test_news_told_in_parts_are_the_news_told_at_once(ledger):
    rows = [NewRow((i, 0, 0, 0, 0, 0), (1e-6 * i, 0, 0, 0, 0, 0)) for i in range(1, 31)]
    insert(ledger, "plate", "", rows)
    seqs = [row.seq for row in stored(ledger, "plate")]
    for seq in seqs[3:12:2]:
        ledger.withdraw("plate", seq)
    ledger.restore("plate", seqs[5])
    held, after, parts = {}, 0, 0
    while True:
        row_changes = ledger.row_changes("plate", after, most=4)
        held = {seq: None for seq in held if seq not in row_changes.gone}
        held |= dict.fromkeys(row_changes.rows.seq.tolist())
        after, parts = row_changes.last_seq, parts + 1
        if parts == 2:  # what happens meanwhile is told as well
            ledger.withdraw("plate", seqs[0])
            ledger.restore("plate", seqs[7])
        if row_changes.whole:
            break
    assert parts > 5
    assert after == ledger.last_seq("plate")
    assert sorted(held) == [row.seq for row in stored(ledger, "plate")]


def test_new_rows_of_a_setup_are_counted_beyond_any_limit(tmp_path):
    ledger = Ledger(tmp_path / "ledger.sqlite")
    insert(ledger, "rig", "f", [NewRow((i, 0, 0, 0, 0, 0), (1e-6,) * 6) for i in range(660)])
    insert(ledger, "rig", "g", [NewRow((1, 2, 0, 0, 0, 0), (1e-6,) * 6)])
    assert (ledger.count_new("rig", "f", 0), ledger.count_new("rig", "f", 660)) == (660, 0)
    ledger.close()
