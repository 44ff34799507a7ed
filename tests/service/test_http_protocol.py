"""The fast path and the usual path of the main call give the same replies, whatever is sent."""

import contextlib
import logging
import math
import re
import signal
import socket
import struct
import threading
from contextlib import closing

import numpy as np
import orjson
import pytest
from pydantic import ValidationError

from tests.refusals import tables
from tests.service.live import (
    FULL,
    add_rows,
    add_table,
    as_rows,
    full_wrenches,
    moved,
    served,
    tangents,
)
from tests.until import until
from wrenchbook.service.http import protocol
from wrenchbook.service.http.bodies import CopyBody, FillBody
from wrenchbook.service.http.permission import Permission
from wrenchbook.service.http.protocol import FastPath, FastPathProtocol
from wrenchbook.service.http.routes.keys import KeyBody
from wrenchbook.service.http.server import Server, server_config
from wrenchbook.service.keys import Keyring

PATH = "/v1/components/solved/displacement"
PLAIN = {"force": [10.0, -20.0, 30.0], "moment": [1.0, 2.0, -3.0]}
BODY = orjson.dumps(PLAIN)


@pytest.fixture(scope="module")
def client(tmp_path_factory):
    wrenches = full_wrenches(40)
    rows = as_rows(wrenches, moved(wrenches), tangents(wrenches))
    with served(tmp_path_factory.mktemp("workspace")) as client:
        add_table(client, "solved", rows, tolerance={"translation": 1.0, "rotation": 1.0})
        yield client


@pytest.fixture(scope="module")
def port(client):
    return int(client.url.rsplit(":", 1)[1])


@pytest.fixture
def straight(monkeypatch):
    """Return how many questions were answered straight so far."""
    results = []
    ask = FastPath.answer

    def counted(self, head, body):
        content = ask(self, head, body)
        results.append(isinstance(content, bytes))
        return content

    monkeypatch.setattr(FastPath, "answer", counted)
    return lambda: sum(results)


def request(body=BODY, path=PATH, verb="POST", fields=(), length=None):
    length = len(body) if length is None else length
    lines = [f"{verb} {path} HTTP/1.1", "Host: x", *fields, f"Content-Length: {length}"]
    return "\r\n".join([*lines, "", ""]).encode() + body


def chunked(*pieces):
    head = f"POST {PATH} HTTP/1.1\r\nHost: x\r\nTransfer-Encoding: chunked\r\n\r\n".encode()
    reported = b"".join(b"%x\r\n%b\r\n" % (len(piece), piece) for piece in pieces)
    return head + reported + b"0\r\n\r\n"


class Wire:
    """One connection, read reply by reply."""

    def __init__(self, port):
        self.socket = socket.create_connection(("127.0.0.1", port), timeout=600)
        self.left = b""

    def send(self, *pieces):
        for piece in pieces:
            self.socket.sendall(piece)

    def reply(self, *, bodyless=False):
        """Return status, headers and body of the next reply."""
        while b"\r\n\r\n" not in self.left:
            self._more()
        head, _, self.left = self.left.partition(b"\r\n\r\n")
        status, *lines = head.decode().split("\r\n")
        headers = {k.lower(): v for k, v in (line.split(": ", 1) for line in lines)}
        length = 0 if bodyless else int(headers["content-length"])
        while len(self.left) < length:
            self._more()
        body, self.left = self.left[:length], self.left[length:]
        return int(status.split()[1]), headers, body

    def _more(self):
        came = self.socket.recv(65536)
        assert came, f"closed after {self.left!r}"
        self.left += came

    def ask(self, *pieces):
        self.send(*pieces)
        return self.reply()

    def close(self):
        self.socket.close()


@pytest.fixture
def wire(port):
    with closing(Wire(port)) as result:
        yield result


def same(body):
    """What two answers to one question share: all but the time they took."""
    return {key: value for key, value in orjson.loads(body).items() if key != "elapsed_us"}


def test_a_plain_question_goes_straight_at_first_and_when_its_head_is_known(straight, wire):
    for count in (1, 2, 3):
        assert wire.ask(request())[0] == 200
        assert straight() == count


def test_an_estimate_is_counted_on_both_ways_and_says_which_job_solves_a_compliance(wire, client):
    """A linear part with a measured row has no compliance until it is solved."""
    row = {"wrench": [100.0, 0, 0, 0, 0, 0], "displacement": [1e-6] * 6, "source": "measured"}
    add_rows(client, "bar", [row])
    body = BODY[:-1] + b', "on_thin": "estimate"}'
    path = "/v1/components/bar/displacement"
    reason = orjson.loads(wire.ask(request(body, path))[2])["reason"]
    assert "solves the component's compliance; ask again once it is done" in reason
    far = body.replace(b"10.0", b"1e4")
    counts = []
    for item in (None, far, far[:-1] + b', "detail": false}'):
        if item:
            assert orjson.loads(wire.ask(request(item))[2])["coverage"] == "outside"
        demand = wire.ask(request(b"", "/v1/components/solved/demand", "GET"))[2]
        counts.append(orjson.loads(demand)["asked"])
    assert np.diff(counts).tolist() == [1, 1]


@pytest.mark.parametrize("fields", [[], ["X-Request-ID: req-7"], ["X-Request-ID: "]])
def test_both_ways_give_the_same_bytes(straight, wire, monkeypatch, fields):
    monkeypatch.setattr("wrenchbook.service.query.perf_counter_ns", lambda: 0)
    replies = []
    for body in (BODY, orjson.dumps({**PLAIN, "detail": False})):
        wire.ask(request(body, fields=fields))
        wire.send(request(body, fields=fields))
        head = b""
        while b"\r\n\r\n" not in head:
            head += wire.socket.recv(1)
        length = int(re.search(rb"content-length: (\d+)", head)[1])
        replies.append(re.sub(rb"date: [^\r]*", b"", head) + wire.socket.recv(length))
    assert straight() == 2
    assert replies[0] == replies[1]


def test_a_query_with_an_id_goes_straight_and_its_reply_has_the_id(straight, wire):
    for number in (1, 2):
        _, headers, _ = wire.ask(request(fields=[f"X-Request-ID: req-{number}"]))
        assert headers["x-request-id"] == f"req-{number}"
    assert straight() == 2
    assert "x-request-id" not in wire.ask(request())[1]


@pytest.mark.parametrize("given", ["a b", "x" * 129])
def test_an_id_that_is_not_valid_is_replaced_by_the_usual_way(straight, wire, given):
    status, headers, _ = wire.ask(request(fields=[f"X-Request-ID: {given}"]))
    assert (status, len(headers["x-request-id"])) == (200, 16)
    assert straight() == 0


def test_a_body_that_comes_after_its_head_goes_straight(straight, wire):
    whole = request()
    cut = whole.index(b"\r\n\r\n") + 4
    for end in (cut, cut + 5, len(whole) - 1):
        assert wire.ask(whole[:end], whole[end:])[0] == 200
    assert straight() == 3


REFUSED = {
    "a page of another site": ("Sec-Fetch-Site: cross-site", 403),
    "a page of the same site": ("Sec-Fetch-Site: same-site", 403),
    "another origin": ("Origin: http://evil.example", 403),
    "a second host": ("Host: evil.example", 400),
    "a form": ("Content-Type: application/x-www-form-urlencoded", 415),
}


@pytest.mark.parametrize(("field", "refused"), REFUSED.values(), ids=REFUSED)
def test_the_fast_path_answers_no_request_that_the_ordinary_path_refuses(
    straight, wire, field, refused
):
    long_head = f"X-Pad: {'a' * 2100}"  # beyond the heads of the fast path
    for body in (BODY, orjson.dumps({**PLAIN, "on_thin": "estimate"})):
        assert wire.ask(request(body, fields=[field]))[0] == refused
        assert wire.ask(request(body, fields=[field, long_head]))[0] == refused
    assert straight() == 0


@pytest.mark.parametrize("field", ["Sec-Fetch-Site: none", "Sec-Fetch-Site: same-origin"])
def test_a_query_of_the_servers_own_page_takes_the_fast_path(straight, wire, field):
    assert wire.ask(request(fields=[field]))[0] == 200
    assert straight() == 1


def test_a_question_may_come_in_any_pieces(straight, wire):
    whole = request()
    expected = same(wire.ask(whole)[2])
    for cut in range(1, len(whole), 7):
        assert same(wire.ask(whole[:cut], whole[cut:])[2]) == expected


def test_pipelined_questions_are_answered_in_their_order(wire):
    pushes = [float(push) for push in range(30)]
    bodies = [orjson.dumps({**PLAIN, "force": [push, 0.0, 0.0]}) for push in pushes]
    bodies[3] = b"{"
    wire.send(b"".join(map(request, bodies)))
    replies = [wire.reply() for _ in bodies]
    assert [status for status, _, _ in replies] == [422 if k == 3 else 200 for k in range(30)]
    reported = [
        orjson.loads(body)["translation"][0] for status, _, body in replies if status == 200
    ]
    assert (np.diff(reported) > 0).all()  # as the pushes do


def test_a_piece_that_ends_like_a_whole_question_inside_another_is_not_taken_for_one(wire):
    """The second body is the start of a longer one: what follows belongs to it."""
    inner = request()
    tail = b" " * (len(inner) - 10) + b"," * 10
    assert wire.ask(inner)[0] == 200
    wire.send(inner + request(length=len(BODY) + len(inner) + len(tail)))
    assert wire.reply()[0] == 200
    wire.send(inner, tail)  # all of it is body: two JSON texts and more are none
    assert wire.reply()[0] == 422
    assert wire.ask(inner)[0] == 200


def test_a_question_inside_a_header_is_none(straight, wire):
    assert wire.ask(request())[0] == 200
    before = straight()
    wire.send(b"GET /health/live HTTP/1.1\r\nX-Y: ")
    assert wire.ask(request(b""))[0] == 200  # its first line ends the header X-Y
    assert straight() == before


def test_after_a_usual_call_questions_go_straight_again(straight, wire):
    for _ in range(2):
        assert wire.ask(request())[0] == 200
        assert wire.ask(b"GET /health/live HTTP/1.1\r\nHost: x\r\n\r\n")[0] == 200
        assert wire.ask(request(b"{"))[0] == 422
    assert straight() == 2


def test_a_chunked_body_is_read(wire):
    expected = same(wire.ask(request())[2])
    for _ in range(2):
        status, _, body = wire.ask(chunked(BODY[:9], BODY[9:]))
        assert (status, same(body)) == (200, expected)


def test_connection_close_is_heeded(wire):
    status, headers, _ = wire.ask(request(fields=["Connection: close"]))
    assert (status, headers["connection"]) == (200, "close")
    assert wire.socket.recv(1) == b""


def test_expect_100_continue_is_answered_before_the_body(wire):
    head = request(b"", fields=["Expect: 100-continue"], length=len(BODY))
    wire.send(head)
    assert wire.reply(bodyless=True)[0] == 100
    assert wire.ask(BODY)[0] == 200


def test_more_heads_than_are_kept_do_no_harm(wire):
    for number in range(200):
        assert wire.ask(request(fields=[f"X-Number: {number}"]))[0] == 200
    assert wire.ask(request())[0] == 200


def test_a_client_that_does_not_read_is_not_written_to_without_end(port):
    """Its questions wait: what the server holds for it stays bounded."""
    with closing(Wire(port)) as wire:
        wire.socket.settimeout(1)
        questions = request() * 1000
        with pytest.raises(TimeoutError):  # long before 100 MB of answers
            wire.send(*([questions] * 150))
        wire.socket.settimeout(600)
        assert wire.reply()[0] == 200
    with closing(Wire(port)) as other:
        assert other.ask(request())[0] == 200


DEEP = b"[" * 5000 + b"]" * 5000
NUMBERS = b'{"force": [%b, 0, 0], "moment": [0, 0, 0]}'
BAD = {name: case["text"].encode() for name, case in tables(__file__)["bodies"].items()} | {
    "blanks": b" " * 60_000,
    "another encoding": BODY.decode().encode("utf-16"),
    "half a character": b'{"force": "\xff"}',
    "deep lists": DEEP,
    "deep lists as a force": b'{"force": ' + DEEP + b"}",
    "deep objects": b'{"force":' * 900 + b"1" + b"}" * 900,
    "an integer beyond float64": NUMBERS % (b"9" * 400),
}


@pytest.mark.parametrize(
    ("kind", "fields"),
    [
        (FillBody, {"budget": True}),
        (FillBody, {"budget": "7"}),
        (FillBody, {"for_joint": "no"}),
        (CopyBody, {"name": "copy", "rows": 0}),
        (KeyBody, {"name": "ann", "rate": "5"}),
        (KeyBody, {"name": "ann", "expires": True}),
    ],
)
def test_numbers_and_truth_values_of_a_body_are_never_guessed(kind, fields):
    """{"budget": true} was one solve, and {"rows": "off"} a copy without rows."""
    with pytest.raises(ValidationError, match="valid"):
        kind.model_validate(fields)


@pytest.mark.parametrize("body", BAD.values(), ids=BAD)
def test_a_bad_body_is_a_problem_and_the_connection_goes_on(wire, body):
    for way in (request, chunked):
        status, headers, reported = wire.ask(way(body) if body else request(body))
        assert status == 422
        assert headers["content-type"] == "application/problem+json"
        problem = orjson.loads(reported)
        assert problem["status"] == 422
        assert problem["errors"][0]["loc"]
        assert wire.ask(request())[0] == 200


ESTIMATE = b', "on_thin": "estimate"}'
ALIKE = (
    {
        number.decode(): (NUMBERS[:-1] % number + ESTIMATE, status)
        for status, numbers in {
            200: [b"1e90", b"-1e99", b"1e-320", b"5e-324", b"-0", b"-0.0"],
            422: [b"1e160", b"-1e308", b"1.01e100"],  # a load that no part bears
        }.items()
        for number in numbers
    }
    | {
        "large together": (b'{"force": [1e100, 1e100, 1e100], "moment": [0, 0, 0]' + ESTIMATE, 200),
        "twice": (b'{"force": [1, 1, 1], ' + BODY[1:-1] + ESTIMATE, 422),
        "once": (BODY[:-1] + ESTIMATE, 200),
    }
)


@pytest.mark.parametrize(("body", "status"), ALIKE.values(), ids=ALIKE)
def test_both_ways_read_the_same_numbers(wire, body, status):
    result, _, straight = wire.ask(request(body))
    other, _, usual = wire.ask(request(body[:-1] + b', "detail": false}'))
    assert result == other == status
    assert same(straight) == same(usual)
    assert not re.search(rb"NaN|Infinity", straight)


def test_a_repeated_key_is_refused_with_its_place(wire):
    status, _, reply = wire.ask(request(ALIKE["twice"][0]))
    assert (status, orjson.loads(reply)["errors"][0]["loc"]) == (422, "force")


@pytest.mark.parametrize(
    ("path", "status"),
    [(PATH.replace("solved", "%73olved"), 200), (f"{PATH}?", 200), (f"{PATH}?a=b", 422)],
)
def test_an_encoded_name_and_a_query_string_are_read_the_usual_way(straight, wire, path, status):
    assert wire.ask(request(path=path))[0] == status
    assert straight() == 0


@pytest.mark.parametrize("way", [request, chunked])
def test_a_megabyte_of_blanks_is_too_large(wire, way):
    wire.socket.settimeout(600)
    status, headers, body = wire.ask(way(b" " * (1 << 20)))
    assert (status, orjson.loads(body)["status"]) == (413, 413)
    assert headers["content-type"] == "application/problem+json"


CALLS = {
    "a slash too many": (request(path=f"{PATH}/"), 404),
    "a component that is not there": (request(path=PATH.replace("solved", "nope")), 404),
    "a way out of the folder": (request(path=PATH.replace("solved", "..")), 404),
    "an encoded slash": (request(path=PATH.replace("solved", "a%2Fb")), 404),
    "an encoded zero": (request(path=PATH.replace("solved", "a%00b")), 404),
    "another alphabet": (request(path=PATH.replace("solved", "%C3%A4")), 404),
    "PUT": (request(verb="PUT"), 405),
    "GET": (request(b"", verb="GET"), 405),
    "OPTIONS": (request(b"", verb="OPTIONS"), 405),
}


@pytest.mark.parametrize(("call", "status"), CALLS.values(), ids=CALLS)
def test_a_call_that_there_is_not_is_a_problem(wire, call, status):
    for _ in range(2):
        result, headers, body = wire.ask(call)
        assert (result, orjson.loads(body)["status"]) == (status, status)
        assert headers["content-type"] == "application/problem+json"


def test_head_has_no_body(wire):
    wire.send(request(b"", verb="HEAD"))
    status, headers, _ = wire.reply(bodyless=True)
    assert (status, headers["content-type"]) == (405, "application/problem+json")
    assert wire.ask(request())[0] == 200


@pytest.mark.parametrize("path", ["/", "/v1/components", "/v1/jobs", "/docs"])
def test_head_is_answered_as_get_without_the_body(wire, path):
    """The page and each list refused it with 405; monitors and link checkers send it."""
    status, fields, body = wire.ask(request(b"", verb="GET", path=path))
    wire.send(request(b"", verb="HEAD", path=path))
    head_status, head_fields, _ = wire.reply(bodyless=True)
    assert (head_status, head_fields["content-length"]) == (status, str(len(body)))
    assert head_fields["content-type"] == fields["content-type"]
    assert wire.ask(request())[0] == 200


def test_head_of_the_events_ends_at_once_and_frees_its_listener(wire):
    for _ in range(300):  # more than there are places for listeners
        wire.send(request(b"", verb="HEAD", path="/v1/events"))
        status, fields, _ = wire.reply(bodyless=True)
        assert (status, fields["content-type"]) == (200, "text/event-stream; charset=utf-8")


@pytest.mark.parametrize(
    ("verb", "path", "allowed"),
    [
        ("PUT", "/v1/components", "GET, HEAD, POST"),
        ("PUT", "/", "GET, HEAD"),
        ("GET", PATH, "POST"),
        ("POST", "/v1/components/solved/notes", "PUT"),
        ("HEAD", PATH, "POST"),
    ],
)
def test_a_refused_method_is_answered_with_all_methods_of_the_path(wire, verb, path, allowed):
    wire.send(request(b"", verb=verb, path=path))
    status, fields, _ = wire.reply(bodyless=verb == "HEAD")
    assert (status, fields["allow"]) == (405, allowed)


def test_a_body_without_its_length_is_an_empty_one(wire):
    wire.send(f"POST {PATH} HTTP/1.1\r\nHost: x\r\n\r\n".encode())
    assert wire.reply()[0] == 422


@pytest.mark.parametrize(
    "length", ["-1", "1x", "99999999999999999999999", "3\r\nContent-Length: 4"]
)
def test_a_length_that_is_none_is_refused_and_the_connection_closed(wire, length):
    wire.send(request(length=length))
    assert wire.reply()[0] == 400
    assert wire.socket.recv(1) == b""


def test_two_ways_to_tell_a_length_are_refused(wire):
    assert wire.ask(request())[0] == 200
    wire.send(request(fields=["Transfer-Encoding: chunked"]))
    assert wire.reply()[0] == 400
    assert wire.socket.recv(1) == b""


UPGRADE = ["Connection: Upgrade", "Upgrade: h2c"]
SMUGGLED = b"GET /health/live HTTP/1.1\r\nHost: x\r\n\r\n"


def rest(wire):
    """Return what the server sends until it closes the connection."""
    try:
        while piece := wire.socket.recv(65536):
            wire.left += piece
    except ConnectionResetError:  # it was closed before it had read all
        pass
    return wire.left


@pytest.mark.parametrize("path", [PATH, f"{PATH}s", "/v1/components/solved/notes", "/nothing"])
@pytest.mark.parametrize("later", [True, False])
@pytest.mark.parametrize(
    "sized", [f"Content-Length: {len(SMUGGLED)}", "Transfer-Encoding: chunked"]
)
def test_a_body_behind_an_upgrade_header_is_not_answered_as_a_request(wire, path, later, sized):
    assert wire.ask(request())[0] == 200
    lines = [f"POST {path} HTTP/1.1", "Host: x", *UPGRADE, sized, "", ""]
    head = "\r\n".join(lines).encode()
    status, headers, body = wire.ask(head if later else head + SMUGGLED)
    assert (status, headers["connection"]) == (400, "close")
    assert "without the headers Connection" in orjson.loads(body)["detail"]
    if later:
        with contextlib.suppress(OSError):
            wire.send(SMUGGLED)
    assert rest(wire) == b""


@pytest.mark.parametrize("protocol", ["h2c", "websocket"])
def test_a_request_to_switch_protocols_is_answered_and_the_connection_closed(wire, protocol):
    head = f"GET /health/live HTTP/1.1\r\nHost: x\r\nConnection: Upgrade\r\nUpgrade: {protocol}"
    status, headers, body = wire.ask(f"{head}\r\n\r\n".encode() + SMUGGLED)
    assert (status, headers["connection"]) == (200, "close")
    assert orjson.loads(body) == {"status": "live"}
    assert rest(wire) == b""


def test_a_query_before_one_with_an_upgrade_header_is_answered_first(wire):
    wire.send(SMUGGLED + request(fields=UPGRADE) + SMUGGLED)
    assert [wire.reply()[0], wire.reply()[0]] == [200, 400]
    assert rest(wire) == b""


@pytest.fixture
def logged(monkeypatch):
    """Return the records of the server's log from now on."""
    monkeypatch.setattr(FastPathProtocol, "_logged_at", -math.inf)
    records, handler = [], logging.Handler()
    handler.emit = records.append
    loggers = [logging.getLogger(name) for name in ("uvicorn.error", "wrenchbook")]
    for logger in loggers:
        logger.addHandler(handler)
    yield records
    for logger in loggers:
        logger.removeHandler(handler)


@pytest.fixture
def connections(monkeypatch):
    """Return the server's sides of the connections that begin from now on."""
    created, begin = [], FastPathProtocol.connection_made
    monkeypatch.setattr(
        FastPathProtocol,
        "connection_made",
        lambda self, to: (created.append(self), begin(self, to)),
    )
    return created


GET = b"GET /docs HTTP/1.1\r\nHost: x\r\n\r\n"
CHUNKED = f"POST {PATH} HTTP/1.1\r\nHost: x\r\nTransfer-Encoding: chunked\r\n\r\n".encode()


@pytest.mark.parametrize("garbage", [b"\0", b"GET", b"GET / HTTP/9.9\r\n"])
def test_requests_before_garbage_are_answered_and_the_garbage_after_them(wire, logged, garbage):
    wire.send(GET * 3 + garbage + b"\r\n\r\n")
    replies = [wire.reply() for _ in range(4)]
    assert [status for status, _, _ in replies] == [200, 200, 200, 400]
    assert replies[-1][1]["content-type"] == "application/problem+json"
    assert replies[-1][1]["connection"] == "close"
    assert rest(wire) == b""
    assert [record.getMessage() for record in logged if record.levelno > logging.WARNING] == []


@pytest.mark.parametrize("before", [b"", GET * 2, request() + GET])
def test_a_request_whose_body_cannot_be_read_is_refused_in_its_place(wire, logged, before):
    wire.send(before + CHUNKED)
    wire.send(b"no length\r\n")
    statuses = [wire.reply()[0] for _ in range(before.count(b"Host: x") + 1)]
    assert statuses == [200] * (len(statuses) - 1) + [400]
    assert rest(wire) == b""
    assert [record.getMessage() for record in logged if record.levelno > logging.WARNING] == []


def test_a_caller_that_leaves_before_its_requests_are_answered_is_not_logged(
    port, logged, connections
):
    for _ in range(20):
        with closing(Wire(port)) as leaving:
            leaving.send(GET * 3)
            # Close with a reset, whatever the server sends.
            leaving.socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    until(
        lambda: (
            len(connections) == 20 and all(connection.parser is None for connection in connections)
        )
    )
    with closing(Wire(port)) as other:
        assert other.ask(request())[0] == 200
    until(lambda: not connections[0].tasks)
    assert [record.getMessage() for record in logged] == []


def test_a_flood_of_garbage_is_one_line_of_the_log(port, logged):
    for _ in range(30):
        with closing(Wire(port)) as wire:
            assert wire.ask(b"\0")[0] == 400
    (record,) = logged
    assert len(record.getMessage()) < 200


STOPS = {
    "the server stops": FastPathProtocol.shutdown,
    "the connection was idle": lambda it: it.loop.call_later(1e-3, it.timeout_keep_alive_handler),
}


@pytest.mark.parametrize("stop", STOPS.values(), ids=STOPS)
def test_a_request_that_arrives_while_the_loop_stalls_is_answered_before_the_connection_closes(
    port, monkeypatch, connections, stop
):
    monkeypatch.setattr(protocol, "LAST_S", 1e-3)
    stalled, sent = threading.Event(), threading.Event()

    def stall():
        stalled.set()
        assert sent.wait(600)

    def begin():  # the loop runs both timers before it reads
        connections[0].loop.call_later(1e-3, stall)
        stop(connections[0])

    with closing(Wire(port)) as wire:
        assert wire.ask(GET)[0] == 200
        connections[0].loop.call_soon_threadsafe(begin)
        assert stalled.wait(600)
        wire.send(request())
        sent.set()
        assert wire.reply()[0] == 200


def test_a_connection_of_queries_of_the_fast_path_alone_is_not_closed_as_unused(
    straight, port, connections
):
    with closing(Wire(port)) as wire:
        assert wire.ask(request())[0] == 200
        assert straight() == 1
        (connection,) = connections
        assert connection._late(connection.loop.time() + 2 * protocol.HEAD_S) == ""


def test_two_signals_before_the_start_stop_a_server():
    server = Server(server_config(None))
    for _ in range(2):
        server.handle_exit(signal.SIGTERM, None)
    assert server.should_exit


def test_an_uncovered_query_costs_its_key_one_request(tmp_path, monkeypatch):
    counted = []
    wait = Permission.wait

    def count(self):
        if self.key is not None and self.key.name == "loop":
            counted.append(self)
        return wait(self)

    monkeypatch.setattr(Permission, "wait", count)
    owner, loop = (Keyring(tmp_path).add(name, "write") for name in ("owner", "loop"))
    wrenches = full_wrenches(40)
    with served(tmp_path, key=owner) as client:
        add_table(client, "solved", as_rows(wrenches, moved(wrenches)))
        with closing(Wire(client._port)) as wire:
            strict = {"tolerance": {"translation": 1e-30, "rotation": 1e-30}}
            covered = orjson.dumps({**PLAIN, **strict, "on_thin": "estimate"})
            uncovered = covered.replace(b"estimate", b"reject  ")
            uncovered = uncovered.replace(b'reject  "', b'reject"  ')
            bodies = [uncovered, covered, uncovered, covered, b"{", b"{"]
            key = [f"Authorization: Bearer {loop}"]
            result = [wire.ask(request(body, fields=key))[0] for body in bodies]
    assert result == [409, 200, 409, 200, 422, 422]
    assert len(counted) == len(bodies)


def test_beyond_the_range_the_usual_way_refuses_to_queue(straight, wire):
    far = (10 * FULL).tolist()
    status, _, body = wire.ask(request(orjson.dumps({"force": far[:3], "moment": far[3:]})))
    assert status == 409  # a table-only component queues nothing
    assert "finite-element" in orjson.loads(body)["title"]
    assert straight() == 0
