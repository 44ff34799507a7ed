"""What the ledger promises about rows and about its file."""

import sqlite3
import time
from dataclasses import replace

import numpy as np
import pytest

from service.ledger import Ledger, LedgerFileError, NewRow, UnknownRowError

ROWS = [
    NewRow((i, 0, 0, 0, 0, 0.1 * i), (i * 1e-6, 0, 0, 0, 0, 1e-7), origin=f"t.csv:{i}")
    for i in range(10)
]


@pytest.fixture
def ledger(tmp_path):
    ledger = Ledger(tmp_path / "ledger.sqlite")
    yield ledger
    ledger.close()


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
    assert ledger.insert_rows("plate", "f1", [new, *ROWS]) == (11, 0)
    rows = ledger.rows("plate")
    first = rows[0]
    assert np.array_equal(first.wrench, new.wrench)
    assert np.array_equal(first.displacement, new.displacement)
    assert np.array_equal(first.compliance, new.compliance)
    assert np.array_equal(first.uncertainty, new.uncertainty)
    assert (first.source, first.origin, first.job) == ("measured", "bench 3", None)
    assert [row.wrench[0] for row in rows[1:]] == list(range(10))
    assert [row.seq for row in rows] == sorted(row.seq for row in rows)


def test_inserting_a_table_twice_changes_nothing_the_second_time(ledger):
    assert ledger.insert_rows("plate", "f1", ROWS) == (10, 0)
    version = ledger.last_seq()
    assert ledger.insert_rows("plate", "f1", [*ROWS, ROWS[0]]) == (0, 11)
    assert ledger.last_seq() == version
    assert len(ledger.rows("plate")) == 10


def test_a_row_differs_by_displacement_uncertainty_source_component_and_fingerprint(ledger):
    row = ROWS[1]
    variants = [
        replace(row, displacement=(9, 0, 0, 0, 0, 0)),
        replace(row, uncertainty=(1, 1, 1, 1, 1, 1)),
        replace(row, source="fea"),
    ]
    assert ledger.insert_rows("plate", "f1", [row, *variants]) == (4, 0)
    assert ledger.insert_rows("plate", "f2", [row]) == (1, 0)
    assert ledger.insert_rows("bar", "f1", [row]) == (1, 0)


def test_a_table_that_comes_back_without_its_compliance_is_the_same_table(ledger):
    row = replace(ROWS[1], compliance=np.eye(6))
    ledger.insert_rows("plate", "f1", [row])
    assert ledger.insert_rows("plate", "f1", [replace(row, compliance=None)]) == (0, 1)


def test_a_measured_row_may_lack_outputs_and_is_known_again(ledger):
    row = replace(ROWS[0], displacement=(float("nan"), 0, 1e-3, 0, -float("nan"), 0))
    assert ledger.insert_rows("plate", "f1", [row]) == (1, 0)
    again = replace(row, displacement=(-float("nan"), 0, 1e-3, 0, float("nan"), 0))
    assert ledger.insert_rows("plate", "f1", [again]) == (0, 1)
    np.testing.assert_array_equal(ledger.rows("plate")[0].displacement, row.displacement)


@pytest.mark.parametrize(
    "bad",
    [
        replace(ROWS[0], displacement=(float("nan"),) * 6),
        replace(ROWS[0], displacement=(float("inf"), 0, 0, 0, 0, 0)),
        replace(ROWS[0], displacement=(float("nan"), 0, 0, 0, 0, 0), source="fea"),
        replace(ROWS[0], wrench=(1, 2)),
        replace(ROWS[0], compliance=np.full((6, 6), np.inf)),
        replace(ROWS[0], compliance=np.eye(5)),
        replace(ROWS[0], uncertainty=(1, 2, 3)),
    ],
)
def test_one_bad_row_keeps_all_of_them_out(ledger, bad):
    with pytest.raises(ValueError, match=r"wrench|displacement|compliance|uncertainty"):
        ledger.insert_rows("plate", "f1", [*ROWS, bad])
    assert ledger.rows("plate") == []


def test_rows_after_a_seq_and_of_a_fingerprint_are_what_a_follower_reads(ledger):
    ledger.insert_rows("plate", "f1", ROWS[:3])
    seen = ledger.last_seq("plate")
    ledger.insert_rows("bar", "f1", ROWS[:2])
    ledger.insert_rows("plate", "f2", ROWS[3:5])
    assert ledger.last_seq("plate") == ledger.last_seq() > seen
    assert [row.wrench[0] for row in ledger.rows("plate", after=seen)] == [3, 4]
    assert [row.fingerprint for row in ledger.rows("plate", "f1")] == ["f1"] * 3
    assert (ledger.last_seq("spring"), ledger.rows("spring")) == (0, [])


def test_a_job_whose_very_row_was_imported_before_is_done_with_that_row(ledger):
    ledger.insert_rows("plate", "f1", [replace(ROWS[1], source="fea")])
    imported = ledger.rows("plate")[0]
    job, _ = ledger.accept("plate", "f1", ROWS[1].wrench)
    ledger.claim("me")
    assert ledger.commit(job.id, 1, ROWS[1].displacement) == imported
    assert ledger.job(job.id).row == imported.seq
    assert ledger.rows("plate") == [imported]


def test_a_row_that_is_not_there_is_named(ledger):
    with pytest.raises(UnknownRowError, match="no row 3"):
        ledger.row(3)


def test_a_fresh_ledger_beside_older_tables_numbers_its_rows_after_theirs(ledger):
    ledger.start_after(500)
    ledger.start_after(20)
    ledger.insert_rows("plate", "f1", ROWS[:1])
    assert ledger.last_seq() == 501
    ledger.start_after(100)
    ledger.insert_rows("plate", "f1", ROWS[:2])
    assert ledger.last_seq() > 501


def test_the_version_differs_after_own_commits_and_not_after_reading(ledger):
    before = ledger.version()
    ledger.rows("plate")
    ledger.jobs()
    assert ledger.version() == before
    ledger.insert_rows("plate", "f1", ROWS)
    assert ledger.version() != before


def test_a_hundred_thousand_rows_go_in_and_come_out_in_seconds(ledger):
    compliance = np.eye(6).tolist()
    many = [
        NewRow((i, 0, 0, 0, 0, 0), (i * 1e-6, 0, 0, 0, 0, 0), "measured", compliance)
        for i in range(100_000)
    ]
    started = time.monotonic()
    assert ledger.insert_rows("plate", "f1", many) == (100_000, 0)
    assert len(ledger.rows("plate")) == 100_000
    assert time.monotonic() - started < 20


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
