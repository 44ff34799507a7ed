"""A replica has all that was committed, restores to the same answers and feeds other servers."""

import errno
import json
import os
import shutil
import signal
import threading
import time
from contextlib import closing
from pathlib import Path

import pytest
from starlette.testclient import TestClient
from typer.testing import CliRunner

from tests.service.test_backup import answers
from tests.service.test_durable_tables import Site
from tests.until import until
from wrenchbook.service.cli.main import app
from wrenchbook.service.http.app import create_app
from wrenchbook.service.keys import Keyring
from wrenchbook.service.ledger import Ledger
from wrenchbook.service.ledger.earlier import CATALOGUE
from wrenchbook.service.ops import replica
from wrenchbook.service.ops.backup import BackupError
from wrenchbook.service.ops.doctor import examine
from wrenchbook.service.ops.replica import Replica, ReplicaError, Shipper, stays
from wrenchbook.service.ops.restore import restore
from wrenchbook.service.settings import Settings
from wrenchbook.service.workers import copier
from wrenchbook.service.workers.follower import Follower


class Shipped:
    """A data directory with 30 rows, its replica, and what ships to it."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.url = folder / "site", f"file://{folder}/replica"
        self.site = Site(self.folder)
        self.site.open("rig")
        self.insert(30)
        self.settings = Settings(self.folder, replicate=self.url, replicate_interval=3600.0)
        self.shipper = self.new_shipper()

    def insert(self, count, first=0):
        self.site.insert(count, first=first)
        assert self.site.tables.catch_up("rig", 600)

    def new_shipper(self):
        return Shipper(self.settings, self.site.ledger)

    def round(self):
        self.shipper.round()
        return Replica(self.url).newest()


@pytest.fixture
def shipped(tmp_path):
    shipped = Shipped(tmp_path)
    yield shipped
    shipped.site.close()


def test_a_restored_replica_has_the_answers_and_jobs_of_the_lost_directory(shipped, tmp_path):
    shipped.site.ledger.accept("rig", "f", (1.0, 0, 0, 0, 0, 0))
    shipped.round()
    shipped.insert(5, first=30)
    assert shipped.round().rows == 35
    lines = CliRunner().invoke(app, ["restore", shipped.url, "--data", str(tmp_path / "again")])
    assert "35 rows, up to number 35, and 1 job" in lines.output
    assert answers(tmp_path / "again") == answers(shutil.copytree(shipped.folder, tmp_path / "b"))
    assert [finding for finding in examine(tmp_path / "again") if finding.kind == "fault"] == []


def test_a_replica_holds_no_keys_settings_and_drafts(shipped, tmp_path):
    Keyring(shipped.folder).add("ops", "admin")
    for name in ("wrenchbook.toml", "stranger.txt", "tables/.rig.h5.abc.tmp"):
        (shipped.folder / name).write_text("solvers = 0")
    files = Replica(shipped.url).files(shipped.round())
    tables = {f"tables/{path.name}" for path in (shipped.folder / "tables").glob("rig*")}
    assert set(files) == {"ledger.sqlite", "components/rig/component.toml", *tables}
    assert (tmp_path / "replica").stat().st_mode & 0o077 == 0


def test_a_round_without_changes_writes_the_pointer_alone_and_a_row_few_blocks(shipped):
    shipped.round()
    before = shipped.shipper.facts["bytes"]
    number = shipped.round().number
    assert shipped.shipper.facts["bytes"] - before < 200
    assert number == shipped.new_shipper()._number == 1


def test_a_replica_whose_manifest_was_cut_off_restores_to_the_one_before(shipped, tmp_path):
    shipped.round()
    shipped.insert(5, first=30)
    shipped.round()
    path = tmp_path / "replica" / shipped.shipper._latest
    path.write_bytes(path.read_bytes()[:-20])
    assert Replica(shipped.url).newest().rows == 30
    assert shipped.new_shipper()._number == 2


def test_a_damaged_block_is_not_restored(shipped, tmp_path):
    digest = shipped.round().ledger[1][0]
    path = tmp_path / "replica" / "blocks" / digest[:2] / digest
    path.write_bytes(b"\0" + path.read_bytes()[1:])
    with pytest.raises(
        ReplicaError, match="missing or damaged; restore an earlier time with --at, or"
    ):
        restore(shipped.url, tmp_path / "again")
    assert not (tmp_path / "again").exists()


def test_a_file_that_no_replica_holds_is_not_restored(shipped, tmp_path):
    shipped.shipper._files["../keys.json"] = (0, ())
    shipped.round()
    with pytest.raises(ReplicaError, match="must not hold"):
        restore(shipped.url, tmp_path / "again")


@pytest.mark.parametrize(
    "change",
    [
        {"interval": float("nan")},
        {"interval": -1.0},
        {"created": "x"},
        {"ledger": [0, []]},
        {"ledger": [10**15, ["0" * 40]]},
        {"ledger": [4, ["/../../../../../dev/zero"]]},
        {"files": [4, [5]]},
    ],
)
def test_a_manifest_with_values_that_cannot_be_is_damaged(shipped, tmp_path, change):
    manifest = {**vars(shipped.round()), **change}
    content = json.dumps(manifest).encode()
    (tmp_path / "replica" / shipped.shipper._latest).unlink()
    (tmp_path / "replica" / replica._name(1, content)).write_bytes(content)
    with pytest.raises(ReplicaError, match="is damaged"):
        restore(shipped.url, tmp_path / "again")
    assert not (tmp_path / "again").exists()


@pytest.mark.parametrize("entry", [7, [10**15, ["0" * 40]], [4, ["../x"]], [4, [5]], [[4], "a"]])
def test_a_file_whose_blocks_cannot_be_is_not_restored(shipped, tmp_path, entry):
    shipped.shipper._files[CATALOGUE] = entry
    shipped.round()
    with pytest.raises(ReplicaError, match="is damaged"):
        restore(shipped.url, tmp_path / "again")


def test_an_earlier_program_does_not_restore_the_state_before_an_upgrade(
    shipped, tmp_path, monkeypatch
):
    shipped.round()
    shipped.insert(5, first=30)
    monkeypatch.setattr(replica, "VERSION", replica.VERSION + 1)
    shipped.settings = Settings(shipped.folder, replicate=shipped.url)
    manifest = shipped.round()
    path = tmp_path / "replica" / shipped.shipper._latest
    content = json.dumps({**vars(manifest), "ledger_schema": replica.VERSION}).encode()
    path.unlink()
    (tmp_path / "replica" / replica._name(2, content)).write_bytes(content)
    monkeypatch.undo()
    with pytest.raises(BackupError, match="install the version that wrote it"):
        restore(shipped.url, tmp_path / "again")


def test_a_replica_that_was_away_is_trouble_and_whole_once_it_is_back(shipped, tmp_path):
    shipped.round()
    place, away = tmp_path / "replica", tmp_path / "away"
    place.rename(away)
    shipped.insert(5, first=30)
    with pytest.raises(ReplicaError, match="another program changed"):
        shipped.round()
    shutil.rmtree(place)
    with pytest.raises(ReplicaError, match="is now empty; mount it, or"):
        Shipper(shipped.settings, shipped.site.ledger, again=True)
    place.rmdir()
    away.rename(place)
    shipped.shipper = Shipper(shipped.settings, shipped.site.ledger, again=True)
    shipped.round()
    restore(shipped.url, tmp_path / "again")
    assert answers(tmp_path / "again") == answers(shutil.copytree(shipped.folder, tmp_path / "b"))


def test_blocks_that_are_gone_are_shipped_again(shipped, tmp_path):
    shipped.round()
    for path in (tmp_path / "replica" / "blocks").glob("*/*"):
        path.unlink()
    shipped.shipper = shipped.new_shipper()
    shipped.insert(5, first=30)
    shipped.round()
    assert restore(shipped.url, tmp_path / "again")[0].state["rows"] == 35


def test_a_first_round_that_was_cut_off_is_begun_again(shipped, tmp_path):
    shipped.round()
    path = tmp_path / "replica" / shipped.shipper._latest
    path.write_bytes(path.read_bytes()[:-20])
    (tmp_path / "replica" / replica.LATEST).unlink()
    (tmp_path / "replica" / "manifests" / "@eaDir").mkdir()
    (tmp_path / "replica" / "manifests" / "@eaDir" / "x").touch()  # of the disk's own
    shipped.shipper = shipped.new_shipper()
    assert shipped.round().number == 2


def test_a_restore_leaves_the_last_use_of_keys(shipped, tmp_path):
    shipped.round()
    keyring = Keyring(tmp_path / "again")
    key = keyring.find(keyring.add("ann", "read"))
    keyring.note_use(key, 0.0)
    restore(shipped.url, tmp_path / "again")
    assert keyring.last_use(key) is not None


def test_reading_makes_no_folder(tmp_path):
    with pytest.raises(ReplicaError, match="has no copy of a data directory; check the URL"):
        restore(f"file://{tmp_path}/typo", tmp_path / "again")
    assert not (tmp_path / "typo").exists()


def test_another_directory_does_not_ship_to_the_same_url(shipped):
    shipped.round()
    (shipped.folder / replica.ORIGIN).unlink()
    with pytest.raises(ReplicaError, match="of another data directory"):
        shipped.new_shipper()


def test_old_manifests_go_with_the_blocks_that_no_other_needs(shipped, tmp_path, monkeypatch):
    monkeypatch.setattr(replica, "KEEP_S", ())
    shipped.round()
    shipped.insert(5, first=30)
    newest = shipped.round()
    shipped.shipper.collect()
    files = Replica(shipped.url).files(newest).values()
    needed = {digest for _, blocks in (*files, newest.files) for digest in blocks}
    assert {path.name for path in (tmp_path / "replica" / "blocks").glob("*/*")} == needed
    assert len(list((tmp_path / "replica" / "manifests").iterdir())) == 1


def test_a_manifest_with_a_damaged_file_list_takes_no_good_one_with_it(
    shipped, tmp_path, monkeypatch
):
    monkeypatch.setattr(replica, "KEEP_S", ((600.0, 60.0),))
    shipped.round()
    good = shipped.shipper._latest
    shipped.insert(5, first=30)
    (digest,) = shipped.round().files[1]
    (tmp_path / "replica" / "blocks" / digest[:2] / digest).unlink()
    shipped.shipper.collect()
    assert Replica(shipped.url).manifests() == [good]


def test_manifests_stay_for_ten_minutes_then_by_the_hour_and_the_day():
    kept = []
    for created in range(10 * 86_400, 0, -60):
        if stays(created, kept):
            kept.append(created)
    ages = [kept[0] - created for created in kept]
    assert ages[:12] == [60 * n for n in range(11)] + [600 + 3600]
    assert ages[-1] == ages[-2] + 86_400 <= 7 * 86_400


def test_surfaces_that_take_too_long_wait_for_the_next_round_and_rows_do_not(shipped, tmp_path):
    folder = shipped.folder / "fields" / "rig" / "f"
    folder.mkdir(parents=True)
    (folder / "1.fields").write_bytes(os.urandom(100))
    shipped.shipper._settings = Settings(
        shipped.folder, replicate=shipped.url, replicate_interval=1e-9
    )
    assert shipped.round().rows == 30
    assert shipped.shipper.facts["files_behind"] > 0
    shipped.shipper._settings = shipped.settings
    assert "fields/rig/f/1.fields" in Replica(shipped.url).files(shipped.round())


def test_any_storage_of_fsspec_takes_a_replica(shipped, tmp_path):
    shipped.settings = Settings(shipped.folder, replicate="memory://replica")
    shipped.shipper, shipped.url = shipped.new_shipper(), "memory://replica"
    shipped.round()
    restore("memory://replica", tmp_path / "again")
    assert answers(tmp_path / "again") == answers(shutil.copytree(shipped.folder, tmp_path / "b"))


# -- read-only servers ---------------------------------------------------------------------------


@pytest.fixture
def reader(shipped, tmp_path):
    """Settings and follower of a directory elsewhere."""
    settings = Settings(tmp_path / "reader", solvers=0, read_only=shipped.url)
    settings.data.mkdir()
    with closing(Ledger(settings.data / "ledger.sqlite")) as ledger:
        yield settings, Follower(settings, ledger)


def test_a_follower_has_the_rows_and_tables_of_each_manifest(shipped, reader):
    settings, follower = reader
    for count in (30, 35):
        shipped.insert(count, first=0)
        shipped.round()
        manifest, _ = follower.follow()
        with closing(Ledger(settings.data / "ledger.sqlite")) as ledger:
            assert ledger.count_rows("rig") == manifest.rows == count
        (table,) = (settings.data / "tables").iterdir()
        assert table.read_bytes() == (shipped.folder / "tables" / table.name).read_bytes()


def test_a_follower_keeps_a_table_until_its_next_version_is_there(shipped, reader):
    settings, follower = reader
    shipped.round()
    follower.follow()
    for path in (shipped.folder / "tables").glob("*.wbt"):
        path.unlink()
    shipped.round()
    follower.follow()
    assert len(list((settings.data / "tables").iterdir())) == 1


@pytest.mark.parametrize(
    ("path", "body"),
    [
        ("fill", {"budget": 1}),
        ("displacement", {"force": [1, 2, 3], "moment": [0, 0, 0]}),
    ],
)
def test_a_read_only_server_refuses_writes_and_names_the_main_server(tmp_path, path, body):
    replica.write_status(tmp_path, followed={"server": "https://main", "checked": 0.0})
    settings = Settings(tmp_path, solvers=0, read_only="file:///replica")
    with TestClient(create_app(settings)) as http:
        reply = http.post(f"/v1/components/plate_thin/{path}", json=body)
        assert (reply.status_code, reply.json()["type"].rpartition(":")[2]) == (403, "read-only")
        assert reply.json()["detail"].endswith("Send it to https://main")
        keys = http.post("/v1/keys", json={"name": "ann"}).json()
        assert "Change its keys on its machine: wrenchbook keys --data " in keys["detail"]
        estimate = {"force": [1, 2, 3], "moment": [0, 0, 0], "on_thin": "estimate"}
        answer = http.post("/v1/components/plate_thin/displacement", json=estimate)
        assert answer.status_code == 200


@pytest.mark.parametrize("path", ["/v1/rigs/displacement", "/v1/keys/displacement"])
def test_a_read_only_server_deletes_nothing_that_is_named_as_a_call(tmp_path, path):
    replica.write_status(tmp_path, followed={"server": "https://main", "checked": 0.0})
    settings = Settings(tmp_path, solvers=0, read_only="file:///replica")
    with TestClient(create_app(settings)) as http:
        reply = http.delete(path)
        assert (reply.status_code, reply.json()["type"].rpartition(":")[2]) == (403, "read-only")


# -- the process ---------------------------------------------------------------------------------


@pytest.mark.parametrize("year", [2020, 2999])
def test_a_scheduled_backup_is_tested_by_its_restore_and_old_ones_go(shipped, tmp_path, year):
    """Backups of a clock that was ahead stopped all others, and new ones went before them."""
    folder, stop = tmp_path / "backups", threading.Event()
    folder.mkdir()
    for number in range(3):
        old = folder / f"wrenchbook-{year}010{number}T000000Z.wbb"
        old.touch()
        os.utime(old, ((year - 1970) * 31_556_952,) * 2)
    settings = Settings(shipped.folder, backup_every=1.0, backup_folder=folder, backup_keep=2)
    thread = threading.Thread(target=copier.make_backups, args=(settings, stop))
    thread.start()
    status = until(lambda: replica.read_status(shipped.folder).get("backup"))
    stop.set()
    thread.join()
    assert (status["trouble"], status["tested"]) == (None, True)
    kept = {path.name for path in folder.iterdir()}
    assert kept == {f"wrenchbook-{year}0102T000000Z.wbb", status["file"]}


def test_backups_go_on_after_an_outcome_that_could_not_be_noted(shipped, tmp_path, monkeypatch):
    """The thread ended where the outcome could not be written, and no backup came any more."""
    calls, stop, done = [], threading.Event(), copier.write_status

    def full_once(*arguments, **options):
        calls.append(arguments)
        if len(calls) == 1:
            raise OSError(errno.ENOSPC, "No space left on device")
        return done(*arguments, **options)

    monkeypatch.setattr(copier, "write_status", full_once)
    monkeypatch.setattr(copier, "POLL_S", 0.0)
    settings = Settings(shipped.folder, backup_every=1e-9, backup_folder=tmp_path / "backups")
    thread = threading.Thread(target=copier.make_backups, args=(settings, stop), daemon=True)
    thread.start()
    until(lambda: len(calls) > 1 or not thread.is_alive())
    stop.set()
    thread.join()
    assert len(calls) > 1


def test_a_backup_that_does_not_restore_is_no_backup_and_health_and_doctor_say_so(
    shipped, tmp_path, monkeypatch
):
    monkeypatch.setattr(copier, "examine", lambda _: [replica_fault()])
    (tmp_path / "wrenchbook-20200101T000000Z.failed").touch()
    with pytest.raises(RuntimeError, match="1 fault, first: rows are gone"):
        copier.tested_backup(shipped.folder, tmp_path)
    assert not list(tmp_path.glob("*.wbb"))
    (failed,) = tmp_path.glob("*.failed")  # a retry a minute later filled the disk with them
    assert failed.stat().st_size > 0


def test_a_backup_has_its_name_only_once_it_has_been_tested(shipped, tmp_path, monkeypatch):
    """An untested one counted as the newest backup, and a kill left it and the restored folder."""
    named = []

    def examine(_):
        named.extend((tmp_path / "backups").glob("wrenchbook-*"))
        return []

    monkeypatch.setattr(copier, "examine", examine)
    facts = copier.tested_backup(shipped.folder, tmp_path / "backups")
    assert named == []
    assert [path.name for path in (tmp_path / "backups").iterdir()] == [facts["file"]]


def test_folders_of_tests_that_were_killed_are_removed_at_the_start(tmp_path):
    (tmp_path / "backups/.tested-ab/data").mkdir(parents=True)
    stop = threading.Event()
    stop.set()
    copier.make_backups(Settings(tmp_path, backup_every=1.0), stop)
    assert list((tmp_path / "backups").iterdir()) == []


def test_a_copier_that_ends_completes_the_backup_that_it_has_begun(tmp_path, monkeypatch):
    begun, done = threading.Event(), []

    def keep(_, stop):
        begun.set()
        stop.wait()
        time.sleep(0.2)
        done.append(True)

    def end_once_begun(*_):
        handler[0](signal.SIGTERM, None)
        begun.wait()

    handler = []
    monkeypatch.setattr(signal, "signal", lambda _, function: handler.insert(0, function))
    monkeypatch.setattr(copier, "make_backups", keep)
    monkeypatch.setattr(copier, "ship", end_once_begun)
    monkeypatch.setattr(os, "umask", lambda _: None)
    settings = Settings(tmp_path, backup_every=1.0, replicate=f"file://{tmp_path}/replica")
    copier.run(settings, threading.Event())
    assert done == [True]


def replica_fault():
    from wrenchbook.service.ops.checks import DataFinding

    return DataFinding("fault", "rows are gone")


def test_health_and_doctor_say_that_nothing_is_shipped(shipped, tmp_path):
    part = {"trouble": "no route to host", "seen": 0.0, "patience": 60.0}
    replica.write_status(shipped.folder, replica=part)
    settings = Settings(shipped.folder, replicate=shipped.url)
    assert "replica: no route to host" in replica.trouble_of({"replica": part}, settings)
    silent = {"replica": part | {"trouble": None}}
    assert "is silent for" in replica.trouble_of(silent, settings)
    assert replica.trouble_of(silent, Settings(shipped.folder)) is None
    faults = [finding.problem for finding in examine(shipped.folder) if finding.kind == "fault"]
    assert any("no route to host" in fault for fault in faults)
