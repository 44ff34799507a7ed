"""A backup is whole or is none, and restores to the same answers."""

import errno
import json
import os
import random
import shutil
import stat
import zipfile
from contextlib import closing
from functools import partial
from hashlib import blake2b
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from tests.service.test_durable_tables import Site
from wrenchbook.service.cli.main import app
from wrenchbook.service.keys import Keyring
from wrenchbook.service.ledger import Ledger, LedgerError
from wrenchbook.service.ops.backup import MANIFEST, BackupError, back_up, verify
from wrenchbook.service.ops.restore import restore
from wrenchbook.service.tables.solver_errors import SolverErrors


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    site = Site(tmp_path_factory.mktemp("backup") / "site")
    site.open("rig")
    site.insert(30)
    site.ledger.accept("rig", "f", (1.0, 0, 0, 0, 0, 0))
    site.close()
    (site.folder / "fields" / "rig").mkdir(parents=True)
    (site.folder / "fields" / "rig" / "1.fields").write_bytes(b"surface")
    (site.folder / "jobs" / "1" / "1").mkdir(parents=True)
    (site.folder / "jobs" / "1" / "1" / "log.txt").write_text("log")
    back_up(site.folder, site.folder.with_name("rig.backup"))
    return site.folder


@pytest.fixture
def folder(whole, tmp_path):
    return shutil.copytree(whole, tmp_path / "site")


@pytest.fixture
def backup(whole, tmp_path):
    return shutil.copy(whole.with_name("rig.backup"), tmp_path / "rig.backup")


def answers(folder):
    site = Site(folder)
    site.open()
    wrenches = np.random.default_rng(1).uniform(0, 2, (20, 6)) * [1, 0, 0, 0, 0, 1]
    table = site.tables.surrogate("rig")
    result = [table.packed.answer(wrench.tolist()) for wrench in wrenches]
    jobs = site.ledger.jobs()
    site.close()
    return repr((table.version, result, jobs))


def test_a_restored_directory_gives_the_same_answers_and_jobs(folder, backup, tmp_path):
    restore(backup, tmp_path / "again")
    assert answers(tmp_path / "again") == answers(folder)
    assert (tmp_path / "again" / "fields" / "rig" / "1.fields").read_bytes() == b"surface"


def test_a_backup_holds_no_keys_settings_drafts_attempts_and_tables_that_are_built_again(
    folder, tmp_path
):
    Keyring(folder).add("ops", "admin")
    for name in ("wrenchbook.toml", "stranger.txt", "tables/.rig.h5.abc.tmp"):
        (folder / name).write_text("solvers = 0")
    assert list((folder / "tables").glob("rig-*.wbt"))
    files = back_up(folder, tmp_path / "b").files
    assert set(files) == {
        *("ledger.sqlite", "tables/rig.h5", "components/rig/component.toml"),
        "fields/rig/1.fields",
    }
    restore(tmp_path / "b", tmp_path / "again")
    answers(tmp_path / "again")
    assert list((tmp_path / "again" / "tables").glob("rig-*.wbt"))


def test_a_restored_directory_keeps_what_solvers_may_be_wrong_by(folder, tmp_path):
    """Without it the mesh's share would leave every bar."""
    reported = {"mesh": np.eye(6).tolist(), "loads": [1.0] * 6}
    with closing(Ledger(folder / "ledger.sqlite")) as ledger:
        SolverErrors(ledger).record("rig", "f", reported)
    back_up(folder, tmp_path / "b")
    restore(tmp_path / "b", tmp_path / "again")
    with closing(Ledger(tmp_path / "again" / "ledger.sqlite")) as ledger:
        result = SolverErrors(ledger).read("rig", "f")
    assert result is not None
    assert result.values == reported


def test_a_backup_leaves_the_draft_of_another_one_to_the_same_file(folder, tmp_path):
    """Two containers have the same process ids: both failed, and deleted each other's draft."""
    other = tmp_path / f".b.{os.getpid()}.part"
    other.write_bytes(b"half")
    back_up(folder, tmp_path / "b")
    verify(tmp_path / "b")
    assert sorted(path.name for path in tmp_path.glob("*b*")) == sorted([other.name, "b"])
    assert other.read_bytes() == b"half"


def test_no_flipped_byte_of_a_backup_is_restored(backup, folder, tmp_path):
    whole, same, refused = backup.read_bytes(), answers(folder), 0
    for seed in range(60):
        chance, damaged = random.Random(seed), bytearray(whole)
        damaged[chance.randrange(len(damaged))] ^= 1 << chance.randrange(8)
        backup.write_bytes(damaged)
        try:
            restore(backup, tmp_path / f"again{seed}")
        except BackupError:
            refused += 1
        else:  # a byte that says nothing: a time in the zip's index
            assert answers(tmp_path / f"again{seed}") == same
    assert refused > 45


def test_a_directory_that_is_not_empty_is_left_alone_unless_told(backup, folder, tmp_path):
    before = answers(folder)
    with pytest.raises(BackupError, match="not empty"):
        restore(backup, folder)
    assert answers(folder) == before


def test_what_was_in_an_overwritten_directory_is_moved_aside_whole(backup, folder):
    site = Site(folder)
    site.open()
    site.insert(10, first=30)
    site.close()
    newer = answers(folder)
    _, aside = restore(backup, folder, overwrite=True)
    assert aside.is_dir()
    assert answers(aside) == newer != answers(folder)


def planted(backup, name="", content=b"", mode=0o600, text=None, large="", **changes):
    """A backup with a file more, another manifest, or a large entry, as one makes it who can."""
    with zipfile.ZipFile(backup) as archive:
        held = {entry: archive.read(entry) for entry in archive.namelist()}
    manifest = json.loads(held.pop(MANIFEST))
    if name:
        digest = blake2b(content, digest_size=32).hexdigest()
        manifest["files"][name] = [len(content), digest]
    held[MANIFEST] = json.dumps(manifest | changes).encode() if text is None else text.encode()
    if large:
        held[large] += b" " * (1 << 24)
    target = backup.with_name("planted.backup")
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED if large else 0) as archive:
        for entry, bytes_ in held.items():
            archive.writestr(entry, bytes_)
        if name:
            info = zipfile.ZipInfo(name)
            info.external_attr = mode << 16
            archive.writestr(info, content)
    return target


def cut(backup, kept):
    backup.write_bytes(backup.read_bytes()[:kept])
    return backup


def written(backup):
    backup.write_text("some text")
    return backup


OUT = ("../outside", "/etc/outside", "fields/../../outside")
FOREIGN = (
    *("keys.json", "keys.json.lock", "wrenchbook.toml", "jobs/1/1/spec.json", "shared/lock"),
    *("tables/rig-1.wbt", "tables/.rig.h5", "components/.x/y", "components", "fields//x"),
    *("reports/rig/report.json", "ledger.sqlite-wal", "ledger.sqlite-acknowledged", "x/y"),
)
FORM = '{"format": "wrenchbook backup", "schema": '
NONSENSE = (
    *("[" * 100_000, "null", "\xff", f"{FORM}1e999}}"),
    f'{FORM}2, "created": 0, "ledger_schema": 1e999, "files": {{}}}}',
    f'{FORM}2, "created": 0, "ledger_schema": 1, "files": {{"ledger.sqlite": [1e999, ""]}}}}',
)
# A manifest of 1 MB took 2 GB of memory, an entry of 2 MB filled 2 GB of disk.
LARGE = (MANIFEST, "fields/rig/1.fields")
REFUSED = [
    *((partial(cut, kept=kept), None) for kept in (0, 1, 100, -5000, -30, -1)),
    (partial(planted, schema=99, program="9.9"), r"newer wrenchbook.*9\.9"),
    (partial(planted, format="another"), "has the format 'another', not 'wrenchbook backup'"),
    (partial(planted, text='{"schema": 2}'), "in its backup.json the member 'format' is missing"),
    (written, "is no backup .File is not a zip file.; name a file that wrenchbook backup wrote"),
    (lambda backup: backup.parent, "cannot be read: Is a directory; name a backup"),
    (partial(planted, files={}), r"has no ledger\.sqlite"),
    *((partial(planted, name=name), "which no backup contains") for name in (*OUT, *FOREIGN)),
    *((partial(planted, name=name, schema=1), "which no backup contains") for name in OUT),
    *((partial(planted, text=text), "planted") for text in NONSENSE),
    *((partial(planted, large=name), "compressed or overlapping entries") for name in LARGE),
]


@pytest.mark.parametrize(("change", "says"), REFUSED)
def test_a_backup_that_is_cut_foreign_or_hostile_is_refused_and_changes_nothing(
    backup, tmp_path, change, says
):
    with pytest.raises(BackupError, match=says):
        restore(change(backup), tmp_path / "again")
    assert not (tmp_path / "again").exists()


@pytest.mark.parametrize("kind", [stat.S_IFLNK, stat.S_IFCHR, stat.S_IFIFO, stat.S_IFDIR])
def test_no_link_and_no_device_comes_out_of_a_backup(backup, tmp_path, kind):
    name = "components/rig/mesh.inp"
    restore(planted(backup, name, b"/etc/passwd", kind | 0o6777), tmp_path / "again")
    restored = (tmp_path / "again" / name).lstat()
    assert stat.S_ISREG(restored.st_mode)
    assert stat.S_IMODE(restored.st_mode) == 0o600


def test_a_backup_of_another_user_is_refused(backup, tmp_path, monkeypatch):
    monkeypatch.setattr(os, "geteuid", lambda: 4242)
    os.chown(backup, 4243, -1) if os.getuid() == 0 else None
    with pytest.raises(BackupError, match="belongs to user"):
        restore(backup, tmp_path / "again")
    assert not (tmp_path / "again").exists()


def test_a_key_revoked_after_a_backup_stays_revoked_and_the_others_stay(folder, tmp_path):
    """A restore brought revoked keys back, and one of a directory without keys opened a server."""
    leaver, ops = (Keyring(folder).add(name, "admin") for name in ("leaver", "ops"))
    (folder / "wrenchbook.toml").write_text("solvers = 0")
    back_up(folder, tmp_path / "b")
    Keyring(folder).revoke("leaver")
    restore(tmp_path / "b", folder, overwrite=True)
    assert Keyring(folder).find(leaver) is None
    assert Keyring(folder).find(ops) is not None
    assert stat.S_IMODE((folder / "keys.json").stat().st_mode) == 0o600
    assert (folder / "wrenchbook.toml").read_text() == "solvers = 0"


def test_a_directory_with_keys_and_settings_alone_is_empty(backup, tmp_path):
    Keyring(tmp_path / "new").add("ops", "admin")
    _, aside = restore(backup, tmp_path / "new")
    assert aside is None


def test_keys_in_a_backup_of_an_earlier_version_are_left_out_and_named(backup, tmp_path):
    older = planted(backup, "keys.json", b'{"keys": []}', schema=1)
    command = ["restore", str(older), "--data", str(tmp_path / "d2")]
    shown = CliRunner().invoke(app, command, env={"COLUMNS": "1000"})
    assert shown.exit_code == 0
    assert "Not restored, since backups hold no such files: keys.json." in shown.output
    assert "It has no keys" in shown.output
    assert not (tmp_path / "d2" / "keys.json").exists()


def test_a_restored_directory_is_its_owners_alone(backup, tmp_path):
    umask = os.umask(0)
    try:
        restore(backup, tmp_path / "again")
    finally:
        os.umask(umask)
    modes = {path: path.stat().st_mode & 0o077 for path in (tmp_path / "again").rglob("*")}
    assert len(modes) > 5
    assert not any(modes.values()), modes


def test_a_backup_is_private_while_it_is_written(folder, tmp_path, monkeypatch):
    modes = []
    monkeypatch.setattr(
        "wrenchbook.service.ops.backup.verify",
        lambda draft: modes.append(stat.S_IMODE(draft.stat().st_mode)),
    )
    umask = os.umask(0)
    try:
        back_up(folder, tmp_path / "b")
    finally:
        os.umask(umask)
    assert modes == [0o600]


def test_a_damaged_ledger_is_not_backed_up_over_a_good_backup(backup, folder):
    before = backup.read_bytes()
    ledger = folder / "ledger.sqlite"
    content = bytearray(ledger.read_bytes())
    content[4096:8192] = b"x" * 4096
    ledger.write_bytes(content)
    with pytest.raises(BackupError, match="damaged"):
        back_up(folder, backup)
    assert backup.read_bytes() == before
    assert [path.name for path in backup.parent.glob(".*")] == []


def test_a_backup_that_cannot_be_written_is_told_and_leaves_nothing(folder, tmp_path):
    with pytest.raises(BackupError, match="cannot be written"):
        back_up(folder, tmp_path / "none" / "b")
    with pytest.raises(BackupError, match="no data directory"):
        back_up(tmp_path, tmp_path / "b")
    assert not (tmp_path / "b").exists()


def test_a_backup_replaces_the_file_that_a_link_names_and_never_a_device(folder, tmp_path):
    (tmp_path / "link.zip").symlink_to(tmp_path / "real.zip")
    back_up(folder, tmp_path / "link.zip")
    assert (tmp_path / "link.zip").is_symlink()
    assert verify(tmp_path / "real.zip").files
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(BackupError, match="no regular file"):
        back_up(folder, tmp_path / "pipe")
    assert stat.S_ISFIFO((tmp_path / "pipe").stat().st_mode)


def test_a_backup_is_not_written_among_the_files_that_a_backup_holds(folder):
    """Each held those before it: twice as large every time."""
    target = folder / "components" / "monday.zip"
    target.parent.mkdir(exist_ok=True)
    with pytest.raises(BackupError, match="outside"):
        back_up(folder, target)
    assert not target.exists()


def test_a_backup_names_the_file_that_cannot_be_read(folder, tmp_path, monkeypatch):
    """It said that the backup could not be written."""
    (path,) = (folder / "tables").glob("*.h5")
    opened = Path.open

    def refused(self, *arguments, **options):
        if self == path:
            raise PermissionError(errno.EACCES, "Permission denied", str(self))
        return opened(self, *arguments, **options)

    monkeypatch.setattr(Path, "open", refused)
    with pytest.raises(BackupError, match=rf"{path.name} cannot be read: .* No backup was made"):
        back_up(folder, tmp_path / "b")
    assert not (tmp_path / "b").exists()


def test_a_backup_names_a_file_whose_name_is_not_utf_8(folder, tmp_path):
    os.close(os.open(os.fsencode(folder / "components/rig") + b"/tr\xe4ger.msh", os.O_CREAT))
    with pytest.raises(BackupError, match=r"rig/tr\\xe4ger\.msh .* not UTF-8.* No backup was made"):
        back_up(folder, tmp_path / "b")
    assert not (tmp_path / "b").exists()


def test_the_manifest_of_a_backup_names_the_program_that_wrote_it(backup):
    with zipfile.ZipFile(backup) as archive:
        entries = {name: archive.read(name) for name in archive.namelist()}
    fields = json.loads(entries[MANIFEST]) | {"program": "0.2"}
    with zipfile.ZipFile(backup, "w") as archive:
        for name, content in (entries | {MANIFEST: json.dumps(fields)}).items():
            archive.writestr(name, content)
    assert verify(backup).program == "0.2"


def test_a_restore_that_fails_half_way_says_where_the_former_files_are(
    backup, tmp_path, monkeypatch
):
    """It said that the directory could not be written, and nothing of what had been in it."""
    folder = tmp_path / "again"
    restore(backup, folder)
    before = (folder / "ledger.sqlite").read_bytes()
    renamed = Path.rename

    def full(self, target):
        if self.parent.name == ".restoring":
            raise OSError(errno.ENOSPC, "No space left on device")
        return renamed(self, target)

    with monkeypatch.context() as patched:
        patched.setattr(Path, "rename", full)
        with pytest.raises(
            BackupError, match=r"make room on its disk\. The restore is not complete"
        ) as reported:
            restore(backup, folder, overwrite=True)
    (aside,) = folder.glob(".before-restore-*")
    assert str(aside) in str(reported.value)
    assert (aside / "ledger.sqlite").read_bytes() == before


@pytest.fixture
def interrupted(backup, tmp_path, monkeypatch):
    """A directory whose restore was killed before it had moved a file."""
    folder = tmp_path / "again"
    with monkeypatch.context() as patched:
        patched.setattr(shutil, "rmtree", lambda *_, **__: None)
        patched.setattr("wrenchbook.service.ops.restore.sync_tree", lambda _: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            restore(backup, folder)
    assert [entry.name for entry in folder.iterdir()] == [".restoring"]
    return folder


@pytest.mark.parametrize("command", ["doctor", "doctor --repair", "serve"])
def test_an_interrupted_restore_is_named_and_no_empty_ledger_is_made(interrupted, command):
    """The doctor named it as an unfinished file, made an empty ledger and said: in order."""
    words = [*command.split(), "--data", str(interrupted)]
    result = CliRunner().invoke(app, words, env={"COLUMNS": "1000"})
    assert result.exit_code
    assert f"a restore into {interrupted} was interrupted" in result.output
    assert "in order" not in result.output
    assert [entry.name for entry in interrupted.iterdir()] == [".restoring"]


def test_an_interrupted_restore_is_repeated_by_the_command_that_its_message_has(
    interrupted, backup, folder
):
    restore(backup, interrupted, overwrite=True)
    assert answers(interrupted) == answers(folder)


def test_a_program_that_opens_the_ledger_of_an_interrupted_restore_makes_no_new_one(interrupted):
    with pytest.raises(LedgerError, match="was interrupted"):
        Ledger(interrupted / "ledger.sqlite")
    assert not (interrupted / "ledger.sqlite").exists()


def test_a_directory_whose_jobs_are_being_run_is_not_restored_into(backup, tmp_path):
    from wrenchbook.service.jobs.dispatcher import Lease

    lease = Lease(tmp_path / "busy" / "jobs" / "owners")
    with pytest.raises(BackupError, match="stop it first"):
        restore(backup, tmp_path / "busy", overwrite=True)
    lease.close()


def test_a_server_that_starts_during_a_restore_keeps_its_ledger(backup, tmp_path, monkeypatch):
    """The directory was looked at once, before all files were unpacked."""
    folder = tmp_path / "again"

    def started(_):
        (folder / "ledger.sqlite").write_text("of the server")

    monkeypatch.setattr("wrenchbook.service.ops.restore.sync_tree", started)
    with pytest.raises(BackupError, match="is not empty"):
        restore(backup, folder)
    assert [entry.name for entry in folder.iterdir()] == ["ledger.sqlite"]
    assert (folder / "ledger.sqlite").read_text() == "of the server"


def test_a_restored_ledger_goes_on_numbering_where_the_backup_ended(backup, tmp_path):
    restore(backup, tmp_path / "again")
    ledger = Ledger(tmp_path / "again" / "ledger.sqlite")
    assert ledger.losses() == []
    assert ledger.accept("rig", "f", (2.0, 0, 0, 0, 0, 0))[0].id == 2
    ledger.close()
    assert verify(backup).files


def test_the_command_that_starts_a_restored_directory_names_it(backup, tmp_path):
    """It advised `wrenchbook serve`, which serves another directory."""
    words = ["restore", str(backup), "--data", str(tmp_path / "d2")]
    result = CliRunner().invoke(app, words, env={"COLUMNS": "1000"})
    assert f"wrenchbook serve --data {tmp_path / 'd2'}" in result.output.replace("\n", "")
