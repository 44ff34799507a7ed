"""The recorder: it never waits for the server, loses nothing in silence, sends each block once."""

import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

from tests.service.stub_server import Answer, running_stub
from tests.until import until
from wrenchbook.service.client import (
    Client,
    InvalidArgument,
    ProblemError,
    Recorder,
    RecorderError,
    ServerTimeout,
)
from wrenchbook.service.client import recorder as recorder_module

ROOT = Path(__file__).parents[2]
WRENCH = [1.0, 2, 3, 4, 5, 6]
PROBLEM = {"type": "urn:x", "title": "No such component", "status": 404, "detail": "it has: bar"}


@pytest.fixture
def server():
    with running_stub() as running:
        running.answers(Answer({"recorded": 1, "duplicate": False}, 201))
        yield running


@pytest.fixture
def client(server):
    with Client(server.url, timeout=600) as created:
        yield created


@pytest.fixture
def recorder(client, monkeypatch):
    """A recorder whose incomplete blocks wait for a flush, however slow the test is."""
    monkeypatch.setattr(recorder_module, "FLUSH_S", 600.0)
    created = Recorder(client, "plate", block=4)
    yield created
    if created.pending:
        with pytest.raises(RecorderError):
            created.close(0.2)
    else:
        created.close()


def sent(server):
    """The wrenches that came, and the keys of their blocks."""
    content = b"".join(item.content for item in server.seen)
    return np.frombuffer(content, "<f8").reshape(-1, 6), [item.path for item in server.seen]


def test_a_recorder_of_13_inputs_sends_13_numbers_a_wrench(server, client):
    with Recorder(client, "link", block=4, inputs=13) as recorder:
        with pytest.raises(ValueError, match="a wrench must be 13 numbers"):
            recorder.add(WRENCH)
        recorder.add(np.arange(13.0))
        assert recorder.unsent().tolist() == [list(range(13))]
    assert np.frombuffer(server.seen[-1].content, "<f8").tolist() == list(range(13))


def test_a_recorder_sends_the_numbers_of_a_wrench_with_each_block(server, recorder):
    recorder.add(WRENCH)
    recorder.flush()
    assert "inputs=6" in server.seen[-1].path


def test_what_is_added_comes_in_blocks_in_order_under_counted_keys(server, recorder):
    wrenches = np.arange(60.0).reshape(10, 6)
    for wrench in wrenches:
        recorder.add(wrench)
    recorder.flush()
    came, paths = sent(server)
    assert np.array_equal(came, wrenches)
    assert [len(item.content) // 48 for item in server.seen] == [4, 4, 2]
    assert [path.rpartition("sequence=")[2] for path in paths] == ["0", "1", "2"]
    assert len({path.rpartition("&")[0] for path in paths}) == 1
    assert (recorder.recorded, recorder.pending) == (10, 0)


def test_adding_does_not_wait_for_a_server_that_hangs(server, recorder):
    release = threading.Event()
    server.respond = lambda _: (release.wait(600), Answer({"recorded": 1}, 201))[1]
    for _ in range(1000):
        recorder.add(WRENCH)
    assert recorder.pending == 1000  # no answer has come
    release.set()
    recorder.flush()
    assert len(sent(server)[0]) == 1000


def test_a_block_whose_reply_is_lost_is_sent_again_under_the_same_key(server, recorder):
    server.answers(Answer(drop=True), Answer({}, 503), Answer({"recorded": 4}, 201))
    for _ in range(4):
        recorder.add(WRENCH)
    recorder.flush()
    paths = sent(server)[1]
    assert len(paths) >= 3
    assert len(set(paths)) == 1
    assert recorder.recorded == 4


def test_while_the_server_is_away_wrenches_are_kept_and_flush_says_so():
    recorder = Recorder(Client("http://127.0.0.1:9", timeout=1), "plate", block=4)
    for _ in range(6):
        recorder.add(WRENCH)
    until(lambda: recorder.trouble)  # after a first try
    with pytest.raises(ServerTimeout, match="6 wrenches are not recorded"):
        recorder.flush(0.3)
    assert recorder.trouble is not None
    assert "no answer from" in recorder.trouble
    assert recorder.unsent().tolist() == [WRENCH] * 6
    with pytest.raises(RecorderError, match="6 wrenches are not recorded for 'plate'"):
        recorder.close(0.2)


def test_what_the_server_refuses_is_raised_by_the_next_add_with_its_words(server, client):
    server.answers(Answer(PROBLEM, 404, "application/problem+json"))
    recorder = Recorder(client, "nope", block=1)
    recorder.add(WRENCH)
    with pytest.raises(RecorderError, match="it has: bar"):
        recorder.flush(600)
    with pytest.raises(RecorderError, match="it has: bar"):
        recorder.add(WRENCH)
    assert recorder.unsent().tolist() == [WRENCH]
    assert len(server.seen) == 1
    with pytest.raises(RecorderError):
        recorder.close(0.2)


def test_an_argument_that_is_not_valid_is_raised_and_not_sent_for_ever(client, monkeypatch):
    """It is a ValueError, and so counted as an error that passes."""

    def refuse(*_):
        raise InvalidArgument("component must be a name")

    monkeypatch.setattr(client, "send_block", refuse)
    recorder = Recorder(client, "plate", block=1)
    recorder.add(WRENCH)
    with pytest.raises(RecorderError, match="component must be a name"):
        recorder.flush(600)
    with pytest.raises(RecorderError):
        recorder.close(0.2)


def test_a_second_close_names_the_lost_wrenches_again():
    recorder = Recorder(Client("http://127.0.0.1:9", timeout=1), "plate")
    recorder.add(WRENCH)
    for _ in range(2):
        with pytest.raises(RecorderError, match="1 wrench is not recorded for 'plate'"):
            recorder.close(0.2)


@pytest.mark.parametrize("flushes", [1, 2])
def test_a_flush_that_is_over_leaves_the_next_pause_as_it_is(recorder, flushes):
    recorder.add(WRENCH)
    for _ in range(flushes):
        recorder.flush()
    assert not recorder._hurry


def test_a_slow_loop_is_recorded_within_seconds_although_no_block_is_whole(server, client):
    recorder = Recorder(client, "plate", block=4)
    recorder.add(WRENCH)
    until(lambda: server.seen)
    assert sent(server)[0].tolist() == [WRENCH]
    recorder.close()


def test_a_wrench_that_is_none_is_refused_and_not_taken(recorder):
    for bad in ([1, 2, 3], [1, 2, 3, 4, 5, np.nan], ["a"] * 6, [[1] * 6]):
        with pytest.raises(ValueError):
            recorder.add(bad)
    assert recorder.pending == 0


def test_a_recorder_that_is_closed_takes_nothing(recorder):
    recorder.add(WRENCH)
    recorder.close()
    with pytest.raises(RecorderError, match="closed"):
        recorder.add(WRENCH)


def test_leaving_the_block_sends_what_is_left(server, client):
    with Recorder(client, "plate") as recorder:
        recorder.add(WRENCH)
    assert sent(server)[0].tolist() == [WRENCH]


@pytest.mark.parametrize(("kind", "block"), [("tape", 4), ("recording", 0), ("recording", 10_001)])
def test_a_wrong_kind_or_block_is_refused(kind, block):
    with pytest.raises(ValueError):
        Recorder(Client("http://127.0.0.1:9"), "plate", kind=kind, block=block)


def test_an_envelopes_blocks_go_to_the_envelope_and_its_start_too(server, client):
    started = {"jobs": [], "solved": 0, "covered": 0, "failed": 0, "beyond_range": 0, "left": 0}
    server.answers(Answer({"recorded": 1}, 201), Answer({**started, "reason": "r"}))
    with Recorder(client, "plate", kind="envelope") as recorder:
        recorder.add(WRENCH)
        assert recorder.start().reason == "r"
    assert server.seen[0].path.startswith("/v1/components/plate/envelope?client=")
    assert server.seen[1].path == "/v1/components/plate/envelope/start"


def test_a_start_that_cannot_be_is_the_servers_problem(server, recorder):
    server.answers(Answer({"recorded": 1}, 201), Answer(PROBLEM, 409, "application/problem+json"))
    recorder.add(WRENCH)
    with pytest.raises(ProblemError, match="it has: bar"):
        recorder.start()


def test_a_full_memory_refuses_the_wrench_and_keeps_all_others(monkeypatch):
    monkeypatch.setattr(recorder_module, "MAX_PENDING", 10)
    recorder = Recorder(Client("http://127.0.0.1:9"), "plate", block=4)
    for _ in range(10):
        recorder.add(WRENCH)
    with pytest.raises(RecorderError, match="10 wrenches wait for the server"):
        recorder.add(WRENCH)
    assert recorder.unsent().tolist() == [WRENCH] * 10
    with pytest.raises(RecorderError):
        recorder.close(0.2)


FORGETFUL = """
import sys
from wrenchbook.service.client import Client, Recorder
recorder = Recorder(Client(sys.argv[1], timeout=600), "plate")
recorder.add([1.0, 2, 3, 4, 5, 6])
"""


INTERRUPTED = """
def interrupt(*_):
    raise KeyboardInterrupt
flush, recorder.flush = recorder.flush, interrupt
try:
    recorder.close()
except KeyboardInterrupt:
    recorder.flush = flush
"""


def run_forgetful(url, more=""):
    run = [sys.executable, "-c", FORGETFUL + more, url]
    return subprocess.run(run, cwd=ROOT, capture_output=True, text=True, timeout=600, check=True)


def test_a_program_that_forgets_to_close_sends_what_is_left(server):
    assert run_forgetful(server.url).stderr == ""
    assert sent(server)[0].tolist() == [WRENCH]


def test_a_program_that_ends_while_the_server_is_away_says_what_is_lost():
    reported = run_forgetful("http://127.0.0.1:9").stderr
    assert "1 wrench is not recorded for 'plate'" in reported
    assert "no answer from" in reported


def test_a_close_that_is_interrupted_still_says_at_the_end_what_is_lost():
    reported = run_forgetful("http://127.0.0.1:9", INTERRUPTED).stderr
    assert "1 wrench is not recorded for 'plate'" in reported
