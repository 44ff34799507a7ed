"""Schedulers, workers and servers that die or hang: no attempt is lost by it, none counts."""

import signal
import time

import psutil
import pytest

from tests.service.engines.cluster import kill
from tests.service.engines.conftest import dask_bench
from tests.until import until
from wrenchbook.service.jobs.attempt import ALIVE, read_progress, solver_began
from wrenchbook.service.jobs.dispatcher import Dispatcher


@pytest.mark.parametrize("end", ["alone", "with its solver", "given up by Dask"])
def test_a_worker_that_dies_is_replaced_and_the_attempt_does_not_count(own, cluster, end):
    if end == "given up by Dask":
        cluster.environment["DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES"] = "0"
    cluster.start_scheduler()
    worker = cluster.start_worker()
    engine = own.engine()
    attempt = own.started("counted_until_go", engine)
    solver = psutil.Process(own.pid(attempt))
    until(lambda: own.has_begun(attempt) and engine.poll(attempt) == "running")
    if end == "with its solver":  # as a machine goes: all of it at once
        solver.kill()
    kill(worker)
    solver.wait(600)
    cluster.start_worker()
    until(lambda: own.starts(attempt) == 2)
    own.go(attempt)
    assert own.end(engine, attempt) == "finished"
    assert own.starts(attempt) == 2
    assert own.outcome(attempt).status == "done"


def test_what_a_solver_started_ends_with_its_worker_too(own, cluster):
    cluster.start_scheduler()
    worker = cluster.start_worker()
    attempt = own.started("leaves_a_child", own.engine())
    (folder,) = own.solver_folders(attempt)
    until((folder / "child").exists)
    child = psutil.Process(int(until((folder / "child").read_text)))
    kill(worker)
    child.wait(600)


def test_a_scheduler_that_dies_is_found_again_with_the_attempts(own, cluster):
    cluster.start_scheduler()
    cluster.start_worker()
    engine = own.engine()
    attempt = own.started("counted_until_go", engine)
    until(lambda: own.has_begun(attempt))
    waiting = [own.attempt("quick") for _ in range(3)]
    for item in waiting:
        engine.submit(item)
    cluster.kill_scheduler()
    until(lambda: engine.trouble)
    assert engine.slots == 0
    assert all(engine.poll(item) in (*ALIVE, "finished") for item in (attempt, *waiting))
    cluster.mend(1)
    until(lambda: cluster.mend(1) or not engine.trouble)  # workers end with their scheduler
    until(lambda: own.starts(attempt) == 2)  # solvers end with their workers
    own.go(attempt)
    for item in (attempt, *waiting):
        assert own.end(engine, item) == "finished"
    assert own.starts(attempt) == 2


def test_a_connection_that_is_lost_and_comes_back_finds_the_same_task(own, cluster):
    cluster.start_scheduler()
    cluster.start_worker()
    engine = own.engine()
    attempt = own.started("counted_until_go", engine)
    until(lambda: own.has_begun(attempt))
    cluster.cut_connection()
    own.go(attempt)
    assert own.end(engine, attempt) == "finished"
    assert own.outcome(attempt).status == "done"
    assert own.starts(attempt) == 1


def test_a_worker_that_is_stopped_holds_nothing_up_for_long(own, cluster):
    """Dask drops it after `worker-ttl`, and another worker takes what it had."""
    cluster.start_scheduler()
    worker = cluster.start_worker()
    engine = own.engine()
    attempt = own.attempt("counted_until_go")
    engine.submit(attempt)
    until(lambda: own.starts(attempt) == 1 and engine.poll(attempt) == "running")
    worker.send_signal(signal.SIGSTOP)
    cluster.start_worker()
    cluster.drop_silent(worker)
    until(lambda: own.starts(attempt) == 2)
    own.go(attempt)
    assert own.end(engine, attempt) == "finished"
    assert own.starts(attempt) == 2
    worker.send_signal(signal.SIGCONT)


def test_no_call_waits_for_a_scheduler_that_is_stopped(own, cluster):
    cluster.start_scheduler()
    cluster.start_worker()
    engine, attempt = own.engine(), own.attempt("endless")
    cluster.scheduler.send_signal(signal.SIGSTOP)
    for call in (engine.submit, engine.poll, engine.cancel, engine.poll):
        call(attempt)
    assert engine.trouble is None
    cluster.scheduler.send_signal(signal.SIGCONT)
    own.end(engine, attempt)


def test_cancelling_what_a_stopped_worker_has_comes_to_an_end(own, cluster):
    cluster.start_scheduler()
    worker = cluster.start_worker()
    engine = own.engine()
    attempt = own.started("endless", engine)
    until(lambda: engine.poll(attempt) == "running")
    worker.send_signal(signal.SIGSTOP)
    engine.cancel(attempt)
    own.end(engine, attempt)
    worker.send_signal(signal.SIGCONT)


def test_a_higher_priority_goes_first_of_what_no_worker_has_yet(own, cluster):
    """A worker has one order a thread ahead, whichever came first, which it keeps."""
    cluster.start_scheduler()
    cluster.start_worker()
    engine = own.engine()
    busy = own.started("waits_for_a_word", engine)
    low = [own.attempt("counts") for _ in range(4)]
    high = own.attempt("counts", priority=5)
    for one in (*low, high):
        engine.submit(one)
    until(lambda: all(cluster.knows(item.task) for item in (*low, high)))
    own.go(busy)
    for one in (busy, *low, high):
        assert own.end(engine, one) == "finished"
    begun = sorted((*low, high), key=lambda one: own.outcome(one).further["seen"]["at"])
    assert high in begun[:2]


def test_a_solve_waits_for_a_worker_with_the_memory_it_takes(own, cluster):
    cluster.start_scheduler()
    cluster.start_worker(memory="1GB")
    engine = own.engine()
    large, small = own.attempt("quick", memory=3_000_000_000), own.attempt("quick")
    engine.submit(large)
    engine.submit(small)
    assert own.end(engine, small) == "finished"  # what waits keeps nobody else waiting
    until(lambda: engine.trouble)
    assert "3 GB" in engine.trouble
    assert "the largest Dask workers have 1 GB" in engine.trouble
    assert "3 GB" in read_progress(large.folder).message
    cluster.start_worker(memory="4GB")
    assert own.end(engine, large) == "finished"
    assert engine.trouble is None


def test_declared_resources_keep_large_solves_from_sharing_a_worker(own, cluster):
    cluster.start_scheduler()
    cluster.start_worker(threads=2, resources="wrenchbook_memory=4e9 wrenchbook_cores=2")
    engine = own.engine()
    first = own.started("waits_for_a_word", engine, memory=3_000_000_000)
    other = own.attempt("quick")  # before the next: a Dask worker looks at its oldest task alone
    engine.submit(other)
    own.end(engine, other)
    second = own.attempt("counted_until_go", memory=3_000_000_000)
    engine.submit(second)
    assert engine.poll(first) == "running"
    assert engine.poll(second) == "submitted"
    assert not own.has_begun(second)
    own.go(first)
    own.end(engine, first)
    until(lambda: own.has_begun(second))
    own.go(second)
    assert own.end(engine, first) == own.end(engine, second) == "finished"


# -- jobs that wait in the queue of the cluster: neither their time nor running ------------------

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
    waited = [ledger.job(job.id) for job in queued if job.is_queued]
    assert len(waited) == THREADS
    for job in waited:
        assert job.began > gone
        assert job.seconds <= job.finished - gone < job.finished - job.started
    assert ledger.statistics().solve_seconds == pytest.approx(sum(job.seconds for job in done))
