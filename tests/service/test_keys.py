"""Keys are kept hashed, in one file; servers and commands on it see each other's changes."""

import errno
import os
import stat
import time
from contextlib import suppress

import pytest
from typer.testing import CliRunner

from tests.service.expired import add_expired_key
from wrenchbook.service.cli.local import make_first_key
from wrenchbook.service.cli.main import app
from wrenchbook.service.keys import FILE, PREFIX, Keyring, KeysError, KeysNeededError
from wrenchbook.service.ledger import Ledger
from wrenchbook.service.workers import supervisor


@pytest.fixture
def keyring(tmp_path):
    return Keyring(tmp_path)


def test_a_key_is_found_by_its_secret_and_by_nothing_else(keyring):
    secret = keyring.add("ann", "write")
    assert secret.startswith(PREFIX)
    assert keyring.find(secret).name == "ann"
    for wrong in ("", "ann", secret[:-1], secret + "x", keyring.find(secret).digest):
        assert keyring.find(wrong) is None


def test_the_list_cuts_no_name_in_a_narrow_terminal(tmp_path):
    Keyring(tmp_path).add("ann" * 20, "read")
    words = ["keys", "list", "--data", str(tmp_path)]
    listed = CliRunner().invoke(app, words, env={"COLUMNS": "60"}).output
    assert "\N{HORIZONTAL ELLIPSIS}" not in listed


def test_the_file_holds_no_secret_and_is_its_owners_alone(keyring, tmp_path):
    secret = keyring.add("ann", "admin")
    assert secret not in (tmp_path / FILE).read_text()
    assert stat.S_IMODE((tmp_path / FILE).stat().st_mode) == 0o600


def test_a_server_takes_up_what_a_command_changes(keyring, tmp_path):
    secret = Keyring(tmp_path).add("ann", "read")
    before = keyring.version
    assert keyring.refresh(0.0) != before
    assert keyring.find(secret) is not None
    Keyring(tmp_path).revoke("ann")
    keyring.refresh(0.0)
    assert keyring.find(secret) is None
    assert len(keyring) == 0


def test_a_key_that_another_process_has_made_is_found_at_once(keyring, tmp_path):
    """The second of two web workers answered 401 to it for half a second."""
    keyring.refresh()
    assert keyring.find(Keyring(tmp_path).add("ann", "read")) is not None


def test_a_key_ends_at_its_time_although_the_clock_was_set_back_before(keyring, monkeypatch):
    now = time.time()
    key = keyring.find(keyring.add("ann", "read", expires=now + 100.0))
    versions = []
    for clock in (now + 3600.0, now, now + 200.0):  # a wrong clock, its correction, the end
        monkeypatch.setattr(time, "time", lambda clock=clock: clock)
        versions.append(keyring.refresh(0.0))
    assert not key.is_valid()
    assert versions == sorted({*versions})  # permissions are read again each time


@pytest.mark.parametrize(
    ("name", "scope", "limits"),
    [
        ("", "read", {}),
        ("a b", "read", {}),
        ("x" * 65, "read", {}),
        ("a\nb", "read", {}),
        ("ann", "root", {}),
        ("ann", "read", {"rate": 0}),
        ("ann", "read", {"rate": float("nan")}),
        ("ann", "read", {"rate": 1e-309}),
        ("ann", "read", {"expires": 1.8e12}),  # ms
        ("ann", "read", {"megabytes": 0}),
    ],
)
def test_a_key_that_cannot_be_is_refused_and_nothing_is_written(
    keyring, tmp_path, name, scope, limits
):
    with pytest.raises(KeysError) as refused:
        keyring.add(name, scope, **limits)
    if limits.get("expires"):
        assert "expires is 1800000000000.0, but must be in seconds since 1970" in str(refused.value)
    assert not (tmp_path / FILE).exists()


def test_a_name_is_one_keys(keyring):
    keyring.add("ann", "read")
    with pytest.raises(KeysError, match=r"a key .ann. exists; choose another name"):
        keyring.add("ann", "write")
    with pytest.raises(KeysError, match="name one of: ann"):
        keyring.revoke("bob")


def test_a_key_is_rotated_while_it_is_valid(keyring, tmp_path):
    with pytest.raises(KeysError, match="create it with: wrenchbook keys add ann --data"):
        keyring.rotate("ann", 0.0)
    add_expired_key(tmp_path, "ann", "read")
    with pytest.raises(
        KeysError, match=r"expired, so .* keys revoke ann --data .*; wrenchbook keys add ann --data"
    ):
        keyring.rotate("ann", 0.0)


@pytest.mark.parametrize(
    ("content", "why"),
    [
        ("", "it is not valid JSON"),
        ("{", "it is not valid JSON"),
        ("[]", 'it has no list "keys"'),
        ('{"keys": 3}', 'it has no list "keys"'),
        ('{"keys": [3]}', r"keys\[0\]: the field 'name' is missing"),
        ('{"keys": [{"name": "x"}]}', r"keys\[0\]: the field 'scope' is missing"),
        ("unknown field", r"keys\[0\]: the field 'scope_' is unknown"),
        ("unknown scope", r"keys\[0\]: the scope must be one of read, write, admin, not 'root'"),
        (
            "texts",
            r"""keys\[0\]: components must be a list such as \["plate_\*"\], not '\*'""",
        ),
        ("a pattern", r"""keys\[0\]: the pattern '\+' must have .* such as plate_\*"""),
        ("a number", r"""keys\[0\]: the pattern 5 must have .* such as plate_\*"""),
    ],
)
def test_damaged_keys_let_nobody_in_and_are_told_of(tmp_path, content, why):
    edits = {
        "unknown field": ('"scope"', '"scope_": "admin", "scope"'),
        "unknown scope": ('"read"', '"root"'),
        "a pattern": ('"*"', '"+"'),
        "a number": ('"*"', "5"),
        "texts": ('[\n    "*"\n   ]', '"*"'),
    }
    if content in edits:
        Keyring(tmp_path).add("ann", "read")
        content = (tmp_path / FILE).read_text().replace(*edits[content])
    (tmp_path / FILE).write_text(content)
    with pytest.raises(KeysError, match=f"damaged: {why}.*wrenchbook keys add"):
        Keyring(tmp_path)
    with pytest.raises(KeysError, match="wrenchbook keys add"):  # it was a worker's traceback
        app(["serve", "--data", str(tmp_path), "--port", "0"], standalone_mode=False)


def test_keys_in_a_folder_that_cannot_be_searched_are_an_error_of_keys(tmp_path):
    """The status of the file raised the system's bare error."""
    (tmp_path / "data").touch()
    with pytest.raises(KeysError, match=r"keys\.json cannot be read \(Not a directory\)"):
        Keyring(tmp_path / "data")


def test_keys_that_are_damaged_under_a_server_stay_as_they_were(keyring, tmp_path):
    secret = keyring.add("ann", "read")
    (tmp_path / FILE).write_text("{")
    keyring.refresh(0.0)
    assert keyring.find(secret) is not None


def test_keys_that_a_full_disk_does_not_take_stay_as_they_were(keyring, tmp_path, monkeypatch):
    """The message was "No space left on device" alone, and a partial file stayed."""
    keyring.add("ann", "read")
    before = sorted(tmp_path.iterdir())

    def full(_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(KeysError, match=r"keys\.json cannot be written.*No space left"):
        keyring.add("bob", "read")
    assert sorted(tmp_path.iterdir()) == before
    assert [key.name for key in keyring.listed()] == ["ann"]


@pytest.mark.parametrize(
    ("code", "remedy"),
    [
        (errno.EACCES, rf"run this as the owner of .* to user {os.geteuid()}"),
        (errno.EIO, "disk"),
    ],
)
def test_keys_that_cannot_be_read_are_told_by_the_cause(
    keyring, tmp_path, monkeypatch, code, remedy
):
    keyring.add("ann", "read")

    def refused(_):
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr("pathlib.Path.read_bytes", refused)
    with pytest.raises(
        KeysError, match=rf"keys\.json cannot be read \({os.strerror(code)}\); .*{remedy}"
    ):
        Keyring(tmp_path)


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.0.2.1"])
def test_a_server_that_others_reach_does_not_start_without_keys_and_says_how(
    tmp_path, monkeypatch, host
):
    monkeypatch.setattr(supervisor, "bind_to", lambda *_: pytest.fail("it listens"))
    with pytest.raises(KeysNeededError, match=r"wrenchbook keys add .*, start with --first-key"):
        app(
            ["serve", "--data", str(tmp_path), "--host", host, "--port", "0"], standalone_mode=False
        )


@pytest.mark.parametrize(
    "make",
    [
        lambda folder: Keyring(folder).add("ann", "read"),
        lambda folder: Ledger(folder / "ledger.sqlite").close(),
        lambda folder: app(["serve", "--data", str(folder), "--host", "::"], standalone_mode=False),
    ],
)
def test_a_new_data_directory_is_its_owners_alone(make, tmp_path):
    """Every user of the machine could read its tables, past the keys."""
    umask = os.umask(0)
    try:
        with suppress(KeysNeededError):
            make(tmp_path / "data")
    finally:
        os.umask(umask)
    assert stat.S_IMODE((tmp_path / "data").stat().st_mode) == 0o700


def test_the_first_key_is_for_admin_printed_once_and_made_once(tmp_path, capsys):
    make_first_key(tmp_path)
    secret = capsys.readouterr().out.split()[-1]
    assert Keyring(tmp_path).find(secret).scope == "admin"
    make_first_key(tmp_path)
    assert capsys.readouterr().out == ""
    assert len(Keyring(tmp_path)) == 1


def test_keys_are_added_listed_and_revoked_by_commands(tmp_path):
    def run(*texts):
        return CliRunner().invoke(app, ["keys", *texts, "--data", str(tmp_path)])

    secret = run("add", "ann", "--scope", "read").stdout.splitlines()[0]
    assert Keyring(tmp_path).find(secret).name == "ann"
    listed = run("list").stdout
    assert "ann" in listed
    assert secret not in listed
    revoked = run("revoke", "ann")
    assert revoked.exit_code == 0
    assert "has no keys left. A running server refuses" in revoked.stdout
    assert len(Keyring(tmp_path)) == 0
    assert run("revoke", "ann").exit_code != 0
