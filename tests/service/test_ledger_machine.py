"""The ledger against a dict of jobs and a list of rows, under any order of calls."""

import shutil
import tempfile
from dataclasses import dataclass
from math import nextafter
from pathlib import Path

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from tests.service.ledger_rows import NewRow, insert, stored
from wrenchbook.service.ledger import (
    InvalidTransitionError,
    Ledger,
    RowStatusError,
    StaleAttemptError,
    jobs,
)
from wrenchbook.service.ledger.records import STATUSES

LOADS = st.sampled_from([nextafter(1.0, 2.0), -0.0, 0.0, 1.0])
WRENCHES = st.tuples(LOADS, LOADS, *[st.just(0.0)] * 4)
COMPONENTS = st.sampled_from(["bar", "plate"])
FINGERPRINTS = st.sampled_from(["f", "f", "g"])
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
    priority: int = 0
    owner: str | None = None
    began: float | None = None


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
        self.withdrawn: set[int] = set()
        self.followed, self.after = set(), 0
        self.committed = []
        self.tasks = set()

    def teardown(self):
        jobs.BACKOFF_SECONDS = BACKOFF
        self.ledger.close()
        shutil.rmtree(self.folder)

    def some_job(self, pick):
        """Pick a running job rather than another: most calls are about those."""
        numbers = sorted(self.jobs)
        running = [number for number in numbers if self.jobs[number].status == "running"]
        return (running * 3 + numbers)[pick % (3 * len(running) + len(numbers))]

    @rule(component=COMPONENTS, fingerprint=FINGERPRINTS, wrench=WRENCHES,
          priority=st.sampled_from([0, 0, 1]), reopen=st.booleans())  # fmt: skip
    def accept(self, component, fingerprint, wrench, priority, reopen):
        key = (component, fingerprint, tuple(load + 0.0 for load in wrench))
        job, created = self.ledger.accept(
            component, fingerprint, wrench, priority=priority, reopen_cancelled=reopen
        )
        known = [number for number, expected in self.jobs.items() if expected.key == key]
        assert created == (not known)
        expected = self.jobs.setdefault(job.id, Expected(key, priority=priority))
        assert expected.key == key
        if (expected.status == "cancelled" and reopen) or expected.row in self.withdrawn:
            expected.status, expected.lost, expected.row = "waiting", 0, None
            expected.began = None
        if expected.status == "waiting":
            expected.priority = max(expected.priority, priority)

    @precondition(lambda self: self.jobs)
    @rule(pick=st.integers(0, 20), priority=st.sampled_from([0, 1]), reopen=st.booleans())
    def accept_again(self, pick, priority, reopen):
        component, fingerprint, wrench = self.jobs[self.some_job(pick)].key
        self.accept(component, fingerprint, wrench, priority, reopen)

    @rule(component=COMPONENTS, wrenches=st.lists(WRENCHES, max_size=4))
    def accept_many(self, component, wrenches):
        placed = self.ledger.accept_many(component, "f", wrenches)
        assert [job.wrench for job in placed] == [
            tuple(load + 0.0 for load in wrench) for wrench in wrenches
        ]
        for job in placed:
            expected = self.jobs.setdefault(job.id, Expected((component, "f", job.wrench)))
            assert expected.key == (component, "f", job.wrench)
            if expected.status == "cancelled" or expected.row in self.withdrawn:
                expected.status, expected.lost, expected.row = "waiting", 0, None
                expected.began = None

    @rule(count=st.integers(1, 3), owner=st.sampled_from(["me", "you"]))
    def claim(self, count, owner):
        claimed = self.ledger.claim_many(owner, "local", count)
        waiting = sorted(
            (-expected.priority, number)
            for number, expected in self.jobs.items()
            if expected.status == "waiting"
        )
        assert [job.id for job in claimed] == [number for _, number in waiting[:count]]
        for job in claimed:
            expected = self.jobs[job.id]
            expected.status, expected.owner, expected.began = "running", owner, None
            expected.attempt += 1
            assert job.task not in self.tasks
            self.tasks.add(job.task)

    @precondition(lambda self: self.jobs)
    @rule(pick=st.integers(0, 20), owner=st.sampled_from(["me", "you"]), start=st.floats(1, 9))
    def begin(self, pick, owner, start):
        number = self.some_job(pick)
        expected = self.jobs[number]
        begun = self.ledger.send_heartbeat(owner, "local", {(number, expected.attempt): start})
        own = (expected.status, expected.owner) == ("running", owner)
        assert [job.id for job in begun] == [number] * own
        if own and expected.began is None:
            expected.began = start

    @precondition(lambda self: self.jobs)
    @rule(pick=st.integers(0, 20), stale=st.sampled_from([False, False, True]))
    def adopt(self, pick, stale):
        number = self.some_job(pick)
        expected = self.jobs[number]
        adopted = self.ledger.adopt(number, expected.attempt - stale, "me", "you")
        assert (adopted is not None) == (expected.owner == "me" and not stale)
        if adopted:
            expected.owner = "you"

    @precondition(lambda self: self.jobs)
    @rule(pick=st.integers(0, 20), stale=st.sampled_from([False, False, True]))
    def commit(self, pick, stale):
        number = self.some_job(pick)
        expected = self.jobs[number]
        attempt = expected.attempt - stale
        try:
            row = self.ledger.commit(number, attempt, answer(expected.key[2]))
        except StaleAttemptError:
            assert expected.status != "done"
            assert stale or expected.status != "running"
            return
        if expected.status != "done":
            assert expected.status == "running"
            assert not stale
            key = (expected.key, "fea")
            if self.rows.setdefault(key, row.seq) in self.withdrawn:  # solved anew: it is back
                self.withdrawn.discard(self.rows[key])
            self.ended(expected, "done")
            expected.row = self.rows[key]
            self.committed.append(number)
        assert row.seq == expected.row

    def ended(self, expected, status):
        expected.status, expected.owner = status, None
        if status == "waiting":
            expected.began = None

    @precondition(lambda self: self.committed)
    @rule(pick=st.integers(0, 20), attempt=st.integers(0, 3))
    def commit_once_more(self, pick, attempt):
        number = self.committed[pick % len(self.committed)]
        if self.jobs[number].status == "done":
            row = self.ledger.commit(number, attempt, (9.0,) * 6)
            assert row.seq == self.jobs[number].row
            assert row.displacement == answer(self.jobs[number].key[2])

    @precondition(lambda self: self.jobs)
    @rule(pick=st.integers(0, 20), end=st.sampled_from(["fail", "lose", "release"]),
          stale=st.sampled_from([False, False, True]))  # fmt: skip
    def end(self, pick, end, stale):
        number = self.some_job(pick)
        expected = self.jobs[number]
        arguments = (number, expected.attempt - stale, *([ERROR] if end == "fail" else []))
        try:
            getattr(self.ledger, end)(*arguments)
        except StaleAttemptError:
            assert stale or expected.status != "running"
            return
        assert expected.status == "running"
        assert not stale
        expected.lost += end == "lose"
        failed = end == "fail" or expected.lost == 4
        self.ended(expected, "failed" if failed else "waiting")

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
        self.ended(expected, "cancelled" if ask == "cancel" else "waiting")
        expected.lost = expected.lost if ask == "cancel" else 0

    @rule(component=COMPONENTS, wrenches=st.lists(WRENCHES, max_size=4),
          source=st.sampled_from(["fea", "measured"]))  # fmt: skip
    def insert_rows(self, component, wrenches, source):
        new = [NewRow(wrench, answer(wrench), source) for wrench in wrenches]
        inserted, existing = insert(self.ledger, component, "f", new)
        keys = [
            ((component, "f", tuple(load + 0.0 for load in wrench)), source) for wrench in wrenches
        ]
        fresh = [key for key in dict.fromkeys(keys) if key not in self.rows]
        assert (inserted, existing) == (len(fresh), len(keys) - len(fresh))
        seqs = {
            (row.fingerprint, row.wrench): row.seq
            for row in stored(self.ledger, component)
            if row.source == source
        }
        self.rows |= {key: seqs[key[0][1:]] for key in fresh}

    @precondition(lambda self: self.rows)
    @rule(pick=st.integers(0, 20), back=st.booleans())
    def withdraw_or_restore(self, pick, back):
        (component, *_), seq = [(key[0], seq) for key, seq in sorted(self.rows.items())][
            pick % len(self.rows)
        ]
        try:
            self.ledger.withdraw(component, seq, withdrawn=not back)
        except RowStatusError:
            assert (seq in self.withdrawn) != back
            return
        assert (seq in self.withdrawn) == back
        assert self.ledger.row(seq).component == component  # in the table or withdrawn
        (self.withdrawn.discard if back else self.withdrawn.add)(seq)

    @rule(most=st.integers(1, 3))
    def follow(self, most):
        """Read what changed in one component since the last time, in parts of any size."""
        while True:
            changes = self.ledger.row_changes("bar", self.after, most=most)
            self.followed -= changes.edited
            assert self.followed.isdisjoint(changes.rows.seq.tolist())
            self.followed |= set(changes.rows.seq.tolist())
            self.after = changes.last_seq
            if changes.complete:
                break
        assert self.followed == {row.seq for row in stored(self.ledger, "bar")}
        assert self.after == self.ledger.last_seq("bar")

    @rule()
    def open_again(self):
        self.ledger.close()
        self.ledger = Ledger(self.folder / "ledger.sqlite")

    @invariant()
    def jobs_agree(self):
        listed = self.ledger.jobs(limit=1000)
        seen = {
            job.id: Expected(
                *((job.component, job.fingerprint, job.wrench), job.status, job.attempt, job.lost),
                *(job.row, job.priority, job.owner, job.began),
            )
            for job in listed
        }
        assert seen == self.jobs
        assert [job.id for job in listed] == sorted(self.jobs, reverse=True)
        statuses = [job.status for job in listed if job.component == "bar"]
        assert self.ledger.counts("bar") == {name: statuses.count(name) for name in STATUSES}
        assert [job.id for job in self.ledger.jobs("bar", "waiting", limit=2)] == [
            job.id for job in listed if (job.component, job.status) == ("bar", "waiting")
        ][:2]
        assert [job.id for job in self.ledger.open_jobs("bar", "f")] == [
            number
            for number, job in sorted(self.jobs.items())
            if job.key[:2] == ("bar", "f") and job.status in ("waiting", "running")
        ]
        assert self.ledger.attempts_of("me") == {
            (job.id, job.attempt) for job in listed if job.owner == "me"
        }

    @invariant()
    def each_row_is_there_once(self):
        rows = stored(self.ledger, "bar") + stored(self.ledger, "plate")
        seen = {((row.component, row.fingerprint, row.wrench), row.source): row.seq for row in rows}
        assert seen == {key: seq for key, seq in self.rows.items() if seq not in self.withdrawn}
        assert len(rows) == len(seen)


TestLedgerAgainstReference = LedgerAgainstReference.TestCase
TestLedgerAgainstReference.settings = settings(max_examples=60, stateful_step_count=40)
