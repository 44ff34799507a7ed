"""Large imports: taken in by short transactions, hidden until the last, gone if it never comes."""

import threading

import numpy as np
import pytest

from tests.service.ledger_rows import NewRow, claim, insert, noted, stored
from wrenchbook.service.ledger import (
    ImportOrigin,
    Ledger,
    NotedRows,
    UnknownImportError,
    UnknownRowError,
    imports,
    row_keys,
    rows,
)
from wrenchbook.service.ledger.packing import content_key, pack_vector, records_of
from wrenchbook.surrogate.table.rows import Rows

SOLVE = ("plate", "f1", (1.0, 0, 0, 0, 0, 0))


def columns(count, seed=1):
    rng = np.random.default_rng(seed)
    return (
        rng.normal(size=(count, 6)),
        rng.normal(size=(count, 6)) * 1e-4,
        np.full((count, 6), np.nan),
        np.full((count, 6, 6), np.nan),
    )


def blocks(count, seed=1, lots=3):
    for index in range(lots):
        wrench, moved, *_ = columns(count, seed * 100 + index)
        yield NotedRows(Rows.of(wrench, moved, source=["measured"] * count), ["note"] * count)


class KilledError(BaseException):
    """What a test throws into an import."""


def test_rows_of_a_block_have_the_bytes_of_rows_that_come_alone():
    rng = np.random.default_rng(2)
    wrench, moved, doubt, tangent = columns(40)
    wrench[3, 2] = -0.0
    moved[rng.random((40, 6)) < 0.3] = np.nan
    moved[:, 0] = 1e-5
    doubt[:20, 1] = 1e-6
    tangent[10:30] = rng.normal(size=(20, 6, 6))
    table = Rows.of(
        wrench,
        moved,
        uncertainty=doubt,
        compliance=tangent,
        source=["measured", "rig 2"] * 20,
        fingerprint=["f"] * 40,
    )
    notes = [f"line {at}" for at in range(40)]
    keys = row_keys("rig", NotedRows(table, notes))
    alone = [
        next(records_of("rig", block, row_keys("rig", block), 100 + at, 5.0))
        for at in range(40)
        for block in [NotedRows(table.take(np.array([at])), [notes[at]])]
    ]
    assert list(records_of("rig", NotedRows(table, notes), keys, 100, 5.0)) == alone
    row = alone[12]
    parts = *(text.encode() for text in ("rig", "f", "measured")), row.wrench, row.displacement
    assert row.key == content_key(*parts, row.uncertainty)
    assert row.seal == content_key(row.key, row.compliance, b"line 12")
    assert alone[3].wrench == pack_vector(table.wrench[3].tolist())
    assert (alone[35].compliance, alone[35].uncertainty) == (None, None)
    together = NotedRows(table.take(np.arange(0, 40, 2)), ["note"] * 20)
    (record,) = records_of("rig", together, keys[::2], 100, 5.0)
    assert record.key == b"".join(item.key for item in alone[::2])
    assert record.sound() == [True] * 20
    for at in range(20):
        single = alone[2 * at]._replace(seq=100 + at, origin="note")
        assert repr(record.row(100 + at)) == repr(single.row(100 + at))


@pytest.mark.parametrize("killed", [False, True])
def test_each_version_during_an_import_is_one_that_the_table_had(ledger, monkeypatch, killed):
    """Rows of another component lie between; after each transaction a reader and a file agree."""
    insert(ledger, "rig", "", [NewRow((at + 1.0,) * 6, (0.0,) * 6) for at in range(4)])
    ledger.withdraw("rig", 2)
    insert(ledger, "bar", "", [NewRow((at + 1.0,) * 6, (0.0,) * 6) for at in range(3)])
    assert (ledger.last_seq("rig"), ledger.last_seq("bar")) == (5, 8)
    live, versions, shown, after = {1, 3, 4}, [], set(), 0

    def look():
        nonlocal after
        version = ledger.last_seq("rig")
        assert len(stored(ledger, "rig")) == len(live)
        with ledger.table_at("rig", version) as table:
            assert {seq for lot in table.lots for seq in lot.rows.seq} == live
        changes = ledger.row_changes("rig", after)
        shown.difference_update(changes.edited)
        assert shown.isdisjoint(changes.rows.seq.tolist())
        shown.update(changes.rows.seq.tolist())
        assert (shown, changes.last_seq) == (live, version)
        after = version
        versions.append(version)

    def blocks_and_others():
        for lot, block in enumerate(blocks(20)):
            yield block
            look()
            insert(ledger, "bar", "", [NewRow((lot + 9.0,) * 6, (0.0,) * 6)])
            look()
            insert(ledger, "rig", "", [NewRow((lot + 9.0,) * 6, (0.0,) * 6)])
            ledger.withdraw("bar", 6 + lot)
            look()
        if killed:
            raise KilledError

    drop = rows.delete_hidden

    def delete(*arguments):
        versions.append(rows.last_seq(arguments[0], "rig"))
        return drop(*arguments)

    monkeypatch.setattr(rows, "delete_hidden", delete)
    look()
    if killed:
        monkeypatch.setattr(imports, "RECORDS_DELETED", 1)
        with pytest.raises(KilledError):
            ledger.import_rows("rig", blocks_and_others(), ImportOrigin())
    else:
        ledger.import_rows("rig", blocks_and_others(), ImportOrigin())
    assert len(versions) > 9
    assert set(versions) == {5}
    live = {row.seq for row in stored(ledger, "rig")}
    assert len(live) == 3 + 3 + 60 * (not killed)
    look()
    assert versions[-1] == max(live)
    assert ledger.digest("rig", after) == ledger.digest("rig", 10**9)


def test_an_import_that_runs_is_not_taken_for_abandoned(tmp_path, ledger):
    other = Ledger(tmp_path / "ledger.sqlite")

    def watched():
        for block in blocks(30):
            yield block
            other.drop_abandoned()
            assert (ledger.count_rows("rig"), ledger.last_seq("rig")) == (0, 0)
            with pytest.raises(UnknownRowError):  # it is hidden until the end
                ledger.row(20)

    assert ledger.import_rows("rig", watched(), ImportOrigin())[:2] == (90, 0)
    assert other.count_rows("rig") == 90
    other.close()


def test_a_row_that_somebody_else_brings_meanwhile_stays_though_the_import_ends(ledger):
    block = next(blocks(10))
    wrench, moved, *_ = columns(10, 100)

    def broken():
        yield block
        same = NewRow(wrench[4].tolist(), moved[4].tolist(), "measured", origin="note")
        assert insert(ledger, "rig", "", [same]) == (1, 0)
        raise KilledError

    with pytest.raises(KilledError):
        ledger.import_rows("rig", broken(), ImportOrigin())
    (left,) = stored(ledger, "rig")
    assert left.wrench == tuple(wrench[4])


@pytest.mark.parametrize("when", ["before its keys", "after its keys"])
def test_a_row_that_another_writer_brings_during_an_import_is_there_once(ledger, monkeypatch, when):
    created = next(blocks(10)).rows
    wrench, moved = created.wrench, created.displacement
    same = NewRow(wrench[4].tolist(), moved[4].tolist(), "measured", origin="note")
    enter = rows.insert_keys

    def entered(db, entries):
        enter(db, entries)
        monkeypatch.undo()
        if when == "after its keys":
            block = noted([same])
            counts = rows.insert(db, "rig", block, row_keys("rig", block), 5.0)
            assert counts == (1, 0)

    def watched():
        yield from blocks(10, lots=1)
        if when == "before its keys":
            assert insert(ledger, "rig", "", [same]) == (1, 0)

    monkeypatch.setattr(rows, "insert_keys", entered)
    new, known, number = ledger.import_rows("rig", watched(), ImportOrigin())
    assert (new, known, ledger.imports("rig")[0].rows) == (9, 1, 9)
    present = stored(ledger, "rig")
    assert sorted(row.wrench for row in present) == sorted(map(tuple, wrench.tolist()))
    assert ledger.import_rows("rig", blocks(10, lots=1), ImportOrigin()) == (0, 10, None)
    assert ledger.count_rows("rig") == 10
    with pytest.raises(UnknownImportError, match=f"no import 99; its newest imports are {number}"):
        ledger.edit_import("rig", 99, withdrawn=True)
    with pytest.raises(UnknownImportError, match=f"import {number} .* has no findings"):
        ledger.edit_import("rig", number, "x", withdrawn=True)
    assert ledger.edit_import("rig", number, withdrawn=True) == 9
    assert [row.origin for row in stored(ledger, "rig")] == ["note"]


def test_numbers_of_rows_follow_the_file_and_no_number_is_used_by_known_rows(ledger):
    wrench, moved, *_ = columns(2500)
    block = NotedRows(Rows.of(wrench, moved, source=["measured"] * 2500), ["note"] * 2500)
    wrench, moved = block.rows.wrench, block.rows.displacement
    ledger.import_rows("rig", [block], ImportOrigin())
    present = stored(ledger, "rig")
    assert [row.seq for row in present] == list(range(1, 2501))
    assert [row.wrench for row in present] == list(map(tuple, wrench.tolist()))
    for _ in range(3):
        assert ledger.import_rows("rig", [block], ImportOrigin()) == (0, 2500, None)
        assert insert(ledger, "rig", "", [NewRow(wrench[7], moved[7], origin="x")]) == (0, 1)
    assert ledger.last_seq("rig") == 2500
    assert insert(ledger, "rig", "", [NewRow((9.0,) * 6, (0.0,) * 6)]) == (1, 0)
    assert ledger.last_seq("rig") == 2501


def test_two_imports_at_once_come_one_after_the_other(ledger):
    done = []

    def run(seed):
        done.append(ledger.import_rows("rig", blocks(40, seed=seed), ImportOrigin(str(seed)))[0])

    threads = [threading.Thread(target=run, args=(seed,)) for seed in (1, 2, 3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(600)
    assert done == [120, 120, 120]
    spans = ledger.import_spans("rig")
    assert sum(last - first + 1 for first, last, _ in spans) == 360


def test_a_row_tells_who_brought_it(ledger):
    ledger.import_rows("rig", blocks(5), ImportOrigin("kl", "a.csv", "csv", "ab12", "run 3"))
    first = stored(ledger, "rig")[0]
    reported = ledger.import_of(first.seq)
    assert (reported.who, reported.filename, reported.digest, reported.note, reported.rows) == (
        *("kl", "a.csv", "ab12", "run 3"),
        15,
    )
    job, _ = ledger.accept(*SOLVE)
    claim(ledger, "me")
    row = ledger.commit(job.id, 1, (0.0,) * 6)
    assert ledger.import_of(row.seq) is None


def test_known_rows_are_those_in_the_ledger_by_their_keys(ledger):
    first, second, third = blocks(5)
    ledger.import_rows("rig", [first], ImportOrigin())
    keys = [key for block in (first, second, second, third) for key in row_keys("rig", block)]
    assert ledger.known_rows(keys).keys() == set(row_keys("rig", first))


def test_each_part_of_an_import_is_on_the_disk_before_the_next_begins(ledger, monkeypatch):
    """Else the next durable transaction, which is somebody else's, waits for all of them."""
    reported, sync = [], Ledger.sync

    def heard(self):
        with self.writing():  # nobody holds the ledger meanwhile
            reported.append("synced")
        sync(self)

    monkeypatch.setattr(Ledger, "sync", heard)
    assert ledger.import_rows("rig", blocks(5), ImportOrigin())[:2] == (15, 0)
    assert len(reported) == 4  # three blocks, and the keys
