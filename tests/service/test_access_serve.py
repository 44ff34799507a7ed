"""What `wrenchbook serve` and `wrenchbook keys` do about keys, before anything is served."""

import pytest
from typer.testing import CliRunner

from wrenchbook.service.cli.local import make_first_key
from wrenchbook.service.cli.main import app
from wrenchbook.service.keys import Keyring, KeysNeededError
from wrenchbook.service.workers import supervisor


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.0.2.1"])
def test_a_server_that_others_reach_does_not_start_without_keys_and_says_how(
    tmp_path, monkeypatch, host
):
    monkeypatch.setattr(supervisor, "bind_to", lambda *_: pytest.fail("it listens"))
    with pytest.raises(KeysNeededError, match=r"wrenchbook keys add .* or start with --first-key"):
        app(
            ["serve", "--data", str(tmp_path), "--host", host, "--port", "0"], standalone_mode=False
        )


def test_the_first_key_is_for_admin_printed_once_and_made_once(tmp_path, capsys):
    make_first_key(tmp_path)
    secret = capsys.readouterr().out.split()[-1]
    assert Keyring(tmp_path).find(secret).scope == "admin"
    make_first_key(tmp_path)
    assert capsys.readouterr().out == ""
    assert len(Keyring(tmp_path)) == 1


def test_keys_are_added_listed_and_revoked_by_commands(tmp_path):
    def run(*words):
        return CliRunner().invoke(app, ["keys", *words, "--data", str(tmp_path)])

    secret = run("add", "ann", "--scope", "read").stdout.splitlines()[0]
    assert Keyring(tmp_path).find(secret).name == "ann"
    listed = run("list").stdout
    assert "ann" in listed
    assert secret not in listed
    assert run("revoke", "ann").exit_code == 0
    assert len(Keyring(tmp_path)) == 0
    assert run("revoke", "ann").exit_code != 0
