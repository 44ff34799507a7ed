"""A loop that records while its server is killed: nothing queued, each wrench once.

WRENCHBOOK_SOAK=60 makes a long run of it.
"""

import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

from tests.ports import reserved_port
from tests.until import until
from wrenchbook.service.client import Client, Recorder

HERE = Path(__file__).parent
SECONDS = float(os.environ.get("WRENCHBOOK_SOAK", "3"))
RATE = 1000.0
KILLS = 1 + int(SECONDS // 12)


class Site:
    """A data directory, an address, and the server that serves it at present."""

    def __init__(self, folder):
        self.folder = folder
        self.port = reserved_port()
        self.url = f"http://127.0.0.1:{self.port}"
        self.start()

    def start(self):
        command = [sys.executable, "-m", "wrenchbook", "serve"]
        command += ["--data", str(self.folder), "--port", str(self.port), "--solvers", "0"]
        log = (self.folder.parent / "log").open("ab")
        self.server = subprocess.Popen([*command, "--log-level", "warning"], stdout=log, stderr=log)
        log.close()

    def wait_until_ready(self):
        with Client(self.url, timeout=600) as client:
            until(client.is_ready)

    def kill(self):
        self.server.send_signal(signal.SIGKILL)
        self.server.wait()


@pytest.fixture
def site(tmp_path):
    site = Site(tmp_path / "data")
    yield site
    site.kill()


def loop_wrenches(count):
    """A loop's wrenches, (count, 6), N and N·m: a smooth path, no two within 1e-6 of the range."""
    t = np.arange(count) / RATE
    path = np.stack([np.sin((1 + 0.3 * load) * t + load) for load in range(6)], axis=1)
    path *= np.array([500.0, 500, 1000, 50, 50, 50])
    path[:, 2] += 0.01 * np.arange(count)  # 5e-6 of the range a step
    return path


@pytest.mark.timeout(1800 + 4 * SECONDS)
@pytest.mark.parametrize("kind", ["recording", "envelope"])
def test_a_loop_whose_server_is_killed_loses_nothing_and_doubles_nothing(site, kind):
    site.wait_until_ready()
    wrenches = loop_wrenches(int(SECONDS * RATE))

    def kill_after(recorded):
        until(lambda: recorder.recorded > recorded)  # more blocks are on their way
        site.kill()
        site.start()
        site.wait_until_ready()

    with Client(site.url, timeout=600) as client:
        recorder = Recorder(client, "plate_thin", kind=kind, block=64)
        for part in np.array_split(wrenches, KILLS):
            other = threading.Thread(target=kill_after, args=(recorder.recorded,))
            other.start()
            for wrench in part:
                recorder.add(wrench)
            other.join()
        recorder.close(60)
        assert recorder.recorded == len(wrenches)
        assert client.jobs() == []
        results = client.recording("plate_thin") if kind == "recording" else None
        count = results.total if results else client.envelope("plate_thin").count
        assert count == len(wrenches)
        if results is None:
            assert np.array_equal(client.envelope("plate_thin").max, wrenches.max(axis=0))
        elif results.thinned:
            assert len(results) + results.merged + results.thinned == len(wrenches)
        else:
            assert np.array_equal(results.wrenches, wrenches)
