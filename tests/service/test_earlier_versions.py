"""A data directory of an earlier version starts without a false alarm and keeps all its rows."""

import logging
import sqlite3
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from tests.service.test_durable_tables import Site
from wrenchbook.service.ops.doctor import examine
from wrenchbook.surrogate.table.hdf5 import read_table, write_table

DUMPS = Path(__file__).parent / "earlier"  # of the schemas of these versions
ROWS = {"0.1": 6, "0.2": 5}  # in the table
UNKNOWN = {"0.1": ("ledger", "linear", "off_axis", "locked"), "0.2": ()}  # to files of a version


def table_file_of(version, path):
    """Write a table file again as a version wrote it."""
    if version != "0.1":
        return
    rows, meta = read_table(path)
    write_table(path, rows, replace(meta, schema_version=1, edits=None, ledger=""))
    plain = path.with_suffix(".plain")
    with h5py.File(path) as file, h5py.File(plain, "w") as old:  # without a digest
        for name in file:
            file.copy(name, old)
        old.attrs.update({k: v for k, v in file.attrs.items() if k not in UNKNOWN[version]})
    plain.replace(path)


@pytest.fixture(params=["0.1", "0.2"])
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
            table_file_of(request.param, site.file())
    site.rows = ROWS[request.param]
    return site


def test_rows_withdrawn_may_be_in_the_table_again_after_the_first_start(site, caplog):
    """It was said of each component of a directory of version 0.1, of which no row was amiss."""
    with caplog.at_level(logging.WARNING):
        site.open()
        assert site.tables.catch_up("rig", 20)
        assert len(site.tables.surrogate("rig").rows) == site.rows
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
        [n * 1e-6 for n in range(1, 1 + site.rows)]
    )
    site.close()
    assert np.isfinite(read_table(site.file())[0].wrench).all()


def test_a_ledger_that_is_older_than_a_file_of_0_1_is_still_doubted(site):
    rows, meta = read_table(site.file())
    write_table(site.file(), rows, replace(meta, edits=None, ledger="", last_seq=20))
    site.open()
    assert site.tables.catch_up("rig", 20)
    site.tables.surrogate("rig")
    assert "withdrawn" in site.tables.faults()["rig"]
    site.close()
