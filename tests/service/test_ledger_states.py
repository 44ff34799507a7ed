"""The table of transitions against every event in every status, on a ledger."""

import pytest

from tests.service.ledger_rows import stored
from wrenchbook.service.ledger import STATUSES, InvalidTransitionError
from wrenchbook.service.ledger.jobs import BACKOFF_SECONDS, TRANSITIONS

WRENCH = (1.0, 0, 0, 0, 0, 0)
ERROR = {"kind": "k", "message": "m", "remedy": "r"}

# What brings a job about that is at its first attempt, or in line for it.
BEFORE = {
    "waiting": lambda ledger: None,
    "running": lambda ledger: ledger.claim("me"),
    "done": lambda ledger: ledger.claim("me") and ledger.commit(1, 1, (0.0,) * 6),
    "failed": lambda ledger: ledger.claim("me") and ledger.fail(1, 1, ERROR),
    "cancelled": lambda ledger: ledger.cancel(1),
}
EVENTS = {
    "claim": lambda ledger: ledger.claim("me"),
    "begin": lambda ledger: ledger.beat("me", "local", {(1, 1): 5.0}),
    "adopt": lambda ledger: ledger.adopt(1, 1, "me", "you"),
    "commit": lambda ledger: ledger.commit(1, 1, (1e-6,) * 6),
    "fail": lambda ledger: ledger.fail(1, 1, ERROR),
    "lose": lambda ledger: ledger.lose(1, 1),
    "release": lambda ledger: ledger.release(1, 1),
    "cancel": lambda ledger: ledger.cancel(1),
    "retry": lambda ledger: ledger.retry(1),
    "reopen": lambda ledger: ledger.accept("bar", "f", WRENCH),
}


@pytest.fixture(autouse=True)
def _job(ledger):
    ledger.accept("bar", "f", WRENCH)


@pytest.mark.parametrize("status", STATUSES)
@pytest.mark.parametrize("event", EVENTS)
def test_an_event_leads_where_the_table_says_or_changes_nothing(ledger, status, event):
    BEFORE[status](ledger)
    if status == "done" and event == "reopen":
        ledger.withdraw("bar", 1)
    before, expected = ledger.job(1), TRANSITIONS.get((status, event))
    assert before.status == status
    if expected is not None or event in ("claim", "begin", "adopt", "reopen"):
        EVENTS[event](ledger)
    elif (status, event) == ("done", "commit"):  # once more: the row that it has
        assert EVENTS[event](ledger).seq == before.row
    else:
        with pytest.raises(InvalidTransitionError, match=f"is {status}"):
            EVENTS[event](ledger)
    job = ledger.job(1)
    assert job.status == (expected or status)
    assert (job.owner is not None) == (job.status == "running")
    if expected is None:
        assert job == before


def test_a_job_whose_solver_dies_once_more_than_it_may_has_failed(ledger, monkeypatch):
    monkeypatch.setattr("wrenchbook.service.ledger.jobs.BACKOFF_SECONDS", (0.0,) * 3)
    for attempt in range(1, len(BACKOFF_SECONDS) + 2):
        ledger.claim("me")
        ended = ledger.lose(1, attempt)
    assert ended.status == TRANSITIONS["running", "give up"] == "failed"


def test_nothing_leads_out_of_done_but_asking_again_once_its_row_is_withdrawn(ledger):
    assert [event for status, event in TRANSITIONS if status == "done"] == ["reopen"]
    BEFORE["done"](ledger)
    done = ledger.job(1)
    assert ledger.accept("bar", "f", WRENCH, priority=1) == (done, False)
    ledger.withdraw("bar", stored(ledger, "bar")[0].seq)
    again, _ = ledger.accept("bar", "f", WRENCH, priority=1)
    assert (again.status, again.row, again.priority) == ("waiting", None, 1)


def test_the_table_names_no_event_that_nothing_brings_about():
    assert {event for _, event in TRANSITIONS} == {*EVENTS, "give up"}
