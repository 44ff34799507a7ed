"""The table of states against every event in every status."""

from dataclasses import replace

import pytest

from wrenchbook.service.ledger import STATUSES, InvalidTransitionError, JobRecord, states

EVENTS = {
    "claim": lambda job: states.claimed(job, "me", "local", 5.0),
    "begin": lambda job: states.begun(job, 5.0),
    "adopt": lambda job: states.adopted(job, "you"),
    "commit": lambda job: states.committed(job, 7, 5.0),
    "fail": lambda job: states.failed(job, {"kind": "k", "message": "m", "remedy": "r"}, 5.0),
    "lose": lambda job: states.lost(job, 5.0),
    "release": states.released,
    "cancel": lambda job: states.cancelled(job, 5.0),
    "retry": states.retried,
    "reopen": states.reopened,
}


def job_of(status):
    return JobRecord(
        id=1, component="bar", fingerprint="f", wrench=(0.0,) * 6, status=status, priority=0,
        attempt=1, lost=0, owner="me" if status == "running" else None, created=1.0,
        started=2.0, finished=None, error=None, row=None,
    )  # fmt: skip


@pytest.mark.parametrize("status", STATUSES)
@pytest.mark.parametrize("event", EVENTS)
def test_an_event_leads_where_the_table_says_or_is_refused(status, event):
    expected = states.TRANSITIONS.get((status, event))
    if expected is None:
        with pytest.raises(InvalidTransitionError, match=f"is {status}"):
            EVENTS[event](job_of(status))
    else:
        assert EVENTS[event](job_of(status)).status == expected


def test_only_a_running_job_has_an_owner():
    for (status, event), after in states.TRANSITIONS.items():
        if event in EVENTS:
            job = EVENTS[event](job_of(status))
            assert (job.owner is not None) == (after == "running")


def test_nothing_leads_out_of_done_but_asking_again_once_its_row_is_withdrawn():
    assert [event for status, event in states.TRANSITIONS if status == "done"] == ["reopen"]
    done = replace(job_of("done"), row=7)
    assert states.accepted_again(done, 1, True, lacks_row=False) == done
    again = states.accepted_again(done, 1, True, lacks_row=True)
    assert (again.status, again.row, again.priority) == ("waiting", None, 1)


def test_the_table_names_no_event_that_nothing_brings_about():
    assert {event for _, event in states.TRANSITIONS} == {*EVENTS, "give up"}
