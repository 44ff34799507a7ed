"""kill -9 of processes that import: an import is there as a whole or not at all, each row once.

WRENCHBOOK_KILLS=200 makes a long run of it.
"""

import os
import random
import sqlite3
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from wrenchbook.service.ledger import ImportOrigin, Ledger, NotedRows
from wrenchbook.service.ledger import imports as importing
from wrenchbook.surrogate.table.rows import Rows

ROOT = Path(__file__).parents[2]
KILLS = int(os.environ.get("WRENCHBOOK_KILLS", "10"))
ROWS = 3000
BLOCK = 300


def rows_of(seed: int) -> Rows:
    rng = np.random.default_rng(seed)
    return Rows.of(rng.normal(size=(ROWS, 6)), rng.normal(size=(ROWS, 6)), source=["rig"] * ROWS)


def blocks(seed: int):
    rows = rows_of(seed)
    for start in range(0, ROWS, BLOCK):
        yield NotedRows(rows.take(np.arange(start, start + BLOCK)), ["note"] * BLOCK)


def run(path: str, seed: int) -> None:
    """Import in many short transactions; the program that is killed."""
    importing.ROWS_AT_ONCE = importing.KEYS_AT_ONCE = 150
    sync = Ledger.sync
    Ledger.sync = lambda ledger: (sync(ledger), print("written", flush=True))
    ledger = Ledger(path)
    print("started", flush=True)
    ledger.import_rows("rig", blocks(seed), ImportOrigin())
    print("done", flush=True)
    ledger.close()


def started(path, seed):
    command = [sys.executable, "-m", "tests.service.test_import_killed", str(path), str(seed)]
    process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE)
    assert process.stdout.readline() == b"started\n"
    return process


@pytest.mark.exact("another process makes the same rows")
@pytest.mark.timeout(1800 + 10 * KILLS)
def test_a_killed_import_leaves_nothing_and_each_row_is_there_once(tmp_path):
    path, chance = tmp_path / "ledger.sqlite", random.Random(3)
    ledger = Ledger(path)
    process = started(path, 0)
    written, whole, broken = process.communicate()[0].splitlines(), 1, 0
    assert written[-1] == b"done"
    for seed in range(1, KILLS + 1):
        process = started(path, seed)
        for _ in range(chance.randrange(len(written) + 1)):
            process.stdout.readline()
        process.kill()
        process.communicate()
        before = ledger.count_rows("rig")
        assert before in (whole * ROWS, (whole + 1) * ROWS)
        ledger.drop_abandoned()
        assert ledger.count_rows("rig") == before
        assert len(ledger.imports("rig")) == before // ROWS
        loads = ledger.audit(action="import.load", limit=2 * KILLS + 2)
        assert [int(entry.object) for entry in loads] == [item.id for item in ledger.imports("rig")]
        if before == whole * ROWS:
            broken += 1
            at = np.array(chance.sample(range(ROWS), 7))
            assert ledger.insert_rows("rig", rows_of(seed).take(at), "other") == (7, 0)
            assert ledger.import_rows("rig", blocks(seed), ImportOrigin())[:2] == (ROWS - 7, 7)
        whole += 1
        assert ledger.import_rows("rig", blocks(seed), ImportOrigin()) == (0, ROWS, None)
    print(f"\n{KILLS} kills, {broken} of them in an import")
    present = ledger.row_changes("rig", 0, 10**9).rows
    assert len(present) == len(np.unique(present.wrench, axis=0)) == whole * ROWS
    assert ledger.damaged_rows() == {}
    ledger.close()
    db = sqlite3.connect(path)
    (keys,), (count,) = (
        db.execute(select).fetchone()
        for select in ("SELECT count(*) FROM row_keys", "SELECT sum(count) FROM rows")
    )
    db.close()
    assert keys == count == whole * ROWS


if __name__ == "__main__":
    run(sys.argv[1], int(sys.argv[2]))
