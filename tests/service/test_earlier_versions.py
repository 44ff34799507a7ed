"""A data directory of an earlier version starts without a false alarm and keeps all its rows."""

import logging
import re
import sqlite3
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.service.test_durable_tables import Site
from tests.until import until
from wrenchbook.service.ledger import Ledger, LedgerFileError
from wrenchbook.service.ops.doctor import examine
from wrenchbook.surrogate.table.hdf5 import read_table, write_table

CHECK = re.compile(r"CHECK(\((?:[^()]|\((?:[^()]|\([^()]*\))*\))*\))")  # with its parentheses
DUMPS = Path(__file__).parent / "earlier"  # of the schemas of these versions


@pytest.fixture(params=["0.2", "0.3"])
def site(request, tmp_path):
    """A directory of this version; its table file is made from its ledger."""
    site = Site(tmp_path)
    site.open("rig")
    site.close()
    ledger = tmp_path / "ledger.sqlite"
    dump = (DUMPS / f"ledger-{request.param}.sql").read_text()
    for written in (False, True):  # once for the table file, once as that version left it
        for file in tmp_path.glob("ledger.sqlite*"):
            file.unlink()
        db = sqlite3.connect(ledger)
        db.executescript(dump)
        db.close()
        if not written:
            site.open()
            assert site.tables.catch_up("rig", 20)
            site.tables.surrogate("rig")
            site.close()
            assert examine(tmp_path, mend=True) is not None  # writes a file that is missing
    return site


def test_the_first_start_says_nothing_of_rows_in_the_table_and_loses_none(site, caplog):
    with caplog.at_level(logging.WARNING):
        site.open()
        assert site.tables.catch_up("rig", 20)
        assert len(site.tables.surrogate("rig").rows) == 5
        assert site.tables.faults() == {}
        assert site.ledger.losses() == []
        site.close()
    assert [record.message for record in caplog.records] == []


def test_a_directory_of_an_earlier_version_keeps_its_rows_jobs_and_answers(site):
    site.open()
    assert site.tables.catch_up("rig", 20)
    assert site.ledger.count_rows("rig") == 6
    assert [job.status for job in site.ledger.jobs()] == ["waiting"]
    surrogate = site.tables.surrogate("rig")
    assert sorted(surrogate.rows.displacement[:, 0]) == pytest.approx(
        [n * 1e-6 for n in range(1, 6)]
    )
    site.close()
    assert np.isfinite(read_table(site.file())[0].wrench).all()


def test_a_ledger_that_is_older_than_a_file_of_0_1_is_still_doubted(site):
    rows, meta = read_table(site.file())
    write_table(site.file(), rows, replace(meta, edits=None, ledger="", last_seq=20))
    site.open()
    assert site.tables.catch_up("rig", 20)
    site.tables.surrogate("rig")
    assert "withdrawn" in until(lambda: site.tables.faults().get("rig"))
    site.close()


def layout(path):
    """Each table's columns, and the text of its checks and indices, in any order."""
    with sqlite3.connect(path) as db:
        tables = [name for (name,) in db.execute("SELECT name FROM sqlite_schema WHERE sql <> ''")]
        columns = {
            name: {column[1:] for column in db.execute(f"PRAGMA table_info({name})")}
            for name in tables
        }
        texts = db.execute("SELECT type, name, sql FROM sqlite_schema WHERE sql <> ''")
        checks = {
            (kind, name): sorted(CHECK.findall(re.sub(r"[\s\"]", "", sql)))
            for kind, name, sql in texts
        }
    db.close()
    return columns, checks


def test_its_ledger_gets_the_schema_of_a_new_one(site, tmp_path):
    Ledger(tmp_path / "ledger.sqlite").close()
    Ledger(tmp_path / "new.sqlite").close()
    assert layout(tmp_path / "ledger.sqlite") == layout(tmp_path / "new.sqlite")


@pytest.mark.parametrize("version", [1, 7, 10])
def test_a_ledger_before_0_2_is_left_as_it_is_with_the_way_to_take_it_over(tmp_path, version):
    path = tmp_path / "ledger.sqlite"
    with sqlite3.connect(path) as db:
        db.executescript((DUMPS / "ledger-0.2.sql").read_text())
        db.execute(f"PRAGMA user_version = {version}")
    db.close()
    before = path.read_bytes()
    with pytest.raises(LedgerFileError, match=r"start version 0\.2 once"):
        Ledger(path)
    assert path.read_bytes() == before
