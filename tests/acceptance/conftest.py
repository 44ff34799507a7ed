"""Real servers in processes of their own."""

import os
import signal
import socket
import subprocess
import sys
from urllib.parse import urlsplit

import pytest

from tests.until import until
from wrenchbook.service.client import Client


class RealServer:
    """`wrenchbook serve` on a folder, to be killed and started again."""

    def __init__(self, folder):
        self.folder = folder
        self.process = None
        self.address = self.client = None

    def start(self, solvers=2, options=(), environment=None):
        command = [
            sys.executable,
            "-m",
            "wrenchbook.service.cli.main",
            "serve",
            "--data",
            str(self.folder),
        ]
        command += ["--port", "0", "--solvers", str(solvers), "--log-level", "warning"]
        command += options
        variables = dict(os.environ) | (environment or {})
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=variables)
        url = self.process.stdout.readline().split()[-1]
        self.address = urlsplit(url).hostname, urlsplit(url).port
        self.client = Client(url, timeout=600)
        until(lambda: self.process.poll() is not None or self.client.is_ready())
        assert self.process.poll() is None
        return self.client

    def kill(self):
        os.kill(self.process.pid, signal.SIGKILL)
        self._gone()

    def stop(self):
        if self.process and self.process.poll() is None:
            self.process.terminate()
            self._gone()

    def _listens(self):
        try:
            socket.create_connection(self.address, timeout=5).close()
        except OSError:
            return False
        return True

    def _gone(self):
        self.process.wait(600)
        until(lambda: not self._listens())  # web workers notice the end of their supervisor
        self.process.stdout.close()
        self.client.close()


@pytest.fixture
def server(tmp_path):
    real = RealServer(tmp_path / "workspace")
    yield real
    real.stop()
