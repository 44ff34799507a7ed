"""Whatever a file does to its reader, the server gets parts or an error with a name."""

import os
import signal
import threading
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest

from wrenchbook.service import sandbox as process
from wrenchbook.service.sandbox import MIB, Limits, Sandbox, SandboxBusyError, SandboxError

HERE = Path(__file__).parent
SMALL = Limits(memory=256 * MIB, seconds=20.0, output=4 * MIB)
SHORT = Limits(memory=256 * MIB, seconds=0.3, output=4 * MIB)


@pytest.fixture(scope="module")
def sandbox():
    """A sandbox that finds the functions beside this file."""
    with pytest.MonkeyPatch().context() as patched:
        patched.setenv("PYTHONPATH", str(HERE))
        sandbox = Sandbox()
        yield sandbox
        sandbox.close()


@pytest.fixture
def run(sandbox, file):
    def run(name, limits=SMALL, **arguments):
        return sandbox.run(f"hostile_readers:{name}", file, arguments, limits)

    return run


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "table.csv"
    path.write_text("fx,ux")
    return path


def test_what_a_function_answers_comes_back_as_it_was(run):
    first, second = run("doubled", factor=2)
    assert first.fields == {"read": "fx,ux", "factor": 2}
    np.testing.assert_array_equal(first.arrays["rows"], np.arange(6.0).reshape(2, 3))
    assert second.arrays["none"].shape == (0, 6)
    assert second.arrays["flags"].tolist() == [True, False]


@pytest.mark.parametrize(
    ("name", "limits", "kind"),
    [
        ("greedy", SMALL, "memory"),
        ("endless", SHORT, "time"),
        ("asleep", SHORT, "elapsed"),
        ("wordy", SMALL, "size"),
        ("crashing", SMALL, "crash"),
        ("babbling", SMALL, "crash"),
        ("vanishing", SMALL, "crash"),
        ("leaving", SMALL, "crash"),
    ],
)
def test_a_file_that_takes_too_much_is_an_error_by_name_and_the_next_one_is_read(
    run, name, limits, kind
):
    with pytest.raises(SandboxError) as caught:
        run(name, limits)
    assert caught.value.kind == kind
    assert run("doubled", factor=1)


def test_a_reader_that_the_system_kills_is_no_timeout(run):
    with pytest.raises(SandboxError, match="the machine had no memory left") as caught:
        run("killed")
    assert caught.value.kind == "memory"


def test_an_exception_comes_back_by_its_name_without_its_traceback(run):
    with pytest.raises(SandboxError, match=r"^there is no such column$") as caught:
        run("refusing")
    assert caught.value.kind == "LookupError"


@pytest.mark.parametrize("reader", ["lying", "boasting"])
def test_an_answer_that_is_not_of_the_form_is_refused(run, reader):
    with pytest.raises(SandboxError, match="gave no valid result"):
        run(reader)


def test_a_function_that_is_not_there_is_an_error_and_not_a_wait(sandbox, file):
    with pytest.raises(SandboxError) as caught:
        sandbox.run("no_such_module:read", file)
    assert caught.value.kind == "ModuleNotFoundError"


def test_the_fork_server_imports_no_finite_elements_and_is_started_once(run):
    first, second = (run("modules")[0].fields for _ in range(2))
    assert "skfem" not in first["modules"]
    assert first["parent"] == second["parent"]
    assert first["pid"] != second["pid"]


def test_a_fork_server_that_was_killed_is_replaced(sandbox, run):
    parent = run("modules")[0].fields["parent"]
    os.kill(parent, signal.SIGKILL)
    assert run("doubled", factor=3)[0].fields["factor"] == 3
    assert run("modules")[0].fields["parent"] != parent


def test_a_parser_that_disarms_its_deadline_is_ended_by_the_server(run, monkeypatch):
    monkeypatch.setattr(process, "GRACE_S", 1.0)
    with pytest.raises(SandboxError, match=r"more than 3 s"):
        run("disarming", SHORT)
    assert run("doubled", factor=1)


def test_the_time_limit_is_of_the_processor_and_a_busy_machine_has_ten_times_as_long(run):
    (part,) = run("timers", Limits(seconds=2000.0))  # what is left of it, whatever has passed
    assert 1000.0 < part.fields["processor"] <= 2000.1
    assert part.fields["hard"] == 2001
    assert 10_000.0 < part.fields["elapsed"] <= 20_000.1


def test_no_more_files_are_read_at_once_than_there_are_places(sandbox, run, monkeypatch):
    monkeypatch.setattr(process, "WAIT_S", 0.05)
    with ExitStack() as taken:
        for _ in range(process.AT_ONCE):
            taken.enter_context(sandbox.place())
        with pytest.raises(SandboxBusyError, match="send this file again in a minute"):
            run("doubled", factor=1)


def test_several_threads_get_their_own_answers(run):
    result = {}

    def ask(number):
        result[number] = run("doubled", factor=number)[0].fields["factor"]

    threads = [threading.Thread(target=ask, args=(number,)) for number in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert result == {number: number for number in range(8)}


def test_no_descriptor_is_left_open_in_the_server(run):
    run("doubled", factor=1)
    before = len(list(Path("/proc/self/fd").iterdir()))
    for _ in range(5):
        run("doubled", factor=1)
    assert len(list(Path("/proc/self/fd").iterdir())) <= before + 1
