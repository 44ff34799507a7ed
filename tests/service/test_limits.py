"""What one caller may take of the server: sizes, numbers, waits and open connections."""

import asyncio
import contextlib
import errno
import os
import socket
import zipfile

import numpy as np
import orjson
import pytest
from fastapi import FastAPI
from starlette.responses import Response
from starlette.testclient import TestClient

from tests.service.live import add_table, as_rows, clean_wrenches, full_wrenches, moved, served
from wrenchbook.service.client import ProblemError as Refused
from wrenchbook.service.http import batch, protocol
from wrenchbook.service.http import body as bodies
from wrenchbook.service.http.app import create_app
from wrenchbook.service.http.batch import batch_parts
from wrenchbook.service.http.problems import HttpProblemError
from wrenchbook.service.jobs import waiting as polls
from wrenchbook.service.jobs.attempt import zipped
from wrenchbook.service.jobs.waiting import Polls, TooManyPollsError
from wrenchbook.service.workspace import Settings

RIG = "/v1/components/rig"


@pytest.fixture(scope="module")
def asked(tmp_path_factory):
    """A server in this process with a table-only component, without solvers."""
    app = create_app(Settings(tmp_path_factory.mktemp("limits"), solvers=0))
    with TestClient(app) as client:
        body = {"name": "rig", "title": "rig", "range": {"force": [9] * 3, "moment": [9] * 3}}
        assert client.post("/v1/components", json=body).status_code == 201
        yield client


@pytest.fixture(scope="module")
def live(tmp_path_factory):
    """A server on a socket, that loses patience soon."""
    patch = pytest.MonkeyPatch()
    with patch.context() as patched:
        for name, seconds in {"POLL_S": 0.05, "HEAD_S": 0.4, "BODY_S": 0.4, "SLOWEST": 1e9}.items():
            patched.setattr(protocol, name, seconds)
        with served(tmp_path_factory.mktemp("live")) as client:
            wrenches = np.concatenate([clean_wrenches(), full_wrenches(30)])
            add_table(client, "rig", as_rows(wrenches, moved(wrenches)))
            yield client


def opened(client):
    return socket.create_connection((client._host, client._port), timeout=600)


@pytest.mark.parametrize(
    "body",
    [
        b"[" * 60_000,
        b'{"wrenches":' + b"[" * 900 + b"]" * 900 + b"}",
        orjson.dumps({"wrenches": ["x"] * 200_000}),
        orjson.dumps({"wrenches": [[None] * 6] * 30_000}),
        orjson.dumps({f"k{n}": 1 for n in range(5000)}),
        b'{"wrenches":[' + b"{}," * 2000 + b"{}]}",
    ],
)
def test_a_body_full_of_mistakes_has_at_most_a_thousand_listed(asked, body):
    reply = asked.post(f"{RIG}/displacements", content=body)
    assert reply.status_code == 422
    assert 1 <= len(reply.json()["errors"]) <= 1000
    assert len(reply.content) < 1 << 20


def test_a_body_is_counted_as_its_pieces_come():
    async def receive():
        return {"type": "http.request", "body": bytes(10), "more_body": True}

    async def run():
        receives = bodies.counted(receive, 25)
        for _ in range(2):
            await receives()
        with pytest.raises(HttpProblemError) as caught:
            await receives()
        assert caught.value.status_code == 413

    asyncio.run(run())


def test_a_json_batch_has_as_many_wrenches_as_a_binary_one(monkeypatch):
    monkeypatch.setattr("wrenchbook.service.http.batch.MAX_BATCH", 10)
    assert len(batch_parts(orjson.dumps({"wrenches": [[0.0] * 6] * 10}))[1]) == 10
    with pytest.raises(HttpProblemError, match="at most 10"):
        batch_parts(orjson.dumps({"wrenches": [[0.0] * 6] * 11}))
    with pytest.raises(HttpProblemError, match="at most 10"):
        batch_parts(b'{"wrenches":[' + b"[]," * 1000 + b"[]]}")


def test_a_large_batch_is_read_in_a_file_and_answered_as_a_small_one_is(live, monkeypatch):
    wrenches = full_wrenches(7)
    small = live.displacements("rig", wrenches, on_thin="estimate")
    monkeypatch.setattr(bodies, "PIECE", 64)
    monkeypatch.setattr("wrenchbook.service.http.batch.WRITTEN", 3)
    asked = {"wrenches": wrenches.tolist(), "on_thin": "estimate", "derivatives": True}
    reply = live.call_json("POST", f"{RIG}/displacements", asked)
    np.testing.assert_array_equal(np.array(reply["displacements"]), small.displacements)
    assert len(reply["errors"]) == len(reply["coverage"]) == len(reply["derivatives"]) == 7
    assert bodies.Spooled.stored == 0


def test_a_mistake_in_a_large_batch_is_told_as_in_a_small_one(tmp_path):
    body = bodies.Spooled()
    body.path = tmp_path / "body"
    body.path.write_bytes(b'{"wrenches":[[0,0,0,0,0,"x"]]}')
    with pytest.raises(HttpProblemError) as caught:
        batch.read_batch_body(body)
    assert caught.value.status == 422
    assert caught.value.body["errors"][0]["loc"] == "wrenches.0.5"


@pytest.mark.parametrize("piece", [1, 20, 200])
def test_a_batch_read_in_pieces_is_the_batch_read_whole_or_left_to_that(monkeypatch, piece):
    monkeypatch.setattr(batch, "PIECE", 1000)
    wrenches = full_wrenches(9)
    body = orjson.dumps({"on_thin": "reject", "wrenches": wrenches.tolist(), "wait_s": 3})
    whole = batch_parts(body)
    monkeypatch.setattr(batch, "PIECE", max(piece, 60))
    fields, result = batch.in_pieces(body)
    assert fields == whole[0]
    np.testing.assert_array_equal(result, whole[1])
    rows = b"[1,2,3,4,5,6]"
    for text in (
        b'{"wrenches":[%b%b]}' % (rows, rows),
        b'{"wrenches":[%b,,%b]}' % (rows, rows),
        b'{"wrenches":[[1,2],%b]}' % rows,
        b'{"wrenches":[%b],"x":[[]]}' % rows,
        b'{"wrenches":"[[1]]"}',
        b"[]]",
    ):
        with pytest.raises(HttpProblemError):
            _ = batch.in_pieces(text) or batch_parts(text)


def test_files_of_bodies_are_gone_once_they_are_read_or_refused(live, monkeypatch, tmp_path):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.setattr(bodies, "PIECE", 1000)
    live.import_table("rig", "fz [N],uz [m]\n" + "1,1e-6\n" * 2000, dry_run=True)
    with pytest.raises(Refused):
        live.import_table("rig", "nonsense\n" * 2000)
    assert bodies.Spooled.stored == 0
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("number", "remedy"),
    [
        (errno.ENOSPC, "make room on its disk"),
        (errno.EDQUOT, "raise the disk quota"),
        (errno.EFBIG, "raise the limit of file sizes"),
    ],
)
def test_a_body_that_the_disk_has_no_room_for_is_507_with_the_remedy_of_its_cause(
    asked, monkeypatch, number, remedy
):
    """It was 500 with a traceback in the log, where the ledger's full disk is 507."""

    def full(*_):
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(bodies.Spooled, "append", full)
    reply = asked.post(f"{RIG}/table", content=b"fz [N],uz [m]\n1,1e-6\n")
    assert (reply.status_code, reply.json()["type"]) == (507, "urn:wrenchbook:problem:disk")
    assert os.strerror(number) in reply.json()["detail"]
    assert remedy in reply.json()["detail"]


def test_an_error_of_the_disk_that_is_not_full_stays_a_crash(asked, monkeypatch):
    def broken(*_):
        raise OSError(errno.EBADF, os.strerror(errno.EBADF))

    monkeypatch.setattr(bodies.Spooled, "append", broken)
    with pytest.raises(OSError, match="Bad file descriptor"):
        asked.post(f"{RIG}/table", content=b"fz [N],uz [m]\n1,1e-6\n")


@pytest.mark.parametrize(
    "sent",
    [
        b"",
        b"GET /health/li",
        b"GET /health/live HTTP/1.1\r\nHost: x\r\nX-Slow: ",
        b"POST /v1/components/rig/displacement HTTP/1.1\r\nHost: x\r\nContent-Length: 9\r\n\r\n{",
        b"POST /v1/components/rig/table HTTP/1.1\r\nHost: x\r\nContent-Type: text/csv\r\n"
        b"Content-Length: 900000\r\n\r\nfx",
    ],
)
def test_a_connection_that_keeps_the_server_waiting_is_closed(live, sent):
    with opened(live) as connection:
        connection.sendall(sent)
        with contextlib.suppress(ConnectionResetError):
            assert connection.recv(1000) == b""
    assert live.is_ready()


def test_a_connection_whose_body_is_refused_is_closed_however_fast_it_sends(live, monkeypatch):
    monkeypatch.setattr(protocol, "SLOWEST", 1e-9)
    head = b"POST /v1/components/rig/displacement HTTP/1.1\r\nHost: x\r\n"
    with opened(live) as connection:
        connection.sendall(head + b"Content-Length: 900000\r\n\r\n" + bytes(100_000))
        connection.settimeout(60)
        assert connection.recv(1000).startswith(b"HTTP/1.1 413")
        with contextlib.suppress(ConnectionResetError):
            while connection.recv(1000):
                pass


def test_a_connection_that_asks_within_the_time_is_answered(live):
    with opened(live) as connection:
        for piece in (b"GET /health/live HTTP/1.1\r\n", b"Host: x\r\n", b"\r\n"):
            connection.sendall(piece)
        assert connection.recv(1000).startswith(b"HTTP/1.1 200")


@pytest.mark.parametrize(
    "head", [b"GET /" + b"a" * 200_000, b"GET / HTTP/1.1\r\n" + b"A: b\r\n" * 40_000]
)
def test_a_head_that_is_longer_than_any_is_refused(live, head):
    with opened(live) as connection:
        reported = b""
        with contextlib.suppress(ConnectionResetError, BrokenPipeError):
            connection.sendall(head)
            while piece := connection.recv(1000):
                reported += piece
        assert reported.startswith(b"HTTP/1.1 431") or b"HTTP/1.1 431".startswith(reported)
    assert live.is_ready()


@pytest.mark.parametrize("call", ["table", "displacements"])
def test_who_leaves_before_the_request_is_whole_is_no_mistake_of_ours(asked, call):
    sent = []
    scope = {
        "type": "http",
        "method": "POST",
        "path": f"/v1/components/plate_thin/{call}",
        "query_string": b"",
        "headers": [(b"host", b"testserver"), (b"content-type", b"application/json")],
    }

    async def leave():
        async def receive():
            return {"type": "http.disconnect"}

        async def send(message):
            sent.append(message)

        await asked.app(scope, receive, send)

    asked.portal.call(leave)
    assert [item["status"] for item in sent if "status" in item] in ([], [499])


def test_no_more_connections_are_held_than_there_may_be(live, monkeypatch):
    monkeypatch.setattr(protocol, "MAX_CONNECTIONS", 3)
    held = [opened(live) for _ in range(8)]
    closed = sum(connection.recv(1) == b"" for connection in held)  # all, in the end
    assert closed == 8
    for connection in held:
        connection.close()


class Jobs:
    """A ledger of jobs that never end until told; it counts who asks."""

    def __init__(self):
        self.over = set()
        self.looks = 0

    def job(self, job_id):
        return type("J", (), {"id": job_id, "is_final": job_id in self.over})()

    def ended(self, job_ids):
        self.looks += 1
        return {job_identifier for job_identifier in job_ids if job_identifier in self.over}


async def entered(waiting, count):
    """Let the loop go on until so many have come and one of them waits."""
    while len(waiting._waiters) < count or waiting._polling is None:  # noqa: ASYNC110 (there is nothing that tells)
        await asyncio.sleep(0)


def test_two_thousand_polls_take_one_look_and_no_thread_each():
    async def run():
        ledger = Jobs()
        waiting = Polls(ledger)
        tasks = [asyncio.create_task(waiting.wait_all([n], 600)) for n in range(2000)]
        await entered(waiting, 2000)
        ledger.looks = 0
        ledger.over = set(range(2000))
        waiting.notify()
        results = await asyncio.gather(*tasks)
        assert all(jobs[0].is_final for jobs in results)
        assert ledger.looks <= 2
        assert not waiting._waiters

    asyncio.run(run())


def test_who_waits_is_answered_when_the_time_is_up_or_the_server_stops():
    async def run():
        waiting = Polls(Jobs())
        (job,) = await waiting.wait_all([1], 0.05)
        assert not job.is_final
        task = asyncio.create_task(waiting.wait_all([1, 2], 60))
        await entered(waiting, 1)
        waiting.stop()
        assert len(await task) == 2

    asyncio.run(run())


def test_no_more_wait_than_may(monkeypatch):
    monkeypatch.setattr(polls, "MAX_WAITERS", 1)

    async def run():
        waiting = Polls(Jobs())
        task = asyncio.create_task(waiting.wait_all([1], 60))
        await entered(waiting, 1)
        with pytest.raises(TooManyPollsError):
            await waiting.wait_all([2], 60)
        waiting.stop()
        await task

    asyncio.run(run())


def test_an_attempts_zip_holds_what_lies_in_its_folder_and_nothing_it_points_to(tmp_path):
    secret, folder = tmp_path / "secret.txt", tmp_path / "attempt"
    secret.write_text("the machine's")
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "other.txt").write_text("the machine's")
    folder.mkdir()
    (folder / "log.txt").write_text(f"read {tmp_path}/mesh.msh\nTraceback")
    (folder / "result.bin").write_bytes(bytes(3))
    (folder / "link.txt").symlink_to(secret)
    (folder / "links").symlink_to(tmp_path / "elsewhere")
    (folder / "sub").mkdir()
    (folder / "sub" / "loop").symlink_to(folder)
    os.mkfifo(folder / "pipe")
    with zipped(folder) as file, zipfile.ZipFile(file) as archive:
        assert set(archive.namelist()) == {"log.txt", "result.bin", "LEFT_OUT.txt"}
        texts = [archive.read(name) for name in archive.namelist()]
    assert not any(b"the machine's" in text for text in texts)
    assert not any(str(tmp_path).encode() in text for text in texts)
    assert b"link.txt" in b"".join(texts)


def test_a_reply_that_holds_something_passes_a_route_of_fastapi():
    """Such a route reads `background`, which the reply lacked."""
    app = FastAPI()

    @app.get("/")
    async def reply():
        return batch.HoldingReply(Response("sent"), contextlib.AsyncExitStack())

    assert TestClient(app).get("/").text == "sent"


def test_the_zip_of_an_attempt_has_the_traceback_of_its_log(tmp_path):
    """The cause of a failure was cut out of the log as that of a reply is."""
    (tmp_path / "log.txt").write_text(
        'Traceback (most recent call last):\n  File "/tmp/lab/solve.py", line 3\nValueError: no'
    )
    with zipped(tmp_path) as file, zipfile.ZipFile(file) as archive:
        text = archive.read("log.txt").decode()
    assert text == (
        'Traceback (most recent call last):\n  File ".../solve.py", line 3\nValueError: no'
    )
