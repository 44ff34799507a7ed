"""A data directory of an earlier version starts without a false alarm and keeps all its rows."""

import json
import logging
import re
import sqlite3
import tarfile
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.service.ledger_rows import stored
from tests.service.live import served
from tests.service.test_durable_tables import Site
from tests.until import until
from wrenchbook.service.demand import DemandMaps
from wrenchbook.service.ledger import Ledger
from wrenchbook.service.ledger.records import LedgerFileError
from wrenchbook.service.library.catalogue import Catalogue
from wrenchbook.service.ops.doctor import examine
from wrenchbook.service.ops.restore import restore
from wrenchbook.service.tables.solver_errors import SolverErrors
from wrenchbook.surrogate.table.hdf5 import read_table, write_table
from wrenchbook.surrogate.table.rows import LoadRange

CHECK = re.compile(r"CHECK(\((?:[^()]|\((?:[^()]|\([^()]*\))*\))*\))")  # with its parentheses
DUMPS = Path(__file__).parent / "earlier"  # of the schemas of these versions


@pytest.fixture(params=["0.2", "0.3", "13"])
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
            assert site.tables.catch_up("rig", 600)
            site.tables.surrogate("rig")
            site.close()
            assert examine(tmp_path, repair=True) is not None  # writes a file that is missing
    return site


def test_the_first_start_says_nothing_of_rows_in_the_table_and_loses_none(site, caplog):
    with caplog.at_level(logging.WARNING):
        site.open()
        assert site.tables.catch_up("rig", 600)
        assert len(site.tables.surrogate("rig").rows) == 5
        assert site.tables.faults() == {}
        assert site.ledger.losses() == []
        site.close()
    assert [record.message for record in caplog.records] == []


def test_a_directory_of_an_earlier_version_keeps_its_rows_jobs_and_answers(site):
    site.open()
    assert site.tables.catch_up("rig", 600)
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
    assert site.tables.catch_up("rig", 600)
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
    with pytest.raises(LedgerFileError, match=r"Start version 0\.2 once"):
        Ledger(path)
    assert path.read_bytes() == before


# -- the state that 0.3 kept in files --------------------------------------------------------------


@pytest.fixture
def directory(tmp_path):
    """A data directory as release 0.3 left it; see earlier/make_directory.py."""
    with tarfile.open(DUMPS / "directory-0.3.tar.xz") as archive:
        archive.extractall(tmp_path, filter="data")
    return tmp_path / "directory-0.3"


RANGE = LoadRange(-np.ones(6), np.ones(6))
STATE = ("library.json", "demand.json", ".demand.lock", "solver_errors")


def test_state_in_files_of_0_3_is_in_the_ledger_after_the_first_start(directory, caplog):
    with caplog.at_level(logging.WARNING), served(directory) as client:
        components = client.call("GET", "/v1/components").json()["components"]
        names = {component["name"] for component in components}
        assert {"bracket", "block"} <= names
        assert "rig" not in names
        rig = client.call("GET", "/v1/components/rig").json()
        assert (rig["notes"], rig["renamed_to"], rig["rows"]) == ("bolts at 20 N m", "bracket", 20)
        assert client.call("GET", "/v1/components/block").json()["copied_from"] == "bar"
        demand = client.call("GET", "/v1/components/rig/demand").json()
        assert [cell["count"] for cell in demand["cells"]] == [2, 1]
        assert (demand["asked"], len(demand["latest"])) == (3, 3)
        query = {"force": [10.0, 0, 0], "moment": [0, 0, 0], "detail": True, "on_thin": "estimate"}
        content, head = json.dumps(query).encode(), {"Content-Type": "application/json"}
        path = "/v1/components/block/displacement"
        answer = client.call("POST", path, content, headers=head).json()
        assert "mesh" in answer["error_parts"]
    assert not [name for name in STATE if (directory / name).exists()]
    assert [record.message for record in caplog.records] == []


def test_files_of_0_3_are_read_once_and_what_the_ledger_has_wins(directory):
    ledger = Ledger(directory / "ledger.sqlite")
    Catalogue(ledger).change("rig", notes="bolts at 25 N m")
    ledger.close()
    old = {"rig": {"notes": "old", "archived": False, "renamed_to": None, "copied_from": None}}
    (directory / "library.json").write_text(json.dumps({**old, "bar": {**old["rig"]}}))
    ledger = Ledger(directory / "ledger.sqlite")
    catalogue = Catalogue(ledger)
    assert catalogue["rig"].notes == "bolts at 25 N m"
    assert catalogue["bar"].notes == "old"
    assert not (directory / "library.json").exists()
    ledger.close()


@pytest.mark.parametrize("name", ["library.json", "demand.json"])
def test_a_damaged_file_of_0_3_is_left_and_keeps_no_other_from_being_read(directory, name, caplog):
    (directory / name).write_text("[1]")
    with closing(Ledger(directory / "ledger.sqlite")) as ledger:
        assert f"{name} of an earlier version cannot be read and is left" in caplog.text
        assert (directory / name).exists()
        asked = DemandMaps(ledger).map_of("rig", RANGE).asked
        assert (asked == 3) == (name != "demand.json")
        assert Catalogue(ledger)["rig"].archived == (name != "library.json")


def test_a_backup_of_0_3_is_restored_with_its_state(directory, tmp_path):
    restore(directory.with_name("backup-0.3.zip"), tmp_path / "data")
    with closing(Ledger(tmp_path / "data" / "ledger.sqlite")) as ledger:
        assert Catalogue(ledger)["rig"].notes == "bolts at 20 N m"
        row = stored(ledger, "block")[0]
        assert SolverErrors(ledger).read("block", row.fingerprint) is not None
    assert not [name for name in STATE if (tmp_path / "data" / name).exists()]


def test_a_ledger_of_0_3_that_is_made_anew_has_the_state_of_the_files(directory):
    path = directory / "ledger.sqlite"
    with path.open("r+b") as file:
        file.seek(20_000)
        file.write(b"\xff" * 20_000)
    assert examine(directory, repair=True) is not None
    with closing(Ledger(path)) as ledger:
        assert Catalogue(ledger)["rig"].notes == "bolts at 20 N m"
        assert DemandMaps(ledger).map_of("rig", RANGE).asked == 3


@pytest.mark.parametrize("asked_since", [False, True])
def test_a_waiting_job_of_0_3_is_asked_again_for_the_setup_that_this_version_has(
    directory, stand_in, asked_since
):
    """A changed mesh made the rows "another setup" and failed the job: `component_changed`."""
    toml = directory / "components" / "block" / "component.toml"
    with closing(sqlite3.connect(directory / "ledger.sqlite")) as db:
        (before,) = db.execute("SELECT fingerprint FROM rows WHERE component = 'block'").fetchone()
        db.execute(
            "INSERT INTO jobs (id, component, fingerprint, wrench, status, priority, attempt, lost,"
            " created) VALUES (77, 'block', ?, ?, 'waiting', 0, 0, 0, 1.0)",
            (before, np.array([20.0, 0, 0, 0, 0, 0]).tobytes()),
        )
        db.commit()
    toml.write_text(re.sub(r"poisson_ratio = 0\.\d+", "poisson_ratio = 0.25", toml.read_text()))
    ids = [77]
    if asked_since:
        with served(directory) as client:
            asked = client.displacement("block", [20.0, 0, 0], on_thin="wait", wait_s=0)
            ids.append(asked.job.id)
    with served(directory, solvers=1) as client:
        until(lambda: {client.job(number).status for number in ids} <= {"done", "cancelled"})
        statuses = [client.job(number).status for number in ids]
        assert statuses == (["cancelled", "done"] if asked_since else ["done"])
    with closing(Ledger(directory / "ledger.sqlite")) as ledger:
        rows = [(row.fingerprint == before, row.wrench[0]) for row in stored(ledger, "block")]
    assert [same for same, _ in rows][:3] == [True, True, False]
    assert rows.count((False, 20.0)) == 1
