"""Keep-alive, reconnection, time limits and threads of the client."""

from __future__ import annotations

import http.client
import json
import socket
import ssl
import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from select import select

import pytest

from tests.service.stub_server import Answer, Stub
from tests.until import until
from wrenchbook.service.client import Client, ProblemError, ServerTimeout, ServerUnreachable
from wrenchbook.service.client.transport import Connection, receive

DONE = {"id": 1, "status": "done"}


def test_calls_in_a_loop_stay_on_one_socket(stub: Stub, client: Client):
    for _ in range(20):
        client.job(1)
    assert len(stub.seen) == 20
    assert len(set(stub.sockets)) == 1


def test_a_problem_does_not_cost_the_connection(stub: Stub, client: Client):
    stub.answers(Answer({}, status=503), Answer(DONE))
    client.is_ready()
    client.job(1)
    assert len(set(stub.sockets)) == 1


def test_a_connection_that_the_server_closed_is_made_anew_once(stub: Stub, client: Client):
    stub.answers(Answer(DONE, close=True), Answer(DONE))
    client.job(1)
    select([client._idle[0].sock], [], [])  # the server's end arrives
    assert client.job(1).ended
    assert len(stub.seen) == 2
    assert len(set(stub.sockets)) == 2


def test_a_server_that_hangs_up_on_a_new_connection_is_not_asked_again(stub: Stub, client: Client):
    stub.answers(Answer(drop=True))
    with pytest.raises(ServerUnreachable, match="closed the connection before its reply"):
        client.job(1)
    assert len(stub.seen) == 1


def test_a_call_that_must_not_be_repeated_never_takes_a_kept_connection(stub: Stub, client: Client):
    client.job(1)
    stub.answers(Answer(drop=True))
    with pytest.raises(ServerUnreachable):
        client.retry(1)
    assert [seen.method for seen in stub.seen] == ["GET", "POST"]
    assert len(set(stub.sockets)) == 2


def test_nothing_listening_says_how_to_start_a_server():
    with socket.socket() as closed:
        closed.bind(("127.0.0.1", 0))
        address = f"http://127.0.0.1:{closed.getsockname()[1]}"
    client = Client(address, timeout=1.0)
    with pytest.raises(ServerUnreachable, match=rf"no answer from {address} .*wrenchbook serve"):
        client.components()
    assert not client.is_ready()


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (socket.gaierror(-2, "unknown"), r"no host has the name 'lab'.*correct the address"),
        (ssl.SSLError("wrong version"), "no encrypted connection to .*write http://"),
        (http.client.BadStatusLine("SSH-2.0"), "is not HTTP .*correct host and port"),
        (OSError(113, "no route"), "no answer from .*wrenchbook serve"),
    ],
)
def test_each_cause_of_no_connection_has_its_own_remedy(monkeypatch, error, words):
    def fail(*_, **__):
        raise error

    monkeypatch.setattr(http.client.HTTPConnection, "connect", fail)
    client = Client("http://lab:8000", timeout=1.0)
    for call in (client.components, lambda: next(client.events())):
        with pytest.raises(ServerUnreachable, match=words):
            call()


def test_a_server_that_is_restarting_is_waited_for(monkeypatch: pytest.MonkeyPatch):
    """The port refuses connections until the third pause between two attempts."""
    with socket.socket() as bound:
        bound.bind(("127.0.0.1", 0))
        pauses: list[float] = []

        def begin_to_listen(seconds: float) -> None:
            pauses.append(seconds)
            if len(pauses) == 3:
                bound.listen()
                threading.Thread(target=answer_once, args=(bound,)).start()

        monkeypatch.setattr("wrenchbook.service.client.transport._pause", begin_to_listen)
        with Client(f"http://127.0.0.1:{bound.getsockname()[1]}", timeout=5.0) as client:
            assert client.retry(1).ended
    assert pauses == [0.1, 0.2, 0.4]


def answer_once(bound: socket.socket) -> None:
    """Answer one request with a job that is done."""
    other, _ = bound.accept()
    with other:
        other.recv(65_536)
        other.sendall(b"HTTP/1.1 200 OK\r\nContent-Length: 27\r\n\r\n" + json.dumps(DONE).encode())


@pytest.fixture
def pauses(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The pauses between attempts, which take no time."""
    result: list[float] = []
    monkeypatch.setattr("wrenchbook.service.client.transport._pause", result.append)
    return result


BUSY = Answer({}, status=503, headers={"Retry-After": "2"})


def test_a_busy_server_is_called_again_when_it_says(stub: Stub, client: Client, pauses):
    stub.answers(BUSY, Answer(DONE))
    assert client.job(1).ended
    assert pauses == [2.0]


def test_a_call_that_must_not_be_repeated_is_sent_to_a_busy_server_once(
    stub: Stub, client: Client, pauses
):
    stub.answers(BUSY, Answer(DONE))
    with pytest.raises(ProblemError, match="503"):
        client.retry(1)
    assert (len(stub.seen), pauses) == (1, [])


def test_a_busy_server_is_not_waited_for_beyond_the_timeout(stub: Stub, pauses):
    stub.answers(Answer({}, status=503, headers={"Retry-After": "1000"}))
    with Client(stub.url, timeout=600) as client, pytest.raises(ProblemError, match="503"):
        client.job(1)
    assert (len(stub.seen), pauses) == (1, [])


def test_a_time_to_retry_that_is_no_number_is_unknown(stub: Stub, client: Client):
    stub.answers(Answer({}, status=503, headers={"Retry-After": "\u00b2"}))
    with pytest.raises(ProblemError, match="503") as caught:
        client.job(1)
    assert caught.value.retry_after is None


def test_the_representation_of_a_client_shows_its_address_and_no_key():
    shown = repr(Client("127.0.0.1:8000", key="secret"))
    assert shown == "Client('http://127.0.0.1:8000', timeout=30, key=...)"


def test_a_slow_answer_is_a_timeout_and_not_sent_again(stub: Stub):
    stub.answers(Answer(held=True))
    with Client(stub.url, timeout=0.2) as client:
        with pytest.raises(ServerTimeout, match=r"within 0\.2 s"):
            client.job(1)
        until(lambda: len(stub.seen) == 1)
        stub.answers(Answer(DONE))
        client.timeout = 60.0
        assert client.job(1).ended  # and the half-read connection is not used again
    assert len(set(stub.sockets)) == 2


def test_the_time_the_server_is_asked_to_wait_is_added_to_the_limit(stub: Stub):
    with Client(stub.url, timeout=30.0) as client:
        for wait_s, limit in ((2.0, 32.0), (None, 30.0)):  # each on the kept connection
            assert client.job(1, wait_s=wait_s).ended
            assert client._idle[0].sock.gettimeout() == limit
    assert len(set(stub.sockets)) == 1


def test_threads_share_a_client_and_never_a_connection(stub: Stub, client: Client):
    together = threading.Barrier(4, timeout=600)

    def respond(seen) -> Answer:
        together.wait()  # four requests are inside at once
        return Answer({"id": int(seen.path.rsplit("/", 1)[1]), "status": "done"})

    stub.respond = respond
    with ThreadPoolExecutor(4) as threads:
        ids = [job.id for job in threads.map(client.job, range(40))]
    assert ids == list(range(40))
    assert len(set(stub.sockets)) <= 8


def test_close_lets_go_of_sockets_and_a_later_call_opens_one(stub: Stub, client: Client):
    client.job(1)
    client.close()
    client.job(1)
    assert len(set(stub.sockets)) == 2


def test_a_server_below_a_path_is_reached_there(stub: Stub):
    with Client(f"{stub.url}/workspace/") as client:
        client.job(1)
    assert stub.seen[0].path == "/workspace/v1/jobs/1"


@pytest.mark.parametrize("url", ["ftp://host", "http://", "://x"])
def test_an_address_that_is_none_is_refused_with_an_example(url: str):
    with pytest.raises(ValueError, match=r"http://127\.0\.0\.1:8000"):
        Client(url)


def test_a_forked_child_leaves_its_parents_connection_alone(
    stub: Stub, client: Client, monkeypatch
):
    client.job(1)
    parents = list(client._idle)
    monkeypatch.setattr("os.getpid", lambda: -1)
    client.job(1)
    assert len(set(stub.sockets)) == 2
    assert parents[0].sock is not None  # neither closed nor written to by the child
    parents[0].close()


# -- answers as they come -------------------------------------------------------------------------


OK = b"HTTP/1.1 200 OK\r\nContent-Length: 8\r\nETag: 7\r\n\r\n" + b'{"a": 1}'
CHUNKED = (
    b'HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n4\r\n{"a"\r\n4\r\n: 1}\r\n0\r\n\r\n'
)


@contextmanager
def answering(*pieces):
    """A socket on which these pieces come, each when the one before has been taken."""
    here, there = socket.socketpair()
    here.settimeout(600)

    def feed():
        for piece in pieces:
            there.sendall(piece)
        there.shutdown(socket.SHUT_WR)

    thread = threading.Thread(target=feed)
    thread.start()
    try:
        yield here
    finally:
        here.close()
        thread.join()
        there.close()


@pytest.mark.parametrize("whole", [OK, CHUNKED], ids=["length", "chunked"])
def test_an_answer_may_come_in_any_pieces(whole):
    for cut in range(1, len(whole)):
        here, there = socket.socketpair()
        with here, there:
            here.settimeout(600)
            there.sendall(whole[:cut])
            timer = threading.Timer(0.0, there.sendall, [whole[cut:]])
            timer.start()
            assert receive(here, "POST").content == b'{"a": 1}'
            timer.join()


@pytest.mark.parametrize(
    ("whole", "status", "content", "will_close"),
    [
        (OK, 200, b'{"a": 1}', False),
        (b"HTTP/1.1 204 No Content\r\n\r\n", 204, b"", False),
        (b"HTTP/1.1 200 OK\r\nContent-Length: 0\r\n\r\n", 200, b"", False),
        (b"HTTP/1.1 200 OK\r\n\r\nall that comes", 200, b"all that comes", True),
        (b"HTTP/1.0 200 OK\r\nContent-Length: 2\r\n\r\nok", 200, b"ok", True),
        (OK.replace(b"ETag: 7", b"Connection: close"), 200, b'{"a": 1}', True),
        (b"HTTP/1.1 100 Continue\r\n\r\n" + OK, 200, b'{"a": 1}', False),
        (OK.replace(b"Content-Length: 8", b"content-length:8"), 200, b'{"a": 1}', False),
        (OK.replace(b"200 OK", b"404 Not Found"), 404, b'{"a": 1}', False),
    ],
)
def test_an_unusual_answer_is_read_as_http_client_reads_it(whole, status, content, will_close):
    with answering(whole) as wire:
        result = receive(wire, "POST")
    assert (result.status, result.content, result.will_close) == (status, content, will_close)


@pytest.mark.parametrize("whole", [b"", OK[:40], OK[:-1], b"SSH-2.0-x\r\n\r\n", CHUNKED[:-9]])
def test_an_answer_that_breaks_off_or_is_none_is_said_to(whole):
    """As that of a mail server, which is no server of ours."""
    with answering(whole) as wire, pytest.raises((http.client.HTTPException, OSError)):
        receive(wire, "POST")


def test_a_head_with_a_line_break_in_it_is_not_sent():
    with pytest.raises(ValueError, match="printable"):
        Connection("http://127.0.0.1:9").call("GET", "/a", headers={"X": "1\r\nY: 2"})
