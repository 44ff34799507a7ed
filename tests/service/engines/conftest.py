"""The same bench for every engine: solvers that stand in, attempts, and what ends them."""

import itertools
import os
import shutil
import signal
import uuid
from pathlib import Path

import pytest

from tests.service.engines.cluster import PATH, Cluster
from tests.until import until
from wrenchbook.service.files.lock import is_locked
from wrenchbook.service.jobs.attempt import ALIVE, LOCK, Attempt, prepare, read_outcome
from wrenchbook.service.jobs.dask import DaskEngine
from wrenchbook.service.jobs.solver_pool import LocalEngine


class Bench:
    """Attempts in a folder, engines of one kind that run them, and their solvers' processes."""

    def __init__(self, folder, open_engine, cluster=None):
        self.folder = folder
        self.open_engine = open_engine
        self._cluster = cluster
        self._numbers = itertools.count(1)
        self._name = uuid.uuid4().hex[:8]
        self._engines = []
        self.bundle = folder / "bundle"
        (self.bundle / "meshes").mkdir(parents=True)
        (self.bundle / "component.toml").write_text('name = "part"')
        (self.bundle / "meshes" / "part.msh").write_text("a mesh")

    def engine(self):
        """A new engine, ready to take an attempt."""
        engine = self.open_engine()
        self._engines.append(engine)
        until(lambda: engine.slots > 0)
        return engine

    def attempt(self, solver, **needs):
        """A new attempt, that the named stand-in solves."""
        number = next(self._numbers)
        folder = self.folder / "jobs" / str(number) / "1"
        starts = str(self.folder / f"starts-{number}")
        wrench = (1.0, 2.0, 3.0, 0.0, 0.0, 0.0)
        spec = number, 1, solver, str(self.bundle), starts, wrench
        task = f"{self._name}-{number}-1"
        attempt = Attempt(*spec, folder=folder, task=task, **needs)
        prepare(attempt)
        return attempt

    def started(self, solver, engine, **needs):
        """An attempt that a solver is at."""
        attempt = self.attempt(solver, **needs)
        engine.submit(attempt)
        until(lambda: self.pid(attempt))
        return attempt

    def end(self, engine, attempt):
        """Wait until the engine knows the attempt's end; returns its state."""
        until(lambda: engine.poll(attempt) not in ALIVE)
        return engine.poll(attempt)

    def outcome(self, attempt):
        return read_outcome(attempt)

    def starts(self, attempt):
        starts = Path(attempt.fingerprint)
        return starts.read_text().count("start") if starts.exists() else 0

    def has_begun(self, attempt):
        """Whether a solver has counted its start; it is known by its pid before."""
        return Path(attempt.fingerprint).exists()

    def solver_folders(self, attempt):
        """The folders that solvers of the attempt work in, or have worked in."""
        return [attempt.folder] if self._cluster is None else self._cluster.attempts(attempt.task)

    def pid(self, attempt):
        """The solver's pid as long as it lives; None otherwise."""
        for folder in self.solver_folders(attempt):
            lock = folder / LOCK
            if lock.exists() and is_locked(lock):
                text = lock.read_text()
                return int(text) if text.isdigit() else None
        return None

    def go(self, attempt):
        """Let a solver end that waits for it."""
        for folder in self.solver_folders(attempt):
            (folder / "go").touch()

    def kill_solver(self, attempt):
        os.kill(until(lambda: self.pid(attempt)), signal.SIGKILL)

    def leave(self):
        for engine in self._engines:
            engine.close()
        for lock in self.folder.glob("jobs/*/*/lock"):
            if lock.read_text().isdigit() and is_locked(lock):
                os.kill(int(lock.read_text()), signal.SIGKILL)


@pytest.fixture(scope="session")
def shared_cluster(tmp_path_factory):
    """One scheduler and one worker of two threads, for tests that kill neither."""
    cluster = Cluster(tmp_path_factory.mktemp("cluster"))
    cluster.start_scheduler()
    cluster.start_worker(threads=2)
    yield cluster
    cluster.stop()
    shutil.rmtree(cluster.folder, ignore_errors=True)


@pytest.fixture
def cluster(tmp_path):
    """A cluster of the test's own, nothing of it started."""
    cluster = Cluster(tmp_path / "cluster")
    yield cluster
    cluster.stop()


@pytest.fixture(params=["local", "dask"])
def bench(request, tmp_path):
    if request.param == "local":
        environment = {"WRENCHBOOK_SOLVE": "stand_in:by_component"}
        environment["PYTHONPATH"] = PATH
        bench = Bench(tmp_path, lambda: LocalEngine(2, environment=environment, grace=5.0))
    else:
        bench = dask_bench(tmp_path, request.getfixturevalue("shared_cluster"))
    yield bench
    bench.leave()


@pytest.fixture
def own(tmp_path, cluster):
    """A bench on a cluster of the test's own."""
    bench = dask_bench(tmp_path, cluster)
    yield bench
    bench.leave()


def dask_bench(folder, cluster):
    return Bench(folder, lambda: DaskEngine(cluster.address), cluster)
