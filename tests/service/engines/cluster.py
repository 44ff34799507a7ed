"""A Dask cluster of processes of this machine, to be killed and started again."""

import itertools
import os
import signal
import subprocess
import sys
from pathlib import Path

from distributed import Client

from tests.ports import reserved_port
from tests.until import until

TESTS = Path(__file__).parents[1]
SOURCES = TESTS.parents[1]
PATH = f"{TESTS}:{SOURCES}:{SOURCES}/src"
SETTINGS = {
    "DASK_DISTRIBUTED__COMM__TIMEOUTS__CONNECT": "10s",
    "DASK_DISTRIBUTED__SCHEDULER__WORKER_TTL": "10s",
    "DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED": "False",
    "OMP_NUM_THREADS": "1",
}


class Cluster:
    """One scheduler and its workers, each in a session of its own."""

    def __init__(self, folder, solver="by_component", **settings):
        self.folder = folder
        self.port = reserved_port()
        self.address = f"tcp://127.0.0.1:{self.port}"
        self.environment = dict(os.environ) | SETTINGS | {"PYTHONPATH": PATH}
        if solver:
            self.environment["WRENCHBOOK_SOLVE"] = f"stand_in:{solver}"
        self.environment |= settings
        self.scheduler = None
        self.workers = []
        self._numbers = itertools.count(1)

    def attempts(self, task="*"):
        """The folders of an attempt on the workers, or of all."""
        scratch = self.folder / "scratch"
        return list(scratch.glob(f"dask-scratch-space/*/wrenchbook/attempts/{task}"))

    def start_scheduler(self):
        command = ["scheduler", "--host", "127.0.0.1", "--port", str(self.port), "--no-dashboard"]
        self.scheduler = self._start(command, "scheduler.log", self.environment)

    def start_worker(self, threads=1, resources=None, memory=None, **environment):
        command = ["worker", self.address, "--nthreads", str(threads), "--no-nanny"]
        command += ["--no-dashboard", "--death-timeout", "60"]
        command += ["--resources", resources] if resources else []
        command += ["--memory-limit", memory] if memory else []
        command += ["--local-directory", str(self.folder / "scratch")]
        command += ["--name", f"worker-{next(self._numbers)}"]
        worker = self._start(command, "worker.log", self.environment | environment)
        worker.name = command[-1]
        self.workers.append(worker)
        return worker

    def knows(self, task):
        """Whether the scheduler has an order of an attempt."""

        def ordered(dask_scheduler):
            return any(task in str(key) for key in dask_scheduler.tasks)

        with Client(self.address) as client:
            return client.run_on_scheduler(ordered)

    def drop_silent(self, worker):
        """Have the scheduler drop a worker as if `worker-ttl` had passed without a heartbeat."""
        name = worker.name

        async def drop(dask_scheduler):
            for worker in dask_scheduler.workers.values():
                if worker.name == name:
                    worker.last_seen -= 3600
            await dask_scheduler.check_worker_ttl()

        with Client(self.address) as client:
            client.run_on_scheduler(drop)

    def cut_connection(self):
        """Close the servers' connections to the scheduler, and wait until they have new ones."""

        def cut(dask_scheduler):
            for name, comm in dask_scheduler.client_comms.items():
                if "wrenchbook" in name:
                    comm.comm.abort()

        def is_back(dask_scheduler):
            comms = dask_scheduler.client_comms.items()
            return any("wrenchbook" in name and not comm.closed() for name, comm in comms)

        with Client(self.address) as client:
            assert client.run_on_scheduler(is_back)
            client.run_on_scheduler(cut)
            until(lambda: client.run_on_scheduler(is_back))

    def mend(self, workers):
        """Start again what has ended, as systemd or a container's restart policy would."""
        if self.scheduler is None or self.scheduler.poll() is not None:
            self.start_scheduler()
        self.workers = [worker for worker in self.workers if worker.poll() is None]
        while len(self.workers) < workers:
            self.start_worker()

    def kill_scheduler(self):
        kill(self.scheduler)

    def stop(self):
        for program in (self.scheduler, *self.workers):
            if program is not None:
                kill(program)
        for folder in self.attempts():
            kill_solver(folder / "lock")

    def _start(self, command, log, environment):
        self.folder.mkdir(parents=True, exist_ok=True)
        words = [sys.executable, "-W", "ignore", "-m", "dask", *command]
        with (self.folder / log).open("ab") as out:
            return subprocess.Popen(words, env=environment, cwd=self.folder, stdout=out, stderr=out)


def kill(program):
    if program.poll() is None:
        program.send_signal(signal.SIGKILL)
    program.wait(600)


def kill_solver(lock):
    """Kill the solver that holds a lock; return whether there was one."""
    from wrenchbook.service.files.lock import is_locked

    try:
        pid = int(lock.read_text())
        if is_locked(lock):
            os.kill(pid, signal.SIGKILL)
            return True
    except (OSError, ValueError):
        pass
    return False
