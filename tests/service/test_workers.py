"""A real server of several processes: the same answers from all, and what a kill of each does."""

import http.client
import io
import os
import signal
import socket
import subprocess
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
import orjson
import psutil
import pytest
from rich.console import Console

from tests.service.live import FULL, add_table, as_rows, clean_wrenches, moved
from tests.until import until
from wrenchbook.service.cli.jobs import follow_jobs
from wrenchbook.service.client import Client, ProblemError
from wrenchbook.service.files.program import child_command
from wrenchbook.service.keys import Keyring
from wrenchbook.service.ledger import Ledger

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
        paths = f"{HERE}:{HERE.parents[1]}"
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
        found = []
        for one in self.seen.children(recursive=True):
            with suppress(psutil.Error):  # it has ended just now
                found += [one] if one.name() == f"wb-{word}" else []
        return found

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


@contextmanager
def clients_of_each(several):
    """Give a client of each process that answers, told by the port its connection has."""
    answering = several.workers("webworker")
    found, rest = {}, []
    try:
        while len(found) < len(answering):
            client = several.client()
            rest.append(client)
            client.health()
            assert len(rest) < 200, "one process takes no connections"
            holders = {one.pid: len(one.net_connections()) for one in answering}
            for pid, number in holders.items():
                if number > 1 + sum(1 for held in found.values() if held[0] == pid):
                    found.setdefault(pid, (pid, client))
        yield [client for _, client in found.values()]
    finally:
        for client in rest:
            client.close()


def answers(client, wrenches):
    found = client.displacements("clean", wrenches, on_thin="estimate")
    return found.displacements.tobytes() + found.errors.tobytes()


def statuses(several, headers):
    """What connections of their own are answered, which several processes take."""
    found = set()
    for _ in range(12):
        one = http.client.HTTPConnection(
            several.address[0].removeprefix("http://"), timeout=LIMIT_S
        )
        one.request("GET", "/v1/jobs", headers=headers)
        found.add(one.getresponse().status)
        one.close()
    return found


def statuses_of_each(clients, method="GET", key=None):
    """What each process answers on the connection that is its own, kept open."""
    found = set()
    for client in clients:
        headers = {"Authorization": f"Bearer {key}"} if key else {}
        try:
            client.call(method, "/v1/jobs", headers=headers)
            found.add(200)
        except ProblemError as problem:
            found.add(problem.status)
    return found


def test_every_process_has_the_same_access_control(several):
    for headers in ({"Host": "evil.example"}, {"Origin": "http://evil.example"}):
        assert statuses(several, headers) == {403}
    keyring = Keyring(several.folder)
    with clients_of_each(several) as clients:
        key = keyring.add("ann", "read")
        try:
            # New connections go to one process for a while: only those held tell of each.
            until(lambda: statuses_of_each(clients) == {401})
            assert statuses_of_each(clients, key=key) == {200}
            assert statuses_of_each(clients, "DELETE", key) == {403}
            assert statuses_of_each(clients, key="wrong") == {401}
        finally:
            keyring.revoke("ann")
            until(lambda: statuses_of_each(clients) == {200})


def test_a_key_has_one_rate_for_all_processes(several):
    """Each web worker counted for itself: 109 requests for 40."""
    keyring = Keyring(several.folder)
    with clients_of_each(several) as clients:
        key = keyring.add("slow", "read", rate=1e-4)  # one now, and the next in hours
        try:
            until(lambda: statuses_of_each(clients) == {401})
            found = [statuses_of_each([client], key=key) for client in [*clients, *clients]]
            assert sorted(map(min, found)) == [200, 429, 429, 429]
        finally:
            keyring.revoke("slow")
            until(lambda: statuses_of_each(clients) == {200})


def test_every_process_gives_the_bits_that_a_table_of_one_process_does(several):
    wrenches = np.random.default_rng(3).uniform(-1, 1, (200, 6)) * FULL
    with clients_of_each(several) as clients:
        whole = clients[0].download("clean").batch(wrenches)
        told = {answers(client, wrenches) for client in clients}
    assert told == {whole.displacements.tobytes() + whole.errors.tobytes()}


def test_a_row_taken_by_one_process_is_answered_by_all(several):
    body = orjson.dumps({"rows": [{"wrench": [50.0, 0, 0, 0, 1, 2], "displacement": [1e-5] * 6}]})
    with clients_of_each(several) as clients:
        version = clients[0].import_table("clean", body, format="json")["table_version"]
        for client in clients:
            until(lambda one=client: one.component("clean")["table_version"] >= version)
            told = client.displacement("clean", [50.0, 0, 0], [0, 1, 2], on_thin="estimate")
            assert told.table_version == version


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


def test_requests_are_counted_over_all_processes(several):
    def requests(client):
        text = client.call("GET", "/metrics").content.decode()
        start = 'wrenchbook_http_requests_total{method="GET",route="/v1/jobs/{job_id}"'
        return sum(float(one.split()[-1]) for one in text.splitlines() if one.startswith(start))

    with clients_of_each(several) as clients:
        for client in clients:
            with pytest.raises(ProblemError):
                client.call("GET", "/v1/jobs/123456")
        until(lambda: {requests(client) for client in clients} == {len(clients)})


def counted(client, method):
    text = client.call("GET", "/metrics").content.decode()
    lines = [line for line in text.splitlines() if line.startswith("wrenchbook_queries_total")]
    return sum(float(line.split()[1]) for line in lines if f'method="{method}"' in line)


def test_what_was_not_covered_is_counted_by_all_processes_together(several):
    with clients_of_each(several) as clients:
        for client in clients:
            client.displacement("spring", [9e5, 0, 0], [0, 0, 0], on_thin="estimate")
        path = "/v1/components/spring/demand"
        until(lambda: {client.call("GET", path).json()["asked"] for client in clients} == {2})


def test_a_job_that_one_process_has_taken_is_told_to_listeners_of_all(several):
    with clients_of_each(several) as clients:
        feeds = [client.events("bar") for client in clients]
        for feed in feeds:
            assert next(feed).kind == "hello"
        job = clients[0].solve("bar", [0.0, 0.0, -11.0], [0.0, 0.0, 0.0]).job
        for feed in feeds:
            told = next(
                one
                for one in feed
                if (one.body.get("id"), one.body.get("status")) == (job.id, "done")
            )
            assert told.body["component"] == "bar"
            feed.close()


class SeenError(Exception):
    """What was waited for was shown."""


def test_jobs_followed_at_one_process_are_shown_as_another_takes_them_and_all_run_them(several):
    out, taken = Console(file=io.StringIO(), width=200), []
    with clients_of_each(several) as (follows, accepts):

        def show(*words, **how):
            Console.print(out, *words, **how)
            if not taken:  # the table of open jobs is shown: from now on nothing is missed
                taken.append(accepts.solve("bar", [0.0, 0.0, -12.0], [0.0, 0.0, 0.0]).job.id)
            if f"job {taken[0]} of bar: done, row" in out.file.getvalue():
                raise SeenError

        out.print = show
        with pytest.raises(SeenError):
            follow_jobs(out, follows, "bar", timeout_s=LIMIT_S)


def test_a_killed_process_is_started_again_and_the_others_answer_meanwhile(several):
    before = {one.pid for one in several.workers("webworker")}
    victim = min(before)
    os.kill(victim, signal.SIGKILL)
    with several.client() as client:
        assert client.component("clean")["rows"] > 0
        until(
            lambda: len({one.pid for one in several.workers("webworker")} - {victim}) == len(before)
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
        assert {one.pid for one in several.workers("builder")} != {victim.pid}
        until(client.is_ready)


def test_a_second_server_on_the_same_directory_is_refused_with_what_to_do(several):
    other = SeveralProcesses(several.folder)
    assert other.supervisor.wait(LIMIT_S) == 1
    assert other.supervisor.stderr is not None
    said = other.supervisor.stderr.read()
    other.close()
    assert "another server uses" in said
    assert "--data" in said
    assert "pid" not in said  # no process was started


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
            client.solve("bar", [0.0, 0.0, -20.0 - one / 10], [0.0, 0.0, 0.0]).job.id
            for one in range(100)
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
    assert {ledger.job(one).status for one in accepted} <= {"waiting", "done", "running"}
    assert not ledger.losses()
    ledger.close()
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.1", int(several.address[0].rsplit(":", 1)[1])))
