"""A real server of several processes: the same answers from all, and what a kill of each does."""

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

import orjson
import psutil
import pytest

from tests.service.live import add_table, as_rows, clean_wrenches, moved
from tests.until import until
from wrenchbook.service.client import Client, ProblemError
from wrenchbook.service.files import scratch
from wrenchbook.service.files.program import child_command
from wrenchbook.service.http import server as servers
from wrenchbook.service.http.app import create_app
from wrenchbook.service.keys import Keyring
from wrenchbook.service.ledger import Ledger
from wrenchbook.service.workers import supervisor as supervisors
from wrenchbook.service.workers.private import ServerDidNotStartError, private_server
from wrenchbook.service.workers.supervisor import RETIRE, Child, Supervisor
from wrenchbook.service.workspace import Settings

HERE = Path(__file__).parent
LIMIT_S = 60.0
ASKED = [12.0, 0.0, 0.0, 0.0, 1.5, 2.5]


class SeveralProcesses:
    """A server of several processes, as who looks at it from outside knows it."""

    def __init__(self, folder, solvers=1):
        self.folder = folder
        command = child_command(
            "wrenchbook.service.cli.main", "serve", "--data", str(folder), "--port", "0"
        )
        paths = f"{HERE}:{HERE.parents[1]}:{HERE.parents[1] / 'src'}"
        self.supervisor = subprocess.Popen(
            [*command, "--processes", "2", "--solvers", str(solvers), "--log-level", "error"],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env={**os.environ, "WRENCHBOOK_SOLVE": "stand_in:quick", "PYTHONPATH": paths},
        )
        assert self.supervisor.stdout is not None
        self.address = self.supervisor.stdout.readline().rsplit(maxsplit=1)[-1:]
        self.seen = psutil.Process(self.supervisor.pid)

    def workers(self, word):
        result = []
        for child in self.seen.children(recursive=True):
            with suppress(psutil.Error):  # it has ended just now
                result += [child] if child.name() == f"wb-{word}" else []
        return result

    def client(self):
        return Client(self.address[0], timeout=LIMIT_S)

    def end(self):
        self.supervisor.terminate()
        assert self.supervisor.wait(LIMIT_S) == 0
        self.close()

    def close(self):
        for pipe in (self.supervisor.stdout, self.supervisor.stderr):
            if pipe is not None:
                pipe.close()


@pytest.fixture(scope="module")
def several(tmp_path_factory):
    folder = tmp_path_factory.mktemp("workers")
    one = SeveralProcesses(folder)
    with one.client() as client:
        add_table(client, "clean", as_rows(clean_wrenches(), moved(clean_wrenches())))
    yield one
    one.end()


@pytest.fixture
def keyed(tmp_path):
    """Servers that are given keys: without the last one they would refuse the other tests."""
    one = SeveralProcesses(tmp_path)
    yield one
    one.end()


@contextmanager
def clients_of_each(several):
    """Give a client of each process that answers, told by the port its connection has."""
    answering = several.workers("webworker")
    results, rest = {}, []
    try:
        while len(results) < len(answering):
            client = several.client()
            rest.append(client)
            client.health()
            assert len(rest) < 200, "one process takes no connections"
            holders = {item.pid: len(item.net_connections()) for item in answering}
            for pid, number in holders.items():
                if number > 1 + sum(1 for held in results.values() if held[0] == pid):
                    results.setdefault(pid, (pid, client))
        yield [client for _, client in results.values()]
    finally:
        for client in rest:
            client.close()


def answers(client, wrenches):
    result = client.displacements("clean", wrenches, on_thin="estimate")
    return result.displacements.tobytes() + result.errors.tobytes()


def statuses(several, headers):
    """What connections of their own are answered, which several processes take."""
    result = set()
    for _ in range(12):
        one = http.client.HTTPConnection(
            several.address[0].removeprefix("http://"), timeout=LIMIT_S
        )
        one.request("GET", "/v1/jobs", headers=headers)
        result.add(one.getresponse().status)
        one.close()
    return result


def statuses_of_each(clients, method="GET", key=None):
    """What each process answers on the connection that is its own, kept open."""
    result = set()
    for client in clients:
        headers = {"Authorization": f"Bearer {key}"} if key else {}
        try:
            client.call(method, "/v1/jobs", headers=headers)
            result.add(200)
        except ProblemError as problem:
            result.add(problem.status)
    return result


def test_every_process_has_the_same_access_control(keyed):
    for headers in ({"Host": "evil.example"}, {"Origin": "http://evil.example"}):
        assert statuses(keyed, headers) == {403}
    with clients_of_each(keyed) as clients:
        key = Keyring(keyed.folder).add("ann", "read")
        # New connections go to one process for a while: only those held tell of each.
        until(lambda: statuses_of_each(clients) == {401})
        assert statuses_of_each(clients, key=key) == {200}
        assert statuses_of_each(clients, "DELETE", key) == {403}
        assert statuses_of_each(clients, key="wrong") == {401}


def test_a_key_has_one_rate_for_all_processes(keyed):
    """Each web worker counted for itself: 109 requests for 40."""
    with clients_of_each(keyed) as clients:
        # One request now, and the next in hours.
        key = Keyring(keyed.folder).add("slow", "read", rate=1e-4)
        until(lambda: statuses_of_each(clients) == {401})
        result = [statuses_of_each([client], key=key) for client in [*clients, *clients]]
        assert sorted(map(min, result)) == [200, 429, 429, 429]


def test_a_row_taken_by_one_process_is_answered_by_all(several):
    body = orjson.dumps({"rows": [{"wrench": [50.0, 0, 0, 0, 1, 2], "displacement": [1e-5] * 6}]})
    with clients_of_each(several) as clients:
        version = clients[0].import_table("clean", body, format="json")["table_version"]
        for client in clients:
            until(lambda one=client: one.component("clean")["table_version"] >= version)
            reported = client.displacement("clean", [50.0, 0, 0], [0, 1, 2], on_thin="estimate")
            assert reported.table_version == version


def test_metrics_are_of_all_processes_whichever_is_asked(several):
    with clients_of_each(several) as clients:
        for client in clients:
            for _ in range(10):
                client.displacement(
                    "clean", ASKED[:3], ASKED[3:], on_thin="estimate", method="linear"
                )
        until(lambda: {counted(client, "linear") for client in clients} == {10 * len(clients)})


def test_the_processes_of_all_workers_and_of_the_builder_are_in_the_metrics(several):
    pids = [worker.pid for worker in several.workers("webworker")]
    with several.client() as client:
        text = client.call("GET", "/metrics").content.decode()
    for what in ("cpu_seconds_total", "resident_memory_bytes", "open_fds", "start_time_seconds"):
        lines = [line for line in text.splitlines() if line.startswith(f"process_{what}")]
        names = {line.partition('"')[2].partition('"')[0] for line in lines}
        assert names == {str(number + 1) for number in range(len(pids))} | {"builder"}


def counted(client, method):
    text = client.call("GET", "/metrics").content.decode()
    lines = [line for line in text.splitlines() if line.startswith("wrenchbook_queries_total")]
    return sum(float(line.split()[1]) for line in lines if f'method="{method}"' in line)


def test_a_job_that_one_process_has_taken_is_told_to_listeners_of_all(several):
    with clients_of_each(several) as clients:
        feeds = [client.events("bar") for client in clients]
        for feed in feeds:
            assert next(feed).kind == "hello"
        job = clients[0].solve("bar", [0.0, 0.0, -11.0], [0.0, 0.0, 0.0]).job
        for feed in feeds:
            reported = next(
                item
                for item in feed
                if (item.body.get("id"), item.body.get("status")) == (job.id, "done")
            )
            assert reported.body["component"] == "bar"
            feed.close()


def test_a_killed_process_is_started_again_and_the_others_answer_meanwhile(several):
    before = {worker.pid for worker in several.workers("webworker")}
    victim = min(before)
    os.kill(victim, signal.SIGKILL)
    with several.client() as client:
        assert client.component("clean", wait_s=60)["rows"] > 0
        until(
            lambda: (
                len({worker.pid for worker in several.workers("webworker")} - {victim})
                == len(before)
            )
        )
        until(client.is_ready)


def test_a_killed_builder_loses_nothing_that_was_accepted(several):
    (victim,) = several.workers("builder")
    with several.client() as client:
        held = answers(client, clean_wrenches())
        os.kill(victim.pid, signal.SIGKILL)
        assert answers(client, clean_wrenches()) == held
        job = client.solve("bar", [0.0, 0.0, -10.0], [0.0, 0.0, 0.0]).job
        assert job is not None
        until(lambda: client.job(job.id).status == "done")
        assert {worker.pid for worker in several.workers("builder")} != {victim.pid}
        until(client.is_ready)


def test_a_second_server_on_the_same_directory_is_refused_with_what_to_do(several):
    other = SeveralProcesses(several.folder)
    assert other.supervisor.wait(LIMIT_S) == 1
    assert other.supervisor.stderr is not None
    said = other.supervisor.stderr.read()
    other.close()
    assert "is in use by the server at" in said
    assert "--data" in said
    assert "pid" not in said  # no process was started
    with pytest.raises(ServerDidNotStartError, match="call that server with --server"):
        private_server(several.folder, 1).__enter__()


def test_all_processes_end_with_a_supervisor_that_is_killed_and_the_next_counts_from_zero(tmp_path):
    one = SeveralProcesses(tmp_path)
    with one.client() as client:
        client.displacement("bar", [1.0, 0, 0], [0, 0, 0], on_thin="estimate")
        until(
            lambda: "wrenchbook_queries_total{" in client.call("GET", "/metrics").content.decode()
        )
    workers = one.seen.children(recursive=True)
    one.supervisor.kill()
    one.supervisor.wait(LIMIT_S)
    _, alive = psutil.wait_procs(workers, LIMIT_S)
    one.close()
    assert not alive
    after = SeveralProcesses(tmp_path)
    with after.client() as client:
        assert "wrenchbook_queries_total{" not in client.call("GET", "/metrics").content.decode()
    after.end()


def has_been_read(connection):
    """Whether the server has taken all that was sent, by the kernel's table of its connections."""
    port = f":{connection.sock.getsockname()[1]:04X}"
    for line in Path("/proc/net/tcp").read_text().splitlines()[1:]:
        _, _, remote, _, queues, *_ = line.split()
        if remote.endswith(port):
            return int(queues.rsplit(":", 1)[1], 16) == 0
    return False


def test_at_a_signal_who_waits_is_answered_and_no_accepted_job_is_lost(several):
    """The last test of this server: it ends here."""
    with several.client() as client:
        accepted = [
            client.solve("bar", [0.0, 0.0, -20.0 - index / 10], [0.0, 0.0, 0.0]).job.id
            for index in range(100)
        ]
    waiting = http.client.HTTPConnection(
        several.address[0].removeprefix("http://"), timeout=LIMIT_S
    )
    waiting.request("GET", f"/v1/jobs/{accepted[-1]}?wait_s=60")
    assert until(lambda: has_been_read(waiting))
    os.kill(several.supervisor.pid, signal.SIGTERM)
    assert orjson.loads(waiting.getresponse().read())["id"] == accepted[-1]
    waiting.close()
    assert several.supervisor.wait(LIMIT_S) == 0
    ledger = Ledger(several.folder / "ledger.sqlite")
    assert {ledger.job(item).status for item in accepted} <= {"waiting", "done", "running"}
    assert not ledger.losses()
    ledger.close()
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.1", int(several.address[0].rsplit(":", 1)[1])))


# -- restarts (SIGHUP) and ends (SIGTERM) under load: no request is lost -------------------------

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
    result = set()
    for child in psutil.Process(server.pid).children(recursive=True):
        with suppress(psutil.NoSuchProcess):  # it ended meanwhile
            result |= {child.pid} if child.name() == "wb-webworker" else set()
    return result


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
    made.check()

    def look(*signals):
        made._signals.extend(signals)
        made.check()
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
    created = supervisor(signal.SIGHUP)
    created._signals += [signal.SIGHUP, signal.SIGTERM, signal.SIGHUP]
    created.run()
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
    created = supervisor()
    assert StandIn.all[place].got == ["killed"]
    assert StandIn.all[3].name == StandIn.all[place].name
    assert not created.failed


def test_heartbeats_are_read_without_waiting_for_one(monkeypatch):
    """It waited up to 30 s for each answer to a ping; signals and other processes had to wait."""
    child, now = Child.__new__(Child), [0.0]
    child._heartbeats, end = multiprocessing.Pipe(duplex=False)
    child.process, child.started = SimpleNamespace(is_alive=lambda: True), False
    child._last_heartbeat = 0.0
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
