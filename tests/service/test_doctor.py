"""The doctor tells what is wrong in clear words, and mends from whichever copy is whole."""

import errno
import os
import random
import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

import pytest
from typer.testing import CliRunner

from tests.service.ledger_rows import claim, new_rows, stored
from tests.service.test_durable_tables import Site
from wrenchbook.service.cli.main import app
from wrenchbook.service.ledger import Ledger
from wrenchbook.service.ops.checks import find_leftovers
from wrenchbook.service.ops.doctor import examine
from wrenchbook.surrogate.table.hdf5 import read_table


@pytest.fixture(scope="module")
def in_order(tmp_path_factory):
    site = Site(tmp_path_factory.mktemp("doctor") / "site")
    site.open("rig", "other")
    site.insert(60)
    site.insert(20, name="other")
    site.ledger.accept_many("rig", "f", [(float(i), 1, 0, 0, 0, 0) for i in range(30)])
    site.close()
    return site.folder


@pytest.fixture
def folder(in_order, tmp_path):
    return shutil.copytree(in_order, tmp_path / "site")


def rows_of(folder):
    ledger = Ledger(folder / "ledger.sqlite")
    result = {
        (name, row.seq, row.wrench, row.displacement)
        for name in ("rig", "other")
        for row in stored(ledger, name)
    }
    ledger.close()
    return result


def content(folder):
    return {item[0:1] + item[2:] for item in rows_of(folder)}


def kinds(findings):
    return {finding.kind for finding in findings}


def words(findings):
    return " | ".join(f"{finding.kind}: {finding.problem} {finding.remedy}" for finding in findings)


def edit(folder, statement):
    db = sqlite3.connect(folder / "ledger.sqlite")
    db.execute(statement)
    db.commit()
    db.close()


def damaged(seq, column="displacement"):
    """A statement that clears the numbers of a row in its record."""
    before, end = (
        f"CAST(substr({column}, {part}) AS BLOB)"
        for part in (f"1, 48 * ({seq} - seq)", f"48 * ({seq} - seq + 1) + 1")
    )
    cleared = f"CAST({before} || zeroblob(48) || {end} AS BLOB)"
    return f"UPDATE rows SET {column} = {cleared} WHERE {seq} BETWEEN seq AND seq + count - 1"


def overwrite(path, first, count):
    content = bytearray(path.read_bytes())
    content[first : first + count] = random.Random(1).randbytes(count)
    path.write_bytes(content)


def test_a_directory_in_order_has_no_findings(folder):
    assert examine(folder) == []
    assert examine(folder, repair=True) == []


def test_a_damaged_row_is_healed_from_its_tables_file_under_its_own_number(folder):
    before = rows_of(folder)
    edit(folder, damaged(7))
    assert len(rows_of(folder)) == len(before) - 1
    result = examine(folder)
    assert "fault: row 7 of rig is damaged" in words(result)
    assert len(rows_of(folder)) == len(before) - 1  # looking changes nothing
    assert "repaired: row 7 of rig" in words(examine(folder, repair=True))
    assert rows_of(folder) == before
    assert kinds(examine(folder)) <= {"note"}


def test_a_healed_row_reaches_a_server_that_had_left_it_out(folder):
    edit(folder, damaged(7))
    keep = folder / "rig.h5"
    (folder / "tables" / "rig.h5").rename(keep)  # the server has to read the ledger
    site = Site(folder)
    site.open()
    assert site.tables.catch_up("rig", 600)
    assert len(site.tables.surrogate("rig").rows) == 59
    shutil.copy(keep, folder / "tables" / "rig.h5")
    assert "repaired" in kinds(examine(folder, repair=True))
    assert site.tables.catch_up("rig", 600)
    assert len(site.tables.surrogate("rig").rows) == 60
    site.close()


def test_a_row_damaged_in_both_places_is_told_and_not_made_up(folder):
    edit(folder, damaged(7, "wrench"))
    overwrite(folder / "tables" / "rig.h5", 3000, 50)
    result = examine(folder, repair=True)
    assert "row 7 of rig is damaged in the ledger no complete table file has it" in words(result)
    assert "fault" in kinds(result)


@pytest.mark.parametrize("damage", ["flipped", "cut", "empty", "another's"])
def test_a_damaged_tables_file_is_moved_aside_and_written_anew_from_the_ledger(folder, damage):
    path = folder / "tables" / "rig.h5"
    before = read_table(path)[0]
    if damage == "flipped":
        overwrite(path, 2000, 1)
    elif damage == "another's":
        shutil.copy(folder / "tables" / "other.h5", path)
    else:
        path.write_bytes(path.read_bytes()[: 1000 * (damage == "cut")])
    broken = path.read_bytes()
    (result,) = examine(folder)  # it was called missing in the same breath
    assert "tables/rig.h5 cannot be used" in result.problem
    assert path.read_bytes() == broken
    assert "repaired" in kinds(examine(folder, repair=True))
    after = read_table(path)[0]
    assert after.displacement.tolist() == before.displacement.tolist()
    (aside,) = (folder / "tables").glob("rig.h5.damaged-*")
    assert aside.read_bytes() == broken
    assert kinds(examine(folder)) == {"note"}


def test_a_missing_tables_file_is_written_from_the_ledger(folder):
    path = folder / "tables" / "rig.h5"
    path.unlink()
    assert "tables/rig.h5 is not there" in words(examine(folder))
    examine(folder, repair=True)
    assert len(read_table(path)[0]) == 60


def test_rows_that_only_a_file_has_are_put_back_into_an_older_ledger(folder):
    shutil.copy(folder / "ledger.sqlite", folder / "older")
    site = Site(folder)
    site.open()
    site.insert(10, first=60)
    site.close()
    before = content(folder)
    shutil.copy(folder / "older", folder / "ledger.sqlite")
    (folder / "older").unlink()
    result = examine(folder)
    assert "do not have the same rows" in words(result)
    assert "acknowledged but are no longer in the ledger" in words(result)
    assert "10 rows put back" in words(examine(folder, repair=True))
    assert content(folder) == before


@pytest.mark.parametrize("damaged", [True, False])
def test_rows_that_no_copy_has_are_counted_and_are_not_in_order(folder, damaged):
    """It settled the loss, said that all was in order, and exited with 0."""
    for path in (folder / "tables").glob("*.h5"):
        path.unlink()
    if damaged:
        overwrite(folder / "ledger.sqlite", 0, 4096)
    else:
        (folder / "ledger.sqlite").unlink()
    result = CliRunner().invoke(app, ["doctor", "--repair", "--data", str(folder)])
    assert result.exit_code == 1
    assert "up to 80 rows" in result.output
    assert "is in order" not in result.output
    again = CliRunner().invoke(app, ["doctor", "--data", str(folder)])
    assert again.exit_code == 0


def test_rows_that_a_server_has_put_back_are_not_counted_as_gone(folder):
    before = content(folder)
    (folder / "ledger.sqlite").unlink()
    site = Site(folder)
    site.open()
    for name in ("rig", "other"):
        assert site.tables.catch_up(name, 600)
    site.close()
    result = examine(folder, repair=True)
    assert content(folder) == before
    assert "up to 0 rows and 30 jobs that were acknowledged are lost" in words(result)


def test_a_log_without_its_ledger_is_never_lost(folder):
    db = sqlite3.connect(folder / "ledger.sqlite")
    db.execute("UPDATE jobs SET priority = 9 WHERE id = 1")
    db.commit()
    log = (folder / "ledger.sqlite-wal").read_bytes()
    db.close()
    (folder / "ledger.sqlite").unlink()
    (folder / "ledger.sqlite-wal").write_bytes(log)
    ledger = Ledger(folder / "ledger.sqlite", patient=True)
    assert "without" in ledger.trouble()
    ledger.close()
    assert "without ledger.sqlite" in words(examine(folder))
    assert (folder / "ledger.sqlite-wal").read_bytes() == log
    examine(folder, repair=True)
    (aside,) = folder.glob("ledger.sqlite-wal.orphan-*")
    assert aside.read_bytes() == log
    assert len(content(folder)) == 80


def test_a_ledger_file_with_damaged_pages_is_made_anew_and_loses_no_row(folder):
    """Each page in turn: what cannot be read comes from the tables' files."""
    path = folder / "ledger.sqlite"
    whole, before, mended = path.read_bytes(), rows_of(folder), 0
    pages = len(whole) // 4096
    for page in range(1, pages, 3):
        for name in folder.glob("ledger.sqlite*"):
            name.unlink()
        path.write_bytes(whole)
        overwrite(path, 4096 * page, 4096)
        result = examine(folder, repair=True)
        if "fault" in kinds(result):
            pytest.fail(f"page {page}: {words(result)}")
        mended += "a new one was created" in words(result)
        assert {item[0:1] + item[2:] for item in before} == content(folder), page
    assert mended > pages // 6


def test_jobs_that_a_damaged_ledger_still_tells_are_in_the_new_one(folder):
    path = folder / "ledger.sqlite"
    db = sqlite3.connect(path)
    page = db.execute("SELECT rootpage FROM sqlite_master WHERE name = 'rows_of_component'")
    number = page.fetchone()[0]
    db.close()
    overwrite(path, 4096 * (number - 1), 4096)
    result = examine(folder, repair=True)
    assert "30 jobs of 30 and" in words(result)
    ledger = Ledger(path)
    assert ledger.counts()["waiting"] == 30
    assert ledger.accept("rig", "f", (99.0, 0, 0, 0, 0, 0))[0].id == 31
    ledger.close()
    assert len(list(folder.glob("ledger.sqlite.damaged-*"))) == 1


def test_a_damaged_ledger_in_use_is_not_replaced(folder):
    from wrenchbook.service.jobs.dispatcher import Lease

    overwrite(folder / "ledger.sqlite", 4096, 8192)
    before = (folder / "ledger.sqlite").read_bytes()
    lease = Lease(folder / "jobs" / "owners")
    assert "stop the server" in words(examine(folder, repair=True))
    lease.close()
    assert (folder / "ledger.sqlite").read_bytes() == before


def test_a_done_job_whose_row_is_nowhere_is_solved_again(folder):
    ledger = Ledger(folder / "ledger.sqlite")
    job = claim(ledger, "me")
    row = ledger.commit(job.id, job.attempt, [1e-6] * 6)
    ledger.close()
    db = sqlite3.connect(folder / "ledger.sqlite")
    db.execute("PRAGMA foreign_keys = OFF")
    db.execute("DELETE FROM rows WHERE seq = ?", (row.seq,))
    db.commit()
    (number,) = db.execute(
        "SELECT rootpage FROM sqlite_master WHERE name = 'jobs_in_turn'"
    ).fetchone()
    db.close()
    overwrite(folder / "ledger.sqlite", 4096 * (number - 1), 4096)
    assert "1 jobs wait again" in words(examine(folder, repair=True))
    ledger = Ledger(folder / "ledger.sqlite")
    assert ledger.job(job.id).status == "waiting"
    ledger.close()


def test_leftovers_are_told_and_left_alone(folder):
    left = [
        folder / "tables" / ".rig.h5.1.tmp",
        folder / "components" / ".incoming-1",
        folder / "jobs" / "4711",
    ]
    for path in left:
        path.mkdir(parents=True)
    result = examine(folder, repair=True)
    assert kinds(result) == {"note"}
    for path in left:
        assert path.name in words(result)
        assert path.exists()


def test_what_else_is_wrong_with_a_folder_is_told(folder, monkeypatch, tmp_path):
    (folder / "components" / "rig" / "component.toml").write_text("name = [")
    assert "component rig cannot be used" in words(examine(folder))
    (folder / f".keys.json.{2**31}.7").touch()  # left by a kill
    assert f".keys.json.{2**31}.7" in words(examine(folder))
    usage = shutil.disk_usage(folder)._replace(free=1000)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage)
    assert "the disk has 0 MB left" in words(examine(folder))
    assert "no data directory" in words(examine(tmp_path / "nowhere"))


def test_a_folder_with_a_number_that_no_job_can_have_is_a_leftover(folder):
    (folder / "jobs" / "99999999999999999999").mkdir(parents=True)
    assert "99999999999999999999" in words(examine(folder))


def test_a_partial_file_of_a_running_process_is_no_leftover(folder, monkeypatch):
    path = folder / f".keys.json.{os.getpid()}.7"
    path.touch()
    monkeypatch.setattr(Path, "exists", lambda _: False)  # macOS has no /proc
    with closing(Ledger(folder / "ledger.sqlite")) as ledger:
        assert path.name not in words(list(find_leftovers(folder, ledger)))


def test_a_file_whose_name_has_a_date_is_no_leftover(folder):
    path = folder / ".backup.20240101.tar"
    path.touch()
    with closing(Ledger(folder / "ledger.sqlite")) as ledger:
        assert path.name not in words(list(find_leftovers(folder, ledger)))


def test_a_foreign_ledger_is_told_and_not_mended(folder):
    path = folder / "ledger.sqlite"
    path.unlink()
    db = sqlite3.connect(path)
    db.execute("CREATE TABLE theirs (x)")
    db.commit()
    db.close()
    before = path.read_bytes()
    assert "another program" in words(examine(folder, repair=True))
    assert path.read_bytes() == before


def test_the_doctor_mends_rows_while_the_directory_is_in_use(folder):
    site = Site(folder)
    site.open()
    edit(folder, damaged(7))
    site.insert(10, first=60)
    assert "repaired: row 7" in words(examine(folder, repair=True))
    site.insert(10, first=70)
    assert len(site.wrenches()) == len(new_rows(80))
    site.close()
    assert kinds(examine(folder)) <= {"note"}


def test_a_ledger_that_was_cut_off_gives_the_jobs_of_the_pages_that_are_left(folder):
    ledger = Ledger(folder / "ledger.sqlite")
    ledger.accept_many("rig", "f", [(float(i), 2, 0, 0, 0, 0) for i in range(2000)])
    ledger.close()
    path = folder / "ledger.sqlite"
    with path.open("r+b") as file:
        file.truncate(path.stat().st_size * 3 // 4)
    before = content(folder) if not examine(folder, repair=True) else None
    ledger = Ledger(path)
    assert before is None
    assert ledger.count_rows("rig") == 60
    assert len(ledger.jobs(limit=3000)) > 500
    ledger.close()


@pytest.mark.parametrize("empty", [True, False])
def test_a_missing_or_empty_ledger_is_made_from_the_tables(folder, empty):
    before, path = content(folder), folder / "ledger.sqlite"
    path.unlink()
    if empty:
        path.touch()
    said = "ledger.sqlite is empty" if empty else "there is no ledger.sqlite"
    assert said in words(examine(folder))
    assert path.exists() == empty
    examine(folder, repair=True)
    assert content(folder) == before


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("keys.json", "nobody can log in"),
        ("wrenchbook.toml", "cannot be read as TOML"),
        ("fields/rig/f/a.fields", "its surface comes from the others"),
    ],
)
def test_a_damaged_file_beside_the_ledger_is_told(folder, name, said):
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("{[")
    result = examine(folder)
    assert kinds(result) == {"fault"}
    assert said in words(result)
    after = examine(folder, repair=True)
    own = name in ("keys.json", "wrenchbook.toml")
    assert ("fault" in kinds(after)) == own
    assert path.exists() == own


@pytest.mark.parametrize("damaged", ["ledger.sqlite", "tables/rig.h5"])
def test_a_repair_on_a_full_disk_says_so_and_loses_nothing(folder, monkeypatch, damaged):
    """It ended by the bare error of the system, without a word on what had been repaired."""
    before = content(folder)
    path = folder / damaged
    overwrite(path, 4096 if damaged == "ledger.sqlite" else 2000, 4000)

    def full(*_, **__):
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr("wrenchbook.service.ops.doctor.shutil.copyfile", full)
        patched.setattr("wrenchbook.service.tables.store.write_table", full)
        result = examine(folder, repair=True)
    assert "fault" in kinds(result)
    assert "No space left on device" in words(result)
    assert "make room" in words(result)
    assert "fault" not in kinds(examine(folder, repair=True))
    assert content(folder) == before


def test_rows_that_neither_copy_has_are_told_as_lost_and_not_as_mended(folder):
    """It said that all was in order, and that the ledger had the rows."""
    overwrite(folder / "ledger.sqlite", 0, 4096)
    (folder / "tables" / "rig.h5").write_bytes(b"")
    results = examine(folder, repair=True)
    lost, table = [result for result in results if result.kind == "fault"]
    assert lost.problem == "up to 60 rows that were acknowledged are lost"
    assert "tables/rig.h5" in table.problem
    assert all("restore a backup" in item.remedy for item in (lost, table))
    assert "jobs that were lost: 30" in words(results)
