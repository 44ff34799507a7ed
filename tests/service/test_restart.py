"""A server under load that is restarted (SIGHUP) or ended (SIGTERM): no request is lost."""

import http.client
import json
import os
import signal
import subprocess
import threading
from contextlib import contextmanager, suppress

import psutil
import pytest

from tests.until import until
from wrenchbook.service.files.program import child_command

LIMIT_S = 60.0
BODY = json.dumps({"force": [0, 0, -10], "moment": [0, 0, 0], "on_thin": "estimate"})
CONNECTIONS = 4
QUERY, USUAL = "/v1/components/spring/displacement", "/v1/components/spring"


@contextmanager
def serving(folder, processes):
    command = child_command(
        "wrenchbook.service.cli.main", "serve", "--data", str(folder), "--port", "0"
    )
    words = ["--processes", str(processes), "--solvers", "0", "--log-level", "error"]
    server = subprocess.Popen([*command, *words], stdout=subprocess.PIPE, text=True)
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
def test_a_restart_of_the_web_workers_loses_no_request(tmp_path, processes):
    with serving(tmp_path, processes) as (server, port):
        before, load = web_workers(server), Load(port)
        os.kill(server.pid, signal.SIGHUP)
        until(lambda: len(new := web_workers(server)) == processes and not new & before)
        seen = min(load.replies)
        until(lambda: load.faults or min(load.replies) > seen)
        assert load.end() == []


def test_the_last_reply_of_each_connection_says_that_it_closes_when_the_server_ends(tmp_path):
    with serving(tmp_path, 2) as (server, port):
        load = Load(port, until_closed=True)
        os.kill(server.pid, signal.SIGTERM)
        for thread in load.threads:
            thread.join(LIMIT_S)
        assert server.wait(LIMIT_S) == 0
        assert load.end() == []
