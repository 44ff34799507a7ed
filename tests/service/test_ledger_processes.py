"""Several processes on one ledger file."""

import subprocess
import sys

from tests.service.ledger_rows import NewRow, insert, stored
from wrenchbook.service.ledger import Ledger

WORK = """
import sys
import threading
from wrenchbook.service.ledger import Ledger
print("ready", flush=True)
sys.stdin.readline()
ledger = Ledger(sys.argv[1])
def commit(name):
    job = ledger.claim(name)
    if job:
        ledger.commit(job.id, job.attempt, [load * 1e-6 for load in job.wrench])
        print(f"{job.id}\\n", end="")
    return job
def work(name):
    for load in range(int(sys.argv[3])):
        ledger.accept("bar", "f", (load, 0, 0, 0, 0, 0))
        commit(name)
    while commit(name):
        pass
threads = [threading.Thread(target=work, args=(sys.argv[2] + name,)) for name in "ab"]
for thread in threads:
    thread.start()
for thread in threads:
    thread.join()
ledger.close()
"""


def start(code, *arguments):
    command = [sys.executable, "-c", code, *map(str, arguments)]
    pipe = subprocess.PIPE
    return subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True)


def start_together(path, count, jobs):
    """Start processes that open the ledger in the same instant."""
    workers = [start(WORK, path, f"worker {i}", jobs) for i in range(count)]
    for worker in workers:
        assert worker.stdout.readline() == "ready\n"
    for worker in workers:
        worker.stdin.write("go\n")
        worker.stdin.flush()
    return workers


def test_threads_of_processes_that_open_accept_and_claim_at_once_share_each_job_once(tmp_path):
    path = tmp_path / "ledger.sqlite"
    workers = start_together(path, 3, 100)
    printed = [worker.communicate(timeout=60)[0] for worker in workers]
    assert [worker.returncode for worker in workers] == [0, 0, 0]
    claimed = sorted(int(line) for text in printed for line in text.split())
    ledger = Ledger(path)
    assert claimed == sorted(job.id for job in ledger.jobs(status="done", limit=1000))
    assert sorted(row.wrench[0] for row in stored(ledger, "bar")) == list(range(100))
    ledger.close()


def test_what_another_process_commits_changes_the_version(tmp_path):
    path = tmp_path / "ledger.sqlite"
    ledger = Ledger(path)
    insert(ledger, "bar", "f", [NewRow((1, 0, 0, 0, 0, 0), (0,) * 6)])
    job, _ = ledger.accept("bar", "f", (5, 0, 0, 0, 0, 0))
    seen = ledger.version()
    (worker,) = start_together(path, 1, 30)
    worker.communicate(timeout=60)
    assert ledger.job(job.id).status == "done"
    assert ledger.version() != seen
    assert len(stored(ledger, "bar", after=1)) == 30
    ledger.close()


def test_a_process_killed_in_the_middle_of_its_writing_leaves_a_ledger_that_opens(tmp_path):
    path = tmp_path / "ledger.sqlite"
    endless = """
import sys
from wrenchbook.service.ledger import Ledger
ledger = Ledger(sys.argv[1])
load = 0
while True:
    load += 1
    ledger.accept("bar", "f", (load, 0, 0, 0, 0, 0))
    print(load, flush=True)
"""
    worker = start(endless, path)
    acknowledged = [int(worker.stdout.readline()) for _ in range(50)]
    worker.kill()
    # What readline has read ahead too, which communicate leaves out.
    acknowledged += [int(line) for line in worker.stdout.read().splitlines()]
    worker.communicate()
    ledger = Ledger(path)
    there = {job.wrench[0] for job in ledger.jobs(limit=10**6)}
    assert set(acknowledged) <= there
    assert len(there) <= len(acknowledged) + 1
    ledger.close()
