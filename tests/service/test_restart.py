"""A server under load that is restarted (SIGHUP) or ended (SIGTERM): no request is lost."""

import http.client
import json
import logging
import multiprocessing
import os
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import contextmanager, suppress
from pathlib import Path
from types import SimpleNamespace
from typing import ClassVar

import psutil
import pytest

from tests.until import until
from wrenchbook.service.files import scratch
from wrenchbook.service.files.program import child_command
from wrenchbook.service.http import server as servers
from wrenchbook.service.http.app import create_app
from wrenchbook.service.workers import supervisor as supervisors
from wrenchbook.service.workers.supervisor import RETIRE, Child, Supervisor
from wrenchbook.service.workspace import Settings

LIMIT_S = 60.0
BODY = json.dumps({"force": [0, 0, -10], "moment": [0, 0, 0], "on_thin": "estimate"})
CONNECTIONS = 4
QUERY, USUAL = "/v1/components/spring/displacement", "/v1/components/spring"


@pytest.fixture
def temporary():
    """The folder of a server's temporary files, short: its sockets' paths may have 107 bytes."""
    with tempfile.TemporaryDirectory(prefix="wb-") as folder:
        yield Path(folder)


@contextmanager
def serving(folder, processes, temporary):
    command = child_command(
        "wrenchbook.service.cli.main", "serve", "--data", str(folder), "--port", "0"
    )
    words = ["--processes", str(processes), "--solvers", "0", "--log-level", "error"]
    server = subprocess.Popen(
        [*command, *words],
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "TMPDIR": str(temporary)},
    )
    try:
        yield server, int(server.stdout.readline().rsplit(":", 1)[1])
    finally:
        server.terminate()
        server.wait(LIMIT_S)
        server.stdout.close()


def web_workers(server):
    found = set()
    for one in psutil.Process(server.pid).children(recursive=True):
        with suppress(psutil.NoSuchProcess):  # it ended meanwhile
            found |= {one.pid} if one.name() == "wb-webworker" else set()
    return found


class Load:
    """Threads that each send requests on one connection, and connect anew after the last reply."""

    def __init__(self, port, *, until_closed=False):
        self.port, self.until_closed = port, until_closed
        self.faults, self.stop = [], threading.Event()
        self.replies = [0] * CONNECTIONS
        self.threads = [threading.Thread(target=self.send, args=(n,)) for n in range(CONNECTIONS)]
        for thread in self.threads:
            thread.start()
        until(lambda: min(self.replies) > 10 or self.faults)

    def send(self, number):
        try:
            connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=LIMIT_S)
            while not self.stop.is_set():
                if number % 2:
                    connection.request("POST", QUERY, BODY, {"Content-Type": "application/json"})
                else:
                    connection.request("GET", USUAL)
                reply = connection.getresponse()
                reply.read()
                assert reply.status in (200, 202), reply.status
                self.replies[number] += 1
                if reply.getheader("connection") == "close":
                    if self.until_closed:
                        return
                    connection.close()
            connection.close()
        except Exception as fault:
            self.faults.append(repr(fault))

    def end(self):
        self.stop.set()
        for thread in self.threads:
            thread.join(LIMIT_S)
        return self.faults


@pytest.mark.parametrize("processes", [1, 2])
def test_a_restart_of_the_web_workers_loses_no_request(tmp_path, processes, temporary):
    with serving(tmp_path, processes, temporary) as (server, port):
        before, load = web_workers(server), Load(port)
        os.kill(server.pid, signal.SIGHUP)
        until(lambda: len(new := web_workers(server)) == processes and not new & before)
        seen = min(load.replies)
        until(lambda: load.faults or min(load.replies) > seen)
        assert load.end() == []


def test_the_last_reply_of_each_connection_says_that_it_closes_when_the_server_ends(
    tmp_path, temporary
):
    with serving(tmp_path, 2, temporary) as (server, port):
        load = Load(port, until_closed=True)
        os.kill(server.pid, signal.SIGTERM)
        for thread in load.threads:
            thread.join(LIMIT_S)
        assert server.wait(LIMIT_S) == 0
        assert load.end() == []


COUNT = 40_000  # rows: more than a body in memory may have
TABLE = "fz [N],uz [m]\n" + "".join(f"{n},{n:030.3f}e-9\n" for n in range(COUNT))
RIG = {"name": "rig", "title": "rig", "range": {"force": [1e5] * 3, "moment": [1e5] * 3}}


class HalfImport:
    """An import of which the server has all but the last byte."""

    def __init__(self, port):
        self.connection = http.client.HTTPConnection("127.0.0.1", port, timeout=LIMIT_S)
        self.connection.request(
            "POST", "/v1/components", json.dumps(RIG), {"Content-Type": "application/json"}
        )
        assert self.connection.getresponse().read()
        self.connection.putrequest("POST", "/v1/components/rig/table?wait_s=0&missing_loads=zero")
        self.connection.putheader("Content-Type", "text/csv")
        self.connection.putheader("Content-Length", str(len(TABLE)))
        self.connection.endheaders(TABLE[:-1].encode())

    def finish(self):
        self.connection.send(TABLE[-1:].encode())
        return self.reply()

    def reply(self):
        reply = self.connection.getresponse()
        body = json.loads(reply.read())
        self.connection.close()
        return reply, body


def test_an_import_that_has_begun_is_finished_while_the_web_worker_is_replaced_twice(
    tmp_path, temporary
):
    with serving(tmp_path, 1, temporary) as (server, port):
        begun, seen = HalfImport(port), web_workers(server)
        until(lambda: list(temporary.glob("*/*/body")))
        for count in (2, 3):
            os.kill(server.pid, signal.SIGHUP)
            until(lambda: len(seen.update(web_workers(server)) or seen) == count)  # noqa: B023
        reply, body = begun.finish()
        assert (reply.status, body.get("inserted")) == (200, COUNT)
    assert list(temporary.glob("wrenchbook-*")) == []


def test_the_body_of_an_import_is_removed_once_a_killed_web_worker_is_started_again(
    tmp_path, temporary
):
    with serving(tmp_path, 1, temporary) as (server, port):
        begun = HalfImport(port)
        until(lambda: list(temporary.glob("*/*/body")))
        (killed,) = web_workers(server)
        os.kill(killed, signal.SIGKILL)
        until(lambda: not list(temporary.glob("*/*/body")))
        begun.connection.close()


@pytest.mark.parametrize("retired", [False, True])
def test_a_request_that_a_stopping_server_cannot_finish_is_503_with_retry_after(
    tmp_path, monkeypatch, caplog, retired
):
    monkeypatch.setattr(servers, "FINISH_S", 0.01)
    bound = socket.create_server(("127.0.0.1", 0))
    config = servers.server_config(create_app(Settings(tmp_path, solvers=0)), log_config=None)
    server = servers.Server(config)
    thread = threading.Thread(target=server.run, kwargs={"sockets": [bound]}, daemon=True)
    thread.start()
    begun = HalfImport(bound.getsockname()[1])
    until(lambda: server.server_state.tasks)
    if retired:
        server.retire()
    server.handle_exit(signal.SIGTERM, None)
    reply, body = begun.reply()
    assert (reply.status, body["type"]) == (503, "urn:wrenchbook:problem:stopping")
    assert reply.getheader("content-type") == "application/problem+json"
    assert int(reply.getheader("retry-after")) > 0
    thread.join(LIMIT_S)
    assert not any(record.exc_info for record in caplog.records if record.levelno > logging.INFO)


class StandIn:
    """A child process that lives, dies and starts as a test says; `all` has them in order."""

    all: ClassVar[list] = []
    sentinel: ClassVar = None

    def __init__(self, kind, options, *sockets):
        about = {"is_alive": lambda: True, "exitcode": None, "pid": 0, "sentinel": self.sentinel}
        self.name, self.process = kind[0], SimpleNamespace(**about)
        self.healthy, self.started, self.got = True, len(self.all) < 3, []
        self.begun = time.monotonic()
        self.all.append(self)

    def is_healthy(self):
        return self.healthy

    def send(self, number):
        self.got.append(number)

    def kill(self):
        self.got.append("killed")

    def join(self):
        self.got.append("joined")


@pytest.fixture
def supervisor(monkeypatch):
    """A supervisor of stand-ins, which looks once a call: a builder and two web workers."""
    monkeypatch.setattr(StandIn, "all", [])
    monkeypatch.setattr(supervisors, "Child", StandIn)
    monkeypatch.setattr(supervisors, "REFUSE_AFTER_S", 0.0)
    monkeypatch.setattr(signal, "signal", lambda *_: None)
    with socket.socket() as bound, socket.socket() as StandIn.sentinel:
        yield from _looking(Supervisor(Settings(processes=2), bound, "ready"))


def _looking(made):
    made.look()

    def look(*signals):
        made._signals.extend(signals)
        made.look()
        return made

    yield look


def test_twenty_restarts_that_wait_are_one(supervisor):
    supervisor(*[signal.SIGHUP] * 20)
    for number in (3, 4):
        assert len(StandIn.all) == number + 1
        StandIn.all[number].started = True
        supervisor()
        supervisor()
    assert [child.got for child in StandIn.all] == [[], [RETIRE], [RETIRE], [], []]


def test_an_end_waits_neither_for_restarts_nor_for_a_web_worker_that_starts(supervisor):
    made = supervisor(signal.SIGHUP)
    made._signals += [signal.SIGHUP, signal.SIGTERM, signal.SIGHUP]
    made.run()
    assert [child.got for child in StandIn.all] == [[signal.SIGTERM, "joined"]] * 4


def test_a_web_worker_that_does_not_start_leaves_the_others(supervisor, monkeypatch):
    supervisor(signal.SIGHUP)
    supervisor()
    assert StandIn.all[3].got == []
    StandIn.all[3].healthy = False
    supervisor()
    supervisor()
    assert [child.got for child in StandIn.all] == [[], [], [], ["killed"]]


@pytest.mark.parametrize("place", [0, 1])
def test_a_process_without_heartbeat_is_killed_and_started_again(supervisor, place):
    StandIn.all[place].healthy = False
    made = supervisor()
    assert StandIn.all[place].got == ["killed"]
    assert StandIn.all[3].name == StandIn.all[place].name
    assert not made.failed


def test_heartbeats_are_read_without_waiting_for_one(monkeypatch):
    """It waited up to 30 s for each answer to a ping; signals and other processes had to wait."""
    child, now = Child.__new__(Child), [0.0]
    child._heartbeats, end = multiprocessing.Pipe(duplex=False)
    child.process, child.started = SimpleNamespace(is_alive=lambda: True), False
    child._heard = 0.0
    monkeypatch.setattr(supervisors, "time", SimpleNamespace(monotonic=lambda: now[0]))
    now[0] = 29.0
    assert child.is_healthy()
    end.send(True)
    assert child.is_healthy()
    assert child.started
    now[0] = 58.0
    assert child.is_healthy()
    now[0] = 60.0
    assert not child.is_healthy()
    end.close()  # as a killed process does
    assert not child.is_healthy()


TAKES = """
import sys, tempfile
from wrenchbook.service.files.scratch import take_scratch
take_scratch()
tempfile.mkstemp()
print("ready", flush=True)
sys.stdin.read()
"""


def test_temporary_files_of_a_killed_process_are_removed_by_the_next_and_those_of_others_stay(
    tmp_path, monkeypatch
):
    def started():
        environment = {**os.environ, "TMPDIR": str(tmp_path)}
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "env": environment}
        process = subprocess.Popen([sys.executable, "-c", TAKES], **pipes)
        assert process.stdout.readline() == b"ready\n"
        return process

    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with started() as killed:
        (left,) = tmp_path.iterdir()
        killed.kill()
    with started() as living:
        assert not left.exists()
        (held,) = tmp_path.iterdir()
        new = scratch.take_scratch()
        assert {*tmp_path.iterdir()} == {held, new}
        assert list(held.iterdir())
        living.stdin.close()
