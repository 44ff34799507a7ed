"""Whatever a file does to its reader, the server gets parts or an error with a name."""

import threading
from pathlib import Path

import numpy as np
import pytest

from service.sandbox import (
    FenceBusyError,
    FenceCrashError,
    FenceMemoryError,
    FenceSizeError,
    FenceTimeError,
    Limits,
    RaisedInFenceError,
    fenced,
    process,
    program,
)
from service.sandbox.limits import MIB

HERE = Path(__file__).parent
SMALL = Limits(memory=256 * MIB, seconds=20.0, output=4 * MIB)
SHORT = Limits(memory=256 * MIB, seconds=0.3, output=4 * MIB)


@pytest.fixture(scope="module", autouse=True)
def own_zygote():
    """A warm process that finds the functions beside this file."""
    patch = pytest.MonkeyPatch()
    with patch.context() as patched:
        patched.setenv("PYTHONPATH", str(HERE))
        zygote = process._Zygote()
        patched.setattr(process, "_zygote", zygote)
        yield zygote
        zygote.close()


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "table.csv"
    path.write_text("fx,ux")
    return path


def run(name, file, limits=SMALL, **arguments):
    return fenced(f"hostile_readers:{name}", file, arguments, limits)


def test_what_a_function_answers_comes_back_as_it_was(file):
    first, second = run("doubled", file, factor=2)
    assert first.fields == {"read": "fx,ux", "factor": 2}
    np.testing.assert_array_equal(first.arrays["rows"], np.arange(6.0).reshape(2, 3))
    assert second.arrays["none"].shape == (0, 6)
    assert second.arrays["flags"].tolist() == [True, False]


@pytest.mark.parametrize(
    ("name", "limits", "error"),
    [
        ("greedy", SMALL, FenceMemoryError),
        ("endless", SHORT, FenceTimeError),
        ("asleep", SHORT, FenceTimeError),
        ("wordy", SMALL, FenceSizeError),
        ("crashing", SMALL, FenceCrashError),
    ],
)
def test_a_file_that_takes_too_much_is_an_error_by_name_and_the_next_one_is_read(
    file, name, limits, error
):
    with pytest.raises(error):
        run(name, file, limits)
    assert run("doubled", file, factor=1)


def test_an_exception_comes_back_by_its_name_without_its_traceback(file):
    with pytest.raises(RaisedInFenceError, match=r"^there is no such column$") as caught:
        run("refusing", file)
    assert caught.value.kind == "LookupError"


def test_an_answer_that_is_not_of_the_form_is_refused(file):
    with pytest.raises(FenceCrashError, match="answer cannot be used"):
        run("lying", file)


def test_a_function_that_is_not_there_is_an_error_and_not_a_wait(file):
    with pytest.raises(RaisedInFenceError):
        fenced("no_such_module:read", file)


def test_the_warm_process_imports_no_finite_elements_and_is_started_once(file):
    told = [run("modules", file)[0].fields for _ in range(2)]
    assert "skfem" not in told[0]["modules"]
    assert told[0]["pid"] != told[1]["pid"]  # a warden each


def test_a_warm_process_that_was_killed_is_replaced(file, own_zygote):
    run("doubled", file, factor=1)
    own_zygote._child.kill()
    own_zygote._child.wait()
    assert run("doubled", file, factor=3)[0].fields["factor"] == 3


def test_no_more_files_are_read_at_once_than_there_are_places(file, monkeypatch):
    monkeypatch.setattr(process, "WAIT_S", 0.05)
    taken = [process._places.acquire(timeout=10) for _ in range(process.AT_ONCE)]
    try:
        with pytest.raises(FenceBusyError):
            run("doubled", file, factor=1)
    finally:
        for _ in taken:
            process._places.release()


def test_several_threads_get_their_own_answers(file):
    found = {}

    def ask(number):
        found[number] = run("doubled", file, factor=number)[0].fields["factor"]

    threads = [threading.Thread(target=ask, args=(number,)) for number in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found == {number: number for number in range(8)}


def test_no_descriptor_is_left_open_in_the_server(file):
    run("doubled", file, factor=1)
    before = len(list(Path("/proc/self/fd").iterdir()))
    for _ in range(5):
        run("doubled", file, factor=1)
    assert len(list(Path("/proc/self/fd").iterdir())) <= before + 1


def test_a_program_is_held_to_its_limits_and_its_print_comes_back(tmp_path):
    printed = program("fea.check", str(tmp_path), limits=Limits(2048 * MIB, 60.0))
    assert printed.out.startswith("{")
