"""Settings of serve: the line wins over the environment, that over the file; nothing is guessed."""

import re
import socket
import tomllib
from pathlib import Path

import pytest
from starlette.testclient import TestClient
from typer.testing import CliRunner

from tests.service.live import as_rows, clean_wrenches, moved
from tests.until import until
from wrenchbook.service import workspace
from wrenchbook.service.cli.main import app
from wrenchbook.service.http.app import create_app
from wrenchbook.service.settings import (
    OTHERS,
    PREFIX,
    Settings,
    SettingsError,
    as_file,
    check_copies,
)


@pytest.fixture
def shown(tmp_path, monkeypatch):
    """What `serve --show-settings` says, as TOML, or the text of its refusal."""
    monkeypatch.setenv("COLUMNS", "1000")
    monkeypatch.delenv("WRENCHBOOK_DATA", raising=False)

    def ask(*texts, **variables):
        for name, value in variables.items():
            monkeypatch.setenv(name, value)
        line = ["serve", "--data", str(tmp_path), *texts, "--show-settings"]
        result = CliRunner().invoke(app, line)
        return tomllib.loads(result.output) if result.exit_code == 0 else result.output

    return ask


def test_the_line_wins_over_the_environment_and_that_over_the_file(shown, tmp_path):
    (tmp_path / "wrenchbook.toml").write_text("port = 1\nqueue_limit = 1\nsolvers = 1\n")
    result = shown("--port", "3", WRENCHBOOK_PORT="2", WRENCHBOOK_QUEUE_LIMIT="2")
    assert (result["port"], result["queue_limit"], result["solvers"]) == (3, 2, 1)
    assert result["host"] == "127.0.0.1"
    result = shown("--queue-limit", "64", WRENCHBOOK_PORT="")  # a default, and an empty variable
    assert (result["queue_limit"], result["port"]) == (64, 1)
    other = tmp_path / "other.toml"
    other.write_text('log_format = "json"\n')
    assert shown("--config", str(other))["log_format"] == "json"


def test_a_data_directory_that_cannot_be_written_is_refused_at_the_start():
    """It printed that it serves, and answered every call with 503."""
    words = ["serve", "--data", "/proc/sys", "--port", "0"]  # nobody can write there
    result = CliRunner().invoke(app, words, env={"COLUMNS": "1000"})
    assert result.exit_code == 2
    assert "this user cannot read and write /proc/sys" in result.output
    assert len(result.output.splitlines()) == 1


@pytest.mark.parametrize(
    ("url", "why"), [("http://x/y", "write file"), ("file://{}", "is in a data directory")]
)
def test_a_replica_is_no_web_server_and_no_data_directory(tmp_path, url, why):
    """A replica was shipped into the data directory of another server."""
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "ledger.sqlite").touch()
    for folder in ("other", "data", "data/backups"):
        replicate = url.format(tmp_path / folder)
        with pytest.raises(SettingsError, match=why):
            check_copies(Settings(tmp_path / "data", replicate=replicate))
    check_copies(Settings(tmp_path / "data", replicate=f"file://{tmp_path}/replica"))


def test_a_port_in_use_is_named(tmp_path):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        words = ["serve", "--data", str(tmp_path / "data"), "--port", str(port)]
        result = CliRunner().invoke(app, words, env={"COLUMNS": "40"})
    assert result.exit_code == 2
    assert result.output == (
        f"127.0.0.1:{port}: Address already in use; stop the program that uses the port, or take a "
        "free one with --port 0\n"
    )


def test_every_variable_that_make_and_the_tests_set_lets_a_server_start():
    """`make soak` was refused by every server it started."""
    root = Path(__file__).parents[2]
    named = {"WRENCHBOOK_"}
    for file in (root / "Makefile", *root.glob("tests/**/*.py"), *root.glob("fea/**/*.py")):
        if file.name != Path(__file__).name:
            named |= set(re.findall(r"(?<!_)WRENCHBOOK_[A-Z_]+", file.read_text()))
    settings = {f"{PREFIX}{name.upper()}" for name in Settings.__dataclass_fields__}
    assert named <= settings | {f"{PREFIX}{name}" for name in OTHERS} | {PREFIX}


def test_what_is_shown_is_a_file_that_says_the_same(shown, tmp_path):
    first = shown("--solvers", "3", "--log-format", "json")
    del first["data"]
    text = "\n".join(f"{name} = {value!r}" for name, value in first.items())
    (tmp_path / "wrenchbook.toml").write_text(text.replace("False", "false"))
    again = shown()
    assert {name: again[name] for name in first} == first


def test_every_option_of_serve_is_a_setting(shown):
    result = CliRunner().invoke(app, ["serve", "--help"], env={"COLUMNS": "1000"})
    for name in shown():
        assert f"--{name.replace('_', '-')}" in result.output


CALL = "/v1/components/rig"
WRENCH = {"force": [12.0, 0, 0], "moment": [0, 1.5, 2.5], "on_thin": "estimate"}


@pytest.fixture(params=["griddata", "linear"])
def method(request):
    return request.param


@pytest.fixture
def http(tmp_path, method):
    with TestClient(create_app(workspace.Settings(tmp_path, solvers=0, method=method))) as http:
        span = {"force": [100.0] * 3, "moment": [10.0] * 3}
        http.post("/v1/components", json={"name": "rig", "title": "rig", "range": span})
        rows = as_rows(clean_wrenches(), moved(clean_wrenches()))
        http.post(f"{CALL}/table?format=json", json={"rows": rows})
        until(lambda: http.get(CALL).json()["table_version"] == len(rows))
        yield http


def test_the_servers_method_answers_a_request_that_names_none(http, method):
    assert http.post(f"{CALL}/displacement", json=WRENCH).json()["method"] == method
    batch = {"wrenches": [[12.0, 0, 0, 0, 1.5, 2.5]], "on_thin": "estimate"}
    assert http.post(f"{CALL}/displacements", json=batch).json()["method"] == method


def test_the_method_of_a_request_goes_before_the_servers(http):
    asked = {**WRENCH, "method": "additive"}
    assert http.post(f"{CALL}/displacement", json=asked).json()["method"] == "additive"


@pytest.mark.parametrize("text", ["/data/\U0001f600", "/data/\x7f"])
def test_settings_are_a_file_with_the_same_meaning_for_any_text(text):
    settings = Settings(Path(text), actor_seconds=float("inf"))
    origins = {"data": "command line", "actor_seconds": "default", "access_log": "default"}
    values = {"data": text, "actor_seconds": float("inf"), "access_log": False}
    assert tomllib.loads(as_file(settings, origins)) == values
