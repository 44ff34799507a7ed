"""Jobs that wait in the queue of a Dask cluster: neither their solves' time nor running."""

import time

import pytest

from tests.service.engines.conftest import dask_bench
from tests.until import until
from wrenchbook.service.jobs.attempt import solver_began
from wrenchbook.service.jobs.dispatcher import Dispatcher

THREADS = 2  # of the cluster's worker, which is given twice as many attempts


@pytest.fixture
def queued(tmp_path, shared_cluster, ledger):
    """Jobs of which two run until `go`, and two wait in the cluster."""
    bench = dask_bench(tmp_path, shared_cluster)
    dispatcher = Dispatcher(ledger, bench.engine(), lambda name: bench.bundle, tmp_path / "jobs")
    dispatcher.start()
    wrenches = [(float(load), 0.0, 0.0, 0.0, 0.0, 0.0) for load in range(2 * THREADS)]
    for wrench in wrenches:
        ledger.accept("waits_for_a_word", "f1", wrench)
    until(lambda: len([job for job in ledger.running() if job.began]) == THREADS)
    until(lambda: len(ledger.running()) == 2 * THREADS)
    yield ledger.running()
    dispatcher.stop()
    bench.leave()


def let_all_end(cluster, ledger, jobs):
    def are_done():
        for job in jobs:
            for folder in filter(solver_began, cluster.attempts(job.task)):
                (folder / "go").touch()
        return all(ledger.job(job.id).status == "done" for job in jobs)

    until(are_done)


def test_no_more_jobs_are_running_than_the_cluster_has_threads(ledger, queued):
    counts = ledger.counts()
    assert (counts["running"], counts["waiting"]) == (THREADS, THREADS)
    assert ledger.statistics().jobs == counts
    assert sum(job.is_queued for job in queued) == THREADS


def test_solve_seconds_and_a_jobs_seconds_leave_out_the_queue_of_the_cluster(
    ledger, queued, shared_cluster
):
    gone = time.time()
    let_all_end(shared_cluster, ledger, queued)
    done = [ledger.job(job.id) for job in queued]
    waited = [job for job in done if job.began > gone]
    assert len(waited) == THREADS
    for job in waited:
        assert job.seconds <= job.finished - gone < job.finished - job.started
    assert ledger.statistics().solve_seconds == pytest.approx(sum(job.seconds for job in done))
