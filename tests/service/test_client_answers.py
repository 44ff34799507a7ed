"""The client reads any answer there may be on a wire, however it comes."""

import http.client
import socket
import threading
from contextlib import contextmanager

import pytest

from wrenchbook.service.client import Client, ProblemError, ServerUnreachable
from wrenchbook.service.client.transport import Connection, receive

OK = b"HTTP/1.1 200 OK\r\nContent-Length: 8\r\nETag: 7\r\n\r\n" + b'{"a": 1}'
CHUNKED = (
    b'HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n4\r\n{"a"\r\n4\r\n: 1}\r\n0\r\n\r\n'
)


@contextmanager
def answering(*pieces):
    """A socket on which these pieces come, each when the one before has been taken."""
    here, there = socket.socketpair()
    here.settimeout(10)

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


def test_an_ordinary_answer_is_read_with_its_headers():
    with answering(OK) as wire:
        found = receive(wire, "POST")
    assert (found.status, found.content, found.will_close) == (200, b'{"a": 1}', False)
    assert found.headers["etag"] == "7"


@pytest.mark.parametrize("whole", [OK, CHUNKED], ids=["length", "chunked"])
def test_an_answer_may_come_in_any_pieces(whole):
    for cut in range(1, len(whole)):
        here, there = socket.socketpair()
        with here, there:
            here.settimeout(10)
            there.sendall(whole[:cut])
            timer = threading.Timer(0.0, there.sendall, [whole[cut:]])
            timer.start()
            assert receive(here, "POST").content == b'{"a": 1}'
            timer.join()


@pytest.mark.parametrize(
    ("whole", "status", "content", "will_close"),
    [
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
        found = receive(wire, "POST")
    assert (found.status, found.content, found.will_close) == (status, content, will_close)


@pytest.mark.parametrize("whole", [b"", OK[:40], OK[:-1], b"SSH-2.0-x\r\n\r\n", CHUNKED[:-9]])
def test_an_answer_that_breaks_off_or_is_none_is_said_to(whole):
    with answering(whole) as wire, pytest.raises((http.client.HTTPException, OSError)):
        receive(wire, "POST")


def test_a_head_with_a_line_break_in_it_is_not_sent():
    with pytest.raises(ValueError, match="printable"):
        Connection("http://127.0.0.1:9").call("GET", "/a", headers={"X": "1\r\nY: 2"})


def test_something_else_that_listens_is_told_from_a_server():
    bound = socket.create_server(("127.0.0.1", 0))

    def greet():
        other, _ = bound.accept()
        with other:
            other.sendall(b"220 mail ready\r\n\r\n")

    thread = threading.Thread(target=greet)
    thread.start()
    with bound, pytest.raises((ServerUnreachable, ProblemError)):
        Client(f"http://127.0.0.1:{bound.getsockname()[1]}", timeout=10).components()
    thread.join()
