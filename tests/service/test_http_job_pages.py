"""Jobs a page at a time, and why one waits."""

import re
from functools import partial

import pytest
from starlette.testclient import TestClient

from wrenchbook.service.http.app import create_app
from wrenchbook.service.workspace import Settings


@pytest.fixture
def idle(folder):
    """A server that runs no solvers."""
    with TestClient(create_app(Settings(folder, solvers=0))) as client:
        yield client


def accept(http, count):
    ledger = http.app.state.workspace.ledger
    wrenches = [(float(n), 0, 0, 0, 0, 0) for n in range(count)]
    return [job.id for job in ledger.accept_many("spring", "f", wrenches)]


def test_pages_follow_each_other_and_hold_each_job_once(idle):
    ids, found, url = accept(idle, 25), [], "/v1/jobs?component=spring&status=waiting&limit=10"
    while url:
        reply = idle.get(url)
        found += [job["id"] for job in reply.json()["jobs"]]
        linked = re.search(r'<(.*)>; rel="next"', reply.headers.get("link", ""))
        url = reply.json()["next"]
        assert (linked.group(1) if linked else None) == url
    assert found == ids[::-1]


def test_jobs_that_come_while_pages_are_read_shift_none(idle):
    accept(idle, 5)
    first = idle.get("/v1/jobs?limit=2").json()
    accept(idle, 9)
    second = idle.get(first["next"]).json()
    assert [job["id"] for job in first["jobs"] + second["jobs"]] == [5, 4, 3, 2]


def test_a_page_of_a_hundred_thousand_jobs_reads_no_more_than_the_page(idle):
    """A list of 10^5 took 2 s."""
    accept(idle, 100_000)
    ledger = idle.app.state.workspace.ledger
    with ledger.reading() as db:
        for where in ("", "component = 'spring' AND", "status = 'waiting' AND"):
            steps: list[int] = []
            db.set_progress_handler(partial(steps.append, 1), 1000)  # each 1000 steps
            query = f"SELECT id FROM jobs WHERE {where} id < 50000 ORDER BY id DESC LIMIT 100"
            assert len(db.execute(query).fetchall()) == 100
            db.set_progress_handler(None, 0)
            assert len(steps) < 10, where
    page = idle.get("/v1/jobs?component=spring&limit=100&after=50000").json()
    assert [job["id"] for job in page["jobs"]] == list(range(49_999, 49_899, -1))


def test_a_waiting_job_says_what_is_ahead_of_it_and_that_nobody_solves_here(idle):
    ids = accept(idle, 5)
    waiting = idle.get(f"/v1/jobs/{ids[3]}").json()["waiting"]
    assert (waiting["ahead"], waiting["slots"], waiting["expected_s"]) == (3, 0, None)
    assert "runs no solvers" in waiting["reason"]


def test_the_expected_time_is_what_is_ahead_shared_by_the_slots(idle):
    from wrenchbook.service.jobs.waiting import why_waiting

    ids = accept(idle, 9)
    ledger = idle.app.state.workspace.ledger
    job = ledger.claim("me")
    ledger.commit(job.id, job.attempt, [0.0] * 6)
    with ledger.writing() as db:
        db.execute("UPDATE jobs SET started = 100, finished = 104 WHERE status = 'done'")
    waiting = why_waiting(ledger, ledger.job(ids[-1]), 2, None)
    assert (waiting.ahead, waiting.solve_s) == (7, 4.0)
    assert waiting.expected_s == pytest.approx(7 * 4.0 / 2)
    assert why_waiting(ledger, ledger.job(ids[-1]), 2, "the disk is full").expected_s is None


def test_a_job_that_has_ended_does_not_wait(idle):
    (number,) = accept(idle, 1)
    idle.delete(f"/v1/jobs/{number}")
    assert idle.get(f"/v1/jobs/{number}").json()["waiting"] is None
