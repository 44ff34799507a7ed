"""Who looks after a running attempt: engine, task key, owner, heartbeat."""

from wrenchbook.service.ledger import Ledger

WRENCH = (1.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def accepted(ledger, count):
    wrenches = [(float(load), 0, 0, 0, 0, 0) for load in range(1, count + 1)]
    return ledger.accept_many("bar", "f1", wrenches)


def test_a_claim_says_which_engine_has_the_attempt_and_under_which_task(ledger):
    accepted(ledger, 1)
    job = ledger.claim("me", "dask")
    assert (job.owner, job.engine) == ("me", "dask")
    assert job.task.startswith(f"{job.id}-1-")
    assert ledger.job(job.id) == job


def test_every_attempt_has_a_task_key_of_its_own(ledger):
    job = accepted(ledger, 1)[0]
    keys = set()
    for attempt in range(1, 6):
        keys.add(ledger.claim("me").task)
        ledger.release(job.id, attempt)
    assert len(keys) == 5


def test_two_data_directories_never_give_the_same_task_key(tmp_path):
    keys = []
    for name in ("one", "two"):
        ledger = Ledger(tmp_path / name)
        accepted(ledger, 1)
        keys.append(ledger.claim("me").task)
        ledger.close()
    assert keys[0] != keys[1]


def test_an_attempt_is_submitted_until_its_owner_says_it_began(ledger):
    accepted(ledger, 2)
    first, second = ledger.claim_many("me", "local", 2)
    assert (first.status, first.began) == ("running", None)
    assert [job.id for job in ledger.beat("me", "local", {(first.id, 1): 12.5})] == [first.id]
    assert ledger.job(first.id).began == 12.5
    assert ledger.job(second.id).began is None


def test_an_attempt_keeps_the_beginning_that_was_told_first(ledger):
    accepted(ledger, 1)
    job = ledger.claim("me")
    for start in (12.5, 99.0):
        ledger.beat("me", "local", {(job.id, 1): start})
    assert ledger.job(job.id).began == 12.5


def test_a_beginning_that_comes_late_changes_nothing(ledger):
    accepted(ledger, 2)
    over, adopted = ledger.claim_many("me", "local", 2)
    ledger.release(over.id, 1)
    ledger.adopt(adopted.id, 1, "me", "you")
    assert ledger.beat("me", "local", {(over.id, 1): 1.0, (adopted.id, 1): 1.0}) == []
    assert ledger.job(over.id).began is None
    assert ledger.job(adopted.id).began is None


def test_a_new_attempt_has_not_begun_though_the_one_before_had(ledger):
    job = accepted(ledger, 1)[0]
    ledger.claim("me")
    ledger.beat("me", "local", {(job.id, 1): 1.0})
    assert ledger.lose(job.id, 1).began is None
    assert ledger.job(job.id).began is None


def test_an_attempt_that_is_given_back_with_a_delay_is_not_claimed_at_once(ledger):
    job = accepted(ledger, 1)[0]
    ledger.claim("me")
    ledger.release(job.id, 1, delay=3600.0)
    assert ledger.claim("me") is None


def test_a_running_job_is_an_open_one(ledger):
    first, second = accepted(ledger, 2)
    ledger.claim("me")
    assert [job.id for job in ledger.open_jobs("bar", "f1")] == [first.id, second.id]


def test_claims_and_beats_make_the_heartbeat_grow(ledger):
    accepted(ledger, 1)
    assert ledger.leases() == {}
    ledger.claim("me", "dask")
    ledger.beat("me", "dask")
    lease = ledger.leases()["me"]
    assert (lease.engine, lease.beat) == ("dask", 2)
    ledger.end_lease("me")
    assert ledger.leases() == {}


def test_old_leases_are_deleted_but_those_of_owners_that_still_have_jobs(ledger, monkeypatch):
    monkeypatch.setattr("wrenchbook.service.ledger.jobs.FORGOTTEN_SECONDS", -1.0)
    accepted(ledger, 1)
    ledger.claim("at work")
    ledger.beat("killed while idle", "local")
    ledger.end_lease("me")
    assert set(ledger.leases()) == {"at work"}


def test_as_many_jobs_as_asked_for_are_claimed_the_most_urgent_first(ledger):
    accepted(ledger, 3)
    urgent = ledger.accept("bar", "f1", (9.0, 0, 0, 0, 0, 0), priority=1)[0]
    assert [job.id for job in ledger.claim_many("me", "local", 3)] == [urgent.id, 1, 2]
    assert [job.id for job in ledger.claim_many("me", "local", 3)] == [3]
    assert ledger.claim_many("me", "local", 3) == []
    assert ledger.attempts_of("me") == {(1, 1), (2, 1), (3, 1), (urgent.id, 1)}
    assert ledger.attempts_of("you") == set()


def test_the_cause_of_the_last_death_is_in_the_failure(ledger, monkeypatch):
    monkeypatch.setattr("wrenchbook.service.ledger.jobs.BACKOFF_SECONDS", (0.0, 0.0, 0.0))
    job = accepted(ledger, 1)[0]
    for attempt in range(1, 5):
        ledger.claim("me")
        ended = ledger.lose(job.id, attempt, f"killed by SIGSEGV, attempt {attempt}")
    assert ended.status == "failed"
    assert ended.error["message"].endswith("the last time: killed by SIGSEGV, attempt 4")
