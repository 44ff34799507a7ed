"""kill -9 of server, solvers, workers and scheduler while jobs come in over HTTP.

Every accepted job ends with its one row, on each engine. WRENCHBOOK_SOAK_KILLS=200 and
WRENCHBOOK_SOAK_SEEDS=5 make a long run of it (``make soak``).
"""

import contextlib
import json
import os
import random
import threading
from collections import Counter

import pytest

from tests.service.engines.cluster import SOURCES, TESTS, Cluster, kill, kill_solver
from tests.until import until
from wrenchbook.service.client.errors import ProblemError

KILLS = int(os.environ.get("WRENCHBOOK_SOAK_KILLS", "4"))
SEEDS = range(int(os.environ.get("WRENCHBOOK_SOAK_SEEDS", "1")))
JOBS, TWICE = 30, 10
SOLVER_DEATHS = 2  # a third fails the job, as it should
ENDED_AFTER_SECONDS = 150.0  # of the last kill; on a machine that is busy
SOLVERS = {"WRENCHBOOK_SOLVE": "stand_in:slow", "PYTHONPATH": f"{TESTS}:{SOURCES}"}


class Site:
    """A server on an engine, all of whose processes may be killed."""

    def __init__(self, server, cluster, seed):
        self.server = server
        self.cluster = cluster
        self.chance = random.Random(seed)
        self.killed = Counter()
        self._deaths = Counter()
        self._at_cluster = threading.Lock()
        self._over = threading.Event()
        self._mender = threading.Thread(target=self._mend_on, daemon=True)
        self._mender.start()
        if cluster:
            self._options = ("--engine", "dask", "--scheduler", cluster.address)
            self._attempts = cluster.folder / "scratch"
        else:
            self._options = ()
            self._attempts = server.folder / "jobs"
        self.client = self._serve()

    def _serve(self):
        return self.server.start(options=self._options, environment=SOLVERS)

    def kill_one(self):
        """Kill one of the processes that there are; return whether there was one."""
        victims = ["server", "solver", "solver"]
        if self.cluster:
            victims += ["worker", "worker", "scheduler"]
        victim = self.chance.choice(victims)
        if victim == "server":
            self.server.kill()
            self.client = self._serve()
        elif victim == "solver":
            if not self._kill_a_solver():
                return False
        else:
            with self._at_cluster:
                if victim == "worker" and self.cluster.workers:
                    kill(self.chance.choice(self.cluster.workers))
                else:
                    self.cluster.kill_scheduler()
        self.killed[victim] += 1
        return True

    def close(self):
        self._over.set()
        self._mender.join()

    def _mend_on(self):
        """Be what starts again what has died: systemd, or a container's restart policy."""
        while self.cluster and not self._over.wait(0.2):
            with self._at_cluster:
                self.cluster.mend(workers=2)

    def _kill_a_solver(self):
        locks = list(self._attempts.glob("**/lock"))
        self.chance.shuffle(locks)
        for lock in locks:
            try:
                job = json.loads(lock.with_name("spec.json").read_bytes())["job"]
            except OSError:
                continue
            if self._deaths[job] < SOLVER_DEATHS and kill_solver(lock):
                self._deaths[job] += 1
                return True
        return False

    def ask(self, wrench):
        """Have a job accepted, however often the server has to be asked."""

        def accepted():
            with contextlib.suppress(ProblemError, OSError):  # it is being started
                return self.client.solve("plate_thin", wrench).job

        return until(accepted)

    def open_jobs(self):
        # In one list: a job whose solver is killed between two goes from one to the other.
        return sum(not job.ended for job in self.client.jobs("plate_thin"))


@pytest.fixture(params=["local", "dask"])
def cluster(request, tmp_path):
    result = Cluster(tmp_path / "cluster", solver="slow") if request.param == "dask" else None
    yield result
    if result:
        result.stop()  # after the site's mender


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.timeout(300 + 10 * KILLS)
def test_every_accepted_job_has_one_row_whatever_is_killed(request, server, cluster, seed):
    site = Site(server, cluster, seed)
    request.addfinalizer(site.close)
    wrenches = [(0.0, 0.0, -float(load), 0.0, 0.0, 0.0) for load in range(10, 10 * JOBS + 1, 10)]
    asked = wrenches + site.chance.sample(wrenches, TWICE)
    site.chance.shuffle(asked)
    kills = 0
    for number, wrench in enumerate(asked):
        site.ask(wrench)
        if number % 10 == 9 and kills < KILLS:
            kills += site.kill_one()
    while kills < KILLS:
        kills += site.kill_one()
        for _ in range(site.chance.randrange(20)):  # at any moment of what goes on
            site.open_jobs()
    _wait_until_all_ended(site)
    jobs = site.client.jobs("plate_thin")
    assert Counter(job.status for job in jobs) == {"done": JOBS}, site.killed
    rows = site.client.call_json("GET", "/v1/components/plate_thin/table")["rows"]
    assert sorted(tuple(row["wrench"]) for row in rows) == sorted(wrenches)
    for row in rows:
        assert row["displacement"] == pytest.approx([1e-6 * load for load in row["wrench"]])
    print(f"killed: {dict(site.killed)}")


def _wait_until_all_ended(site):
    until(lambda: site.open_jobs() == 0, ENDED_AFTER_SECONDS)
