"""The ledger against a dict of jobs and a list of rows, under any order of calls."""

import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from tests.service.ledger_rows import NewRow, insert, stored
from wrenchbook.service.ledger import (
    InvalidTransitionError,
    Ledger,
    StaleAttemptError,
    jobs,
)

LOADS = st.sampled_from([-1.0, -0.0, 0.0, 1.0])
WRENCHES = st.tuples(LOADS, LOADS, *[st.just(0.0)] * 4)
COMPONENTS = st.sampled_from(["bar", "plate"])
BACKOFF = jobs.BACKOFF_SECONDS
ERROR = {"kind": "k", "message": "m", "remedy": "r"}


@dataclass
class Expected:
    """What the reference knows of a job."""

    key: tuple
    status: str = "waiting"
    attempt: int = 0
    lost: int = 0
    row: int | None = None


def answer(wrench):
    return tuple(load * 1e-6 + 0.0 for load in wrench)


class LedgerAgainstReference(RuleBasedStateMachine):
    def __init__(self):
        super().__init__()
        jobs.BACKOFF_SECONDS = (0.0, 0.0, 0.0)
        self.folder = Path(tempfile.mkdtemp())
        self.ledger = Ledger(self.folder / "ledger.sqlite")
        self.jobs: dict[int, Expected] = {}
        self.rows: dict[tuple, int] = {}
        self.committed = []

    def teardown(self):
        jobs.BACKOFF_SECONDS = BACKOFF
        self.ledger.close()
        shutil.rmtree(self.folder)

    def some_job(self, pick):
        """Pick a running job rather than another: most calls are about those."""
        numbers = sorted(self.jobs)
        running = [number for number in numbers if self.jobs[number].status == "running"]
        return (running * 3 + numbers)[pick % (3 * len(running) + len(numbers))]

    @rule(component=COMPONENTS, wrench=WRENCHES)
    def accept(self, component, wrench):
        key = (component, tuple(load + 0.0 for load in wrench))
        job, created = self.ledger.accept(component, "f", wrench)
        known = [number for number, expected in self.jobs.items() if expected.key == key]
        assert created == (not known)
        expected = self.jobs.setdefault(job.id, Expected(key))
        assert expected.key == key
        if expected.status == "cancelled":
            expected.status, expected.lost = "waiting", 0

    @rule()
    def claim(self):
        job = self.ledger.claim("me")
        waiting = [number for number in sorted(self.jobs) if self.jobs[number].status == "waiting"]
        assert (job.id if job else None) == (waiting[0] if waiting else None)
        if job:
            self.jobs[job.id].status = "running"
            self.jobs[job.id].attempt += 1

    @precondition(lambda self: self.jobs)
    @rule(pick=st.integers(0, 20), stale=st.sampled_from([False, False, True]))
    def commit(self, pick, stale):
        number = self.some_job(pick)
        expected = self.jobs[number]
        attempt = expected.attempt - stale
        try:
            row = self.ledger.commit(number, attempt, answer(expected.key[1]))
        except StaleAttemptError:
            assert expected.status != "done"
            assert stale or expected.status != "running"
            return
        if expected.status != "done":
            assert expected.status == "running"
            assert not stale
            self.rows.setdefault((expected.key, "fea"), row.seq)
            expected.status, expected.row = "done", row.seq
            self.committed.append(number)
        assert row.seq == expected.row

    @precondition(lambda self: self.committed)
    @rule(pick=st.integers(0, 20), attempt=st.integers(0, 3))
    def commit_once_more(self, pick, attempt):
        number = self.committed[pick % len(self.committed)]
        row = self.ledger.commit(number, attempt, (9.0,) * 6)
        assert row.seq == self.jobs[number].row
        assert row.displacement == answer(self.jobs[number].key[1])

    @precondition(lambda self: self.jobs)
    @rule(pick=st.integers(0, 20), end=st.sampled_from(["fail", "lose", "release"]))
    def end(self, pick, end):
        number = self.some_job(pick)
        expected = self.jobs[number]
        arguments = (number, expected.attempt, *([ERROR] if end == "fail" else []))
        try:
            getattr(self.ledger, end)(*arguments)
        except StaleAttemptError:
            assert expected.status != "running"
            return
        assert expected.status == "running"
        expected.lost += end == "lose"
        expected.status = "failed" if end == "fail" or expected.lost == 4 else "waiting"

    @precondition(lambda self: self.jobs)
    @rule(pick=st.integers(0, 20), ask=st.sampled_from(["cancel", "retry"]))
    def ask(self, pick, ask):
        number = self.some_job(pick)
        expected = self.jobs[number]
        allowed = {"cancel": ("waiting", "running", "cancelled"), "retry": ("failed", "cancelled")}
        try:
            getattr(self.ledger, ask)(number)
        except InvalidTransitionError:
            assert expected.status not in allowed[ask]
            return
        assert expected.status in allowed[ask]
        expected.status = "cancelled" if ask == "cancel" else "waiting"
        expected.lost = expected.lost if ask == "cancel" else 0

    @rule(component=COMPONENTS, wrenches=st.lists(WRENCHES, max_size=4),
          source=st.sampled_from(["fea", "measured"]))  # fmt: skip
    def insert_rows(self, component, wrenches, source):
        new = [NewRow(wrench, answer(wrench), source) for wrench in wrenches]
        inserted, existing = insert(self.ledger, component, "f", new)
        keys = [((component, tuple(load + 0.0 for load in wrench)), source) for wrench in wrenches]
        fresh = [key for key in dict.fromkeys(keys) if key not in self.rows]
        assert (inserted, existing) == (len(fresh), len(keys) - len(fresh))
        seqs = {
            row.wrench: row.seq for row in stored(self.ledger, component) if row.source == source
        }
        self.rows |= {key: seqs[key[0][1]] for key in fresh}

    @rule()
    def open_again(self):
        self.ledger.close()
        self.ledger = Ledger(self.folder / "ledger.sqlite")

    @invariant()
    def jobs_agree(self):
        seen = {
            job.id: Expected(
                (job.component, job.wrench), job.status, job.attempt, job.lost, job.row
            )
            for job in self.ledger.jobs(limit=1000)
        }
        assert seen == self.jobs

    @invariant()
    def each_row_is_there_once(self):
        rows = stored(self.ledger, "bar") + stored(self.ledger, "plate")
        assert {((row.component, row.wrench), row.source): row.seq for row in rows} == self.rows
        assert len(rows) == len(self.rows)


TestLedgerAgainstReference = LedgerAgainstReference.TestCase
TestLedgerAgainstReference.settings = settings(max_examples=60, stateful_step_count=30)
