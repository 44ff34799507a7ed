"""`queue` in a simulator's loop: joined, limited, and said when nothing is queued."""

import re
import threading
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import numpy as np
import pytest
from starlette.testclient import TestClient

from tests.service.ledger_rows import claim
from tests.until import until
from wrenchbook.service.http.app import create_app
from wrenchbook.service.http.routes.jobs import job_body
from wrenchbook.service.tables.mapped import MappedTables
from wrenchbook.service.workspace import Settings, Workspace

CALL = "/v1/components/plate_thin/displacement"


@pytest.fixture(autouse=True)
def _endless(stand_in):
    stand_in("endless")


@pytest.fixture
def scale(http):
    spans = http.get("/v1/components/plate_thin").json()["range"]
    return np.array([high for _, high in spans["force"] + spans["moment"]])


def ask(http, wrench, **fields):
    wrench = np.asarray(wrench, dtype=float).tolist()
    return http.post(CALL, json={"force": wrench[:3], "moment": wrench[3:], **fields})


def open_jobs(http):
    return http.get("/v1/jobs", params={"component": "plate_thin"}).json()["jobs"]


def test_the_solve_that_a_linear_parts_first_query_queues_is_new_to_it(http):
    """The reply said that it had been queued before: the design of the part came first."""
    call = CALL.replace("plate_thin", "bar")
    body = {"force": [100.0, 20.0, -15.0], "moment": [1.0, 0.0, -1.0]}
    assert http.post(call, json=body).json()["job"]["new"]
    assert not http.post(call, json=body).json()["job"]["new"]


def test_two_wrenches_a_millionth_of_a_millionth_apart_are_one_job_even_when_it_is_done(
    http, stand_in, scale
):
    stand_in("quick")
    wrench = np.array([10.0, 0.0, -20.0, 0.0, 3.0, 0.0])
    job = ask(http, wrench).json()["job"]
    assert http.get(job["url"], params={"wait_s": 60}).json()["status"] == "done"
    reply = ask(http, wrench + 1e-12 * np.eye(6)[2])
    body = reply.json()
    assert reply.status_code == 200
    assert body["source"] == "fea"
    assert body["translation"] == pytest.approx([1e-5, 0.0, -2e-5], abs=2e-6 * scale[0] * 1e-6)
    assert len(open_jobs(http)) == 1


def test_an_answer_from_a_rounded_wrench_has_a_bar_that_holds_the_error(http, stand_in, scale):
    stand_in("quick")
    wrench = scale * np.array([0.1234567, 0, -0.2345678, 0, 0.3456789, 0])
    job = ask(http, wrench).json()["job"]
    http.get(job["url"], params={"wait_s": 60})
    body = ask(http, wrench, detail=True).json()
    error = np.abs(np.array(body["translation"] + body["rotation"]) - 1e-6 * wrench)
    bars = np.array(
        body["error_parts"]["table"]["translation"] + body["error_parts"]["table"]["rotation"]
    )
    assert body["error"] is None  # that of the mesh is not known
    assert error.max() > 0
    assert (error <= bars).all()
    assert "rounded" in body["reason"]


def test_a_wrench_within_5_percent_of_an_open_job_joins_it_and_one_beyond_does_not(http, scale):
    wrench = 0.3 * scale
    first = ask(http, wrench).json()["job"]["id"]
    assert ask(http, wrench + 0.049 * scale).json()["job"]["id"] == first
    assert ask(http, wrench + 0.051 * scale * np.eye(6)[0]).json()["job"]["id"] != first


def test_a_query_joins_an_open_job_of_a_fill(http):
    job = http.post("/v1/components/plate_thin/fill", json={"budget": 1}).json()["jobs"][0]
    filled = http.get(job["url"]).json()
    near = 1.01 * np.array(filled["force"] + filled["moment"]) + 1e-3
    assert ask(http, near, beyond_range=True).json()["job"]["id"] == job["id"]


def test_beyond_the_limit_a_loop_goes_on_with_job_null_and_the_reason(folder, stand_in):
    with TestClient(create_app(Settings(folder, solvers=0, queue_limit=3))) as http:
        replies = [ask(http, [step, 0, 0, 0, 0, 0]) for step in (300, 100, 200, -100)]
        assert [reply.status_code for reply in replies] == [202] * 4
        jobs = [reply.json()["job"] for reply in replies]
        assert len({job["id"] for job in jobs[:3]}) == 3
        assert jobs[3] is None
        assert "queue-limit" in replies[3].json()["reason"]
        assert len(open_jobs(http)) == 3
        assert ask(http, [101, 0, 0, 0, 0, 0]).json()["job"]["id"] == jobs[1]["id"]


def test_fills_and_solves_do_not_count_against_the_limit_of_queries(folder, stand_in):
    with TestClient(create_app(Settings(folder, solvers=0, queue_limit=1))) as http:
        http.post("/v1/components/plate_thin/fill", json={"budget": 5})
        http.post("/v1/components/plate_thin/solve", json={"force": [1, 2, 3]})
        before = len(open_jobs(http))
        assert before == 6
        assert ask(http, [77, 33, -55, 1, 2, 1]).json()["job"]
        assert ask(http, [-77, 33, 55, 1, 2, 1]).json()["job"] is None
        assert http.post("/v1/components/plate_thin/solve", json={"force": [3, 2, 1]}).json()["job"]
        assert len(open_jobs(http)) == before + 2


def test_wait_gets_its_own_exact_solve_beside_an_open_job_near_by(http, scale):
    wrench = 0.3 * scale + 1e-9
    first = ask(http, wrench).json()["job"]["id"]
    reply = ask(http, wrench, on_thin="wait", wait_s=0.1)
    assert reply.status_code == 202
    job = reply.json()["job"]
    assert job["id"] != first
    reported = http.get(job["url"]).json()
    assert reported["force"] + reported["moment"] == wrench.tolist()


def test_a_batch_of_100000_thin_wrenches_queues_at_most_64(http, scale):
    wrenches = scale * np.random.default_rng(1).uniform(-1, 1, (100_000, 6))
    reply = http.post(
        f"{CALL}s",
        content=wrenches.astype("<f8").tobytes(),
        headers={"content-type": "application/octet-stream"},
    )
    assert reply.status_code == 202
    assert int(reply.headers["wrenchbook-jobs"]) == len(open_jobs(http)) == 64


def test_a_batch_tells_for_each_thin_wrench_its_job_or_null_and_why(folder, stand_in, scale):
    with TestClient(create_app(Settings(folder / "other", solvers=0, queue_limit=2))) as http:
        wrenches = np.zeros((5, 6))
        wrenches[:, 0] = [0.2, 0.5, 0.51, -0.5, 2.0]
        reply = http.post(f"{CALL}s", json={"wrenches": (wrenches * scale).tolist()})
        jobs = reply.json()["jobs"]
        assert reply.status_code == 202
        assert [job["index"] for job in jobs] == [0, 1, 2, 3, 4]
        assert jobs[0]["id"] != jobs[1]["id"] == jobs[2]["id"]
        assert [job["id"] for job in jobs[3:]] == [None, None]
        assert [job["reason"] for job in jobs[3:]] == ["queue-limit", "beyond-range"]
        assert [job["new"] for job in jobs[:3]] == [True, True, True]
        again = http.post(f"{CALL}s", json={"wrenches": (wrenches[:1] * scale).tolist()}).json()
        assert again["jobs"][0]["new"] is False


def test_many_waiting_jobs_are_cancelled_by_one_call_that_says_how_many(folder, stand_in):
    with TestClient(create_app(Settings(folder, solvers=0))) as http:
        http.post("/v1/components/plate_thin/fill", json={"budget": 5})
        http.post("/v1/components/plate/fill", json={"budget": 2})
        reply = http.delete("/v1/jobs", params={"component": "plate_thin", "status": "waiting"})
        assert reply.status_code == 200
        assert reply.json() == {"cancelled": 5}
        assert {job["status"] for job in open_jobs(http)} == {"cancelled"}
        left = http.get("/v1/jobs", params={"status": "waiting"}).json()["jobs"]
        assert [job["component"] for job in left] == ["plate", "plate"]


def test_many_who_look_at_a_table_that_is_being_built_do_not_hold_up_the_loop(
    http, scale, monkeypatch
):
    built = threading.Event()
    monkeypatch.setattr(MappedTables, "progress", lambda *_: lambda: built.is_set() or None)
    waiting, caught_up = [], Workspace.caught_up
    monkeypatch.setattr(
        Workspace, "caught_up", lambda *asked: waiting.append(asked) or caught_up(*asked)
    )
    with ThreadPoolExecutor(45) as pool:
        for call in ("/coverage", "/compliance"):
            looks = [pool.submit(http.get, f"/v1/components/plate_thin{call}") for _ in range(45)]
            until(lambda: len(waiting) == 45)  # the server has 40 threads for queries
            assert ask(http, 0.1 * scale).status_code == 202
            assert http.get("/v1/components/plate_thin").status_code == 200
            assert not any(look.done() for look in looks)  # answered while they wait
            built.set()
            assert {look.result().status_code for look in looks} == {200}
            built.clear()
            waiting.clear()


def test_a_wrench_solved_a_moment_ago_is_answered_and_not_solved_again(http, stand_in, monkeypatch):
    """Until the table held the row, the same query was `outside` and queued a second solve."""
    stand_in("quick")
    tables = http.app.state.workspace.tables
    monkeypatch.setattr(tables, "_map", lambda *_: False)  # no row comes into use
    wrench = [10.123456789, 0.0, -20.0, 0.0, 3.0, 0.0]
    solved = ask(http, wrench, on_thin="wait", wait_s=60).json()
    again = ask(http, wrench)
    assert (solved["source"], solved["coverage"]) == ("fea", "covered")
    assert again.status_code == 200
    for name in ("translation", "rotation", "error", "coverage", "row", "table_version"):
        assert again.json()[name] == solved[name]
    batch = http.post(f"{CALL}s", json={"wrenches": [wrench], "on_thin": "queue"}).json()
    assert batch["displacements"][0] == solved["translation"] + solved["rotation"]
    assert batch["coverage"] == ["covered"]
    assert len(http.get("/v1/jobs", params={"component": "plate_thin"}).json()["jobs"]) == 1
    assert solved["table_version"] >= solved["row"]


# -- beyond the load range -----------------------------------------------------------------------


NAME = "/v1/components/plate_thin"


@pytest.fixture
def high(http):
    return http.get(NAME).json()["range"]["force"][2][1]


def jobs(http):
    return http.get("/v1/jobs").json()["jobs"]


def test_queue_beyond_the_range_answers_202_with_job_null_and_the_reason(http, high):
    reply = http.post(f"{NAME}/displacement", json={"force": [0, 0, 25 * high]})
    body = reply.json()
    assert reply.status_code == 202
    assert "location" not in reply.headers
    assert body["job"] is None
    assert "load range" in body["reason"]
    assert "fz" in body["reason"]
    assert "no solve is queued for it: to solve it nevertheless, set beyond_range" in body["reason"]
    assert jobs(http) == []


@pytest.mark.parametrize(
    ("call", "fields"),
    [("displacement", {}), ("displacement", {"on_thin": "wait", "wait_s": 0}), ("solve", {})],
)
def test_beyond_range_true_has_it_solved(http, high, call, fields):
    body = {"force": [0, 0, 2 * high], "beyond_range": True, **fields}
    reply = http.post(f"{NAME}/{call}", json=body)
    assert reply.status_code == 202
    assert len(jobs(http)) == 1


def test_a_load_a_rounding_error_beyond_the_range_counts_as_on_it(http, high):
    assert http.post(f"{NAME}/solve", json={"force": [0, 0, high * (1 + 5e-10)]}).json()["job"]
    assert http.post(f"{NAME}/solve", json={"force": [0, 0, high * (1 + 5e-9)]}).status_code == 409


def test_a_batch_that_waits_beyond_the_range_is_409_and_queues_nothing(http, high):
    wrenches = np.zeros((3, 6))
    wrenches[:, 2] = [0.1 * high, 3 * high, 0.5 * high]
    body = {"wrenches": wrenches.tolist(), "on_thin": "wait", "wait_s": 0}
    reply = http.post(f"{NAME}/displacements", json=body)
    assert reply.status_code == 409
    assert reply.json()["beyond"] == [1]
    assert jobs(http) == []
    reply = http.post(f"{NAME}/displacements", json={**body, "beyond_range": True})
    assert reply.status_code == 202
    assert len(jobs(http)) == 3


def test_a_binary_batch_takes_beyond_range_as_a_query_parameter(http, high):
    content = np.array([[0, 0, 3 * high, 0, 0, 0]], dtype="<f8").tobytes()
    headers = {"content-type": "application/octet-stream"}
    call = f"{NAME}/displacements"
    assert http.post(call, content=content, headers=headers).headers["wrenchbook-jobs"] == "0"
    reply = http.post(call, content=content, headers=headers, params={"beyond_range": True})
    assert reply.headers["wrenchbook-jobs"] == "1"


# -- fills within a range ------------------------------------------------------------------------


FILL = "/v1/components/plate_thin/fill"
NONE = [[0.0, 0.0]] * 3


def test_the_solves_of_a_fill_lie_within_its_range(http):
    force = [[-10.0, 10.0], [0.0, 0.0], [-50.0, -20.0]]
    reply = http.post(FILL, json={"budget": 5, "range": {"force": force, "moment": NONE}})
    assert reply.status_code == 202
    jobs = [http.get(item["url"]).json() for item in reply.json()["jobs"]]
    wrenches = np.array([job["force"] + job["moment"] for job in jobs])
    assert len(wrenches) == 5
    low, high = np.array(force + NONE).T
    assert (wrenches >= low).all()
    assert (wrenches <= high).all()
    assert len(np.unique(wrenches, axis=0)) == 5


def test_a_fill_that_queues_less_than_its_budget_says_why(http):
    reply = http.post(FILL, json={"budget": 30}).json()
    assert len(reply["jobs"]) == 9
    assert reply["reason"].startswith("9 of at most 30 solves: the first design needs 9")


@pytest.mark.parametrize("asked", [{"outputs": ["uz", "rx"]}, {"for_joint": True}])
def test_a_fill_of_some_outputs_or_for_a_joint_is_taken(http, asked):
    reply = http.post(FILL, json={"budget": 2, **asked})
    assert (reply.status_code, len(reply.json()["jobs"]), reply.json()["stage"]) == (
        202,
        2,
        "first",
    )


# -- jobs a page at a time, and why one waits ----------------------------------------------------


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
    ids, result, url = accept(idle, 25), [], "/v1/jobs?component=spring&status=waiting&limit=10"
    while url:
        reply = idle.get(url)
        result += [job["id"] for job in reply.json()["jobs"]]
        linked = re.search(r'<(.*)>; rel="next"', reply.headers.get("link", ""))
        url = reply.json()["next"]
        assert (linked.group(1) if linked else None) == url
    assert result == ids[::-1]


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
    job = claim(ledger, "me")
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


def test_a_job_of_lost_interfaces_has_its_displacement_as_one_list(tmp_path):
    """Its rotation had nine numbers: those of both interfaces but three."""
    workspace = Workspace(Settings(tmp_path, solvers=0))
    workspace.ledger.accept("gone", "f", [1.0] * 12)
    job = claim(workspace.ledger, "solver")
    workspace.ledger.commit(job.id, job.attempt, [1e-6] * 12)
    body = job_body(workspace, workspace.ledger.job(job.id))
    workspace.close()
    assert len(body["displacement"]) == len(body["wrench"]) == 12
    assert "rotation" not in body
