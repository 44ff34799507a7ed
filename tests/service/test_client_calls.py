"""The client against a stub that answers in the shapes of the HTTP contract."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from tests.service.live import served
from tests.service.stub_server import Answer, Stub
from wrenchbook.service.client import Client, Job, ProblemError, ServerTimeout
from wrenchbook.service.client.errors import InvalidArgument

COVERED = {
    "component": "plate",
    "translation": [1e-6, -2e-6, 3e-4],
    "rotation": [1e-4, 0.0, -2e-5],
    "error": {"translation": [1e-8, 2e-8, 3e-6], "rotation": [1e-6, 0.0, 1e-7]},
    "coverage": "covered",
    "source": "table",
    "method": "griddata",
    "table_version": 17,
    "elapsed_us": 38.1,
}
QUEUED = {
    "component": "plate",
    "translation": None,
    "rotation": None,
    "error": None,
    "coverage": "outside",
    "source": None,
    "method": "griddata",
    "table_version": 0,
    "elapsed_us": 12.0,
    "reason": "axis z: no rows yet",
    "job": {"id": 7, "status": "waiting", "url": "/v1/jobs/7"},
}


WRENCH = {"force": [1.0, 2.0, 3.0], "moment": [0.0, 0.0, 0.0]}
BATCH = {"displacements": [[0] * 6], "errors": [[0] * 6], "coverage": ["covered"], "jobs": []}
JOB = {"id": 3, "status": "failed", "url": "/v1/jobs/3", "component": "bar", "jobs": []}
CHOSEN = {"on_thin": "wait", "wait_s": 0.5, "method": "linear", "detail": True}
SENT = {  # the call, its answer, and what is sent: method, path and body
    # Only the three plain fields: that is the body the server reads fastest.
    "displacement": (
        lambda on: on.displacement("plate", [1, 2, 3]), COVERED,
        "POST", "/v1/components/plate/displacement", WRENCH | {"on_thin": "queue"}),
    "its options": (
        lambda on: on.displacement("my plate", [1, 2, 3], tolerance=(1e-6, 1e-5), **CHOSEN),
        COVERED,
        "POST", "/v1/components/my%20plate/displacement",
        WRENCH | CHOSEN | {"tolerance": {"translation": 1e-6, "rotation": 1e-5}}),
    "beyond the range": (
        lambda on: on.displacement("plate", [1, 2, 3], beyond_range=True), COVERED,
        "POST", "/v1/components/plate/displacement",
        WRENCH | {"on_thin": "queue", "beyond_range": True}),
    "batch": (
        lambda on: on.displacements("plate", [[1.0] * 6], beyond_range=True), BATCH,
        "POST", "/v1/components/plate/displacements",
        {"wrenches": [[1.0] * 6], "on_thin": "queue", "beyond_range": True}),
    "binary batch": (
        lambda on: on.displacements("plate", [[1.0] * 6], beyond_range=True, binary=True),
        np.zeros(13).tobytes(),
        "POST",
        "/v1/components/plate/displacements?on_thin=queue&beyond_range=true&inputs=6", None),
    "solve": (
        lambda on: on.solve("plate", [1, 2, 3]), COVERED,
        "POST", "/v1/components/plate/solve", WRENCH),
    "solve beyond the range": (
        lambda on: on.solve("plate", [1, 2, 3], beyond_range=True), COVERED,
        "POST", "/v1/components/plate/solve", WRENCH | {"beyond_range": True}),
    "jobs": (
        lambda on: on.jobs(component="bar", status="failed"), JOB,
        "GET", "/v1/jobs?component=bar&status=failed", None),
    "cancel": (lambda on: on.cancel(3), JOB, "DELETE", "/v1/jobs/3", None),
    "retry": (lambda on: on.retry(Job.read(JOB)), JOB, "POST", "/v1/jobs/3/retry", None),
    "cancel all that wait": (
        lambda on: on.cancel_jobs("bar"), {"cancelled": 3},
        "DELETE", "/v1/jobs?component=bar&status=waiting", None),
    "cancel those that run": (
        lambda on: on.cancel_jobs(status="running"), {"cancelled": 3},
        "DELETE", "/v1/jobs?status=running", None),
}  # fmt: skip


@pytest.mark.parametrize(("call", "answer", "method", "path", "body"), SENT.values(), ids=SENT)
def test_a_call_goes_as_the_contract_says(
    stub: Stub, client: Client, call, answer, method, path, body
):
    kind = "application/octet-stream" if isinstance(answer, bytes) else "application/json"
    stub.answers(Answer(answer, kind=kind))
    call(client)
    (seen,) = stub.seen
    assert (seen.method, seen.path) == (method, path)
    assert body is None or seen.body == body


def test_a_batch_has_jobs_by_wrench_and_says_why_others_have_none(stub: Stub, client: Client):
    jobs = [
        {"index": 1, "id": 9, "status": "waiting", "url": "/v1/jobs/9"},
        {"index": 2, "id": None, "reason": "beyond-range"},
    ]
    coverage = ["covered", "thin", "outside"]
    body = {"displacements": [[1.0] * 6, [None] * 6, None], "errors": [[0.1] * 6, None, None]}
    stub.answers(Answer({**body, "coverage": coverage, "jobs": jobs}, status=202))
    results = client.displacements("plate", np.ones((3, 6)))
    assert (len(results), results.covered.tolist()) == (3, [True, False, False])
    assert np.isnan(results.displacements[1:]).all()
    assert (results.jobs[1].id, results.jobs[1].component) == (9, "plate")
    assert results.no_job == {2: "beyond-range"}
    stub.answers(Answer({"displacements": [], "errors": [], "coverage": [], "jobs": []}))
    assert client.displacements("plate", []).displacements.shape == (0, 6)


def test_a_queued_answer_has_its_job_and_no_pose(stub: Stub, client: Client):
    stub.answers(Answer(QUEUED, status=202))
    answer = client.displacement("plate", np.array([0.0, 0, -800, 0, 40, 0]))
    assert answer.vector is None
    assert answer.error_vector is None
    assert answer.job is not None
    assert (answer.job.id, answer.job.status, answer.job.ended) == (7, "waiting", False)
    assert answer.job.component == "plate"  # which the short form lacks
    assert "component" not in answer.job.raw
    assert answer.reason == "axis z: no rows yet"
    with pytest.raises(ValueError, match=r"no rows yet.*client\.wait\(7\)"):
        answer.apply(np.eye(3), np.zeros(3))
    full = {**QUEUED, "job": None, "reason": "64 jobs of queries are open: the queue is full"}
    stub.answers(Answer(full, status=202))
    answer = client.displacement("plate", [0, 0, -800])
    assert (answer.job, answer.covered, answer.reason) == (None, False, full["reason"])
    with pytest.raises(ValueError, match=r"unknown .*the queue is full"):
        answer.apply(np.eye(3), np.zeros(3))


@pytest.mark.parametrize(
    ("ask", "held"),
    [
        (lambda client: client.displacement("plate", [1, 0, 0], on_thin="queue", wait_s=9), 0.2),
        (lambda client: client.displacement("plate", [1, 0, 0], on_thin="wait", wait_s=0.5), 0.7),
        (lambda client: client.solve("plate", [1, 0, 0], wait_s=0.5), 0.7),
        (lambda client: client.solve("plate", [1, 0, 0]), 0.2),
    ],
)
def test_a_call_is_given_the_time_that_it_lets_the_server_hold_it_back(stub: Stub, ask, held):
    stub.answers(Answer(held=True))
    says = pytest.raises(ServerTimeout, match=f"within {held:g} s")
    with Client(stub.url, timeout=0.2) as client, says:
        ask(client)


@pytest.mark.parametrize(
    ("force", "moment", "says"),
    [
        ([0, 0], None, r"force must be three numbers \(x, y, z\), but has the shape \(2,\)"),
        ([0, 0, 0], [1], r"moment must be three numbers"),
        ([0, np.nan, 0], None, "fy must be finite, not nan"),
        ([0, 0, 0], [0, 0, np.inf], "mz must be finite, not inf"),
        ([0, 0, 0, 0, -np.inf, 0], None, "my must be finite, not -inf"),
        (["1", "2", "3"], None, r"force\[0\] is '1', not a number; give a float, such as 1.5"),
        ([1, None, 3], None, r"force\[1\] is None, not a number; give a float \(0.0 for no load"),
        ([0, 0, 1], {}, r"moment must be numbers, such as \[1.0, 2.0, 3.0\], not \{\}"),
        ("1,2,3", None, r"force must be numbers, such as \[1.0, 2.0, 3.0\], not '1,2,3'"),
        (np.array([1, 2, 3], dtype=object), None, "force has the type object; convert it to"),
        ([[1], [2, 3]], None, "force has rows of different lengths; make all equal"),
        ([True, False, True], None, r"force\[0\] is True, not a number"),
    ],
)
def test_a_bad_wrench_is_named_before_anything_is_sent(stub: Stub, client, force, moment, says):
    with pytest.raises(ValueError, match=says):
        client.displacement("plate", force, moment)
    assert stub.seen == []


def test_a_bad_batch_or_option_is_named_before_anything_is_sent(stub: Stub, client: Client):
    wrenches = np.zeros((3, 6))
    wrenches[1, 4] = np.nan
    with pytest.raises(ValueError, match="wrench 1: my must be finite, not nan"):
        client.displacements("plate", wrenches)
    with pytest.raises(ValueError, match=r"shape \(n, 6 or more\), .* not \(3, 5\)"):
        client.displacements("plate", np.zeros((3, 5)))
    with pytest.raises(ValueError, match="on_thin must be one of queue, wait"):
        client.displacement("plate", [0, 0, 0], on_thin="maybe")
    with pytest.raises(ValueError, match="translation must be finite and above 0 m"):
        client.fill("plate", tolerance={"translation": 0.0, "rotation": 1.0})
    with pytest.raises(ValueError, match="tolerance: must be two numbers"):
        client.fill("plate", tolerance={"translation": 1.0})
    assert stub.seen == []


def test_a_problem_becomes_an_exception_that_reads_well(stub: Stub, client: Client):
    problem = {
        "type": "urn:x",
        "title": "The request does not have the form of this call",
        "status": 422,
        "detail": "Nothing was changed.",
        "errors": [{"loc": "force.1", "msg": "a number is needed"}],
    }
    stub.answers(Answer({**problem, "coverage": "thin"}, 422, "application/problem+json"))
    with pytest.raises(ProblemError) as caught:
        client.displacement("plate", [0, 0, 0])
    assert caught.value.body["coverage"] == "thin"
    assert caught.value.status == 422
    assert caught.value.title == problem["title"]
    assert caught.value.errors == problem["errors"]
    assert str(caught.value) == (
        "422 The request does not have the form of this call: Nothing was changed.\n"
        "  force.1: a number is needed"
    )


def test_a_library_of_several_pages_is_listed_whole(stub: Stub, client: Client):
    first, second = {"name": "a"}, {"name": "b"}
    following = "/v1/components?limit=1&after=a"
    stub.answers(
        Answer({"components": [first], "next": following, "broken": []}),
        Answer({"components": [second], "next": None, "broken": []}),
    )
    assert client.components() == [first, second]
    assert [item.path for item in stub.seen] == ["/v1/components", following]


def test_an_error_from_a_proxy_is_a_problem_too(stub: Stub, client: Client):
    stub.answers(Answer(b"<h1>Bad Gateway</h1>", status=502, kind="text/html"))
    with pytest.raises(ProblemError, match="502 Bad Gateway"):
        client.components()


def test_a_body_that_a_proxy_refuses_is_told_with_the_proxys_setting(stub: Stub, client: Client):
    page = b"<html>\n<head><title>413 Request Entity Too Large</title></head>\n<body>"
    stub.answers(Answer(page, status=413, kind="text/html"))
    with pytest.raises(ProblemError, match=r"Too Large\. A proxy .* client_max_body_size") as told:
        client.components()
    assert "<" not in str(told.value)


def test_wait_polls_until_the_job_has_ended(stub: Stub, client: Client):
    done = {"translation": [1, 2, 3], "rotation": [0, 0, 0], "component": "plate"}
    running = {"status": "running", "progress": {"fraction": 0.5, "message": "load factor 0.5"}}
    stub.answers(
        Answer({"id": 7, "status": "waiting", "url": "/v1/jobs/7"}),
        Answer({"id": 7, "url": "/v1/jobs/7", **running}),
        Answer({"id": 7, "status": "done", "url": "/v1/jobs/7", **done}),
    )
    job = client.wait(Job.read(QUEUED["job"]), timeout=600)
    assert job.status == "done"
    assert job.progress == 1.0
    assert job.vector is not None
    assert job.vector.tolist() == [1, 2, 3, 0, 0, 0]
    assert len(stub.seen) == 3
    assert all(item.path.startswith("/v1/jobs/7?wait_s=") for item in stub.seen)


def test_wait_takes_an_answer_that_has_a_job_and_says_what_else_it_takes(stub: Stub, client):
    stub.answers(Answer(QUEUED, status=202), Answer({"id": 7, "status": "done"}))
    assert client.wait(client.solve("plate", [0, 0, 1])).status == "done"
    stub.answers(Answer(COVERED))
    with pytest.raises(InvalidArgument, match=r"no job to wait for: it is complete"):
        client.wait(client.displacement("plate", [0, 0, 1]))
    with pytest.raises(
        InvalidArgument, match=r"job must be a Job, the number of a job, or an answer.*'bar'"
    ):
        client.wait("bar")  # type: ignore[arg-type]


def test_wait_gives_up_in_time_and_says_that_the_job_goes_on(stub: Stub, client: Client):
    stub.answers(Answer({"id": 7, "status": "running", "url": "/v1/jobs/7", "component": "bar"}))
    with pytest.raises(ServerTimeout, match=r"job 7 of bar is still running after 0\.2 s and"):
        client.wait(7, timeout=0.2)
    assert len(stub.seen) < 10  # an answer that comes at once is not asked for in a tight loop


def test_a_failed_job_says_why_and_what_to_do(stub: Stub, client: Client):
    error = {"kind": "not_converged", "message": "No balance at 0.7.", "remedy": "Lower the load."}
    stub.answers(Answer({"id": 7, "status": "failed", "error": error}))
    job = client.wait(7)
    assert job.ended
    assert job.failure == "not_converged. No balance at 0.7. Lower the load"


def test_a_server_says_how_many_jobs_it_has_cancelled(tmp_path: Path):
    """The client looked for a list of them, and raised KeyError after they were cancelled."""
    with served(tmp_path) as client:
        jobs = [client.solve("plate", [load, 0, 0]).job for load in (1.0, 2.0)]
        assert client.cancel_jobs("plate") == 2
        assert client.cancel_jobs("plate", "running") == 0
        assert {client.job(job).status for job in jobs if job} == {"cancelled"}


def test_fill_until_spends_its_budget_in_rounds_and_stops_when_met(stub: Stub, client: Client):
    budgets: list[int] = []

    def respond(seen) -> Answer:
        if seen.method == "GET":
            return Answer({"id": int(seen.path.split("/")[3].split("?")[0]), "status": "done"})
        budgets.append(seen.body["budget"])
        if len(budgets) == 3:
            return Answer({"jobs": [], "stage": "met", "reason": "everywhere within tolerance"})
        ids = range(10 * len(budgets), 10 * len(budgets) + seen.body["budget"])
        jobs = [{"id": number, "status": "waiting"} for number in ids]
        return Answer({"jobs": jobs, "stage": "refine", "reason": "largest error bars"}, status=202)

    stub.respond = respond
    rounds = list(client.fill_until("plate", (1e-5, 1e-4), budget=10, round_size=4))
    assert budgets == [4, 4, 2]
    assert [len(item.jobs) for item in rounds] == [4, 4, 0]
    assert all(job.status == "done" for item in rounds for job in item.jobs)
    assert (rounds[-1].stage, rounds[-1].reason) == ("met", "everywhere within tolerance")


def test_fill_until_stops_when_a_whole_round_fails(stub: Stub, client: Client):
    stub.respond = lambda seen: (
        Answer({"id": 1, "status": "failed"})
        if seen.method == "GET"
        else Answer({"jobs": [{"id": 1, "status": "waiting"}]}, status=202)
    )
    assert len(list(client.fill_until("plate", budget=50))) == 1


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda client: client.component(5), "name must be a string such as 'plate', not 5"),
        (
            lambda client: client.displacement("plate", loads=[1] * 6),
            "loads must map names to values",
        ),
        (lambda client: client.displacement("plate", inputs=3), "inputs must map names"),
        (lambda client: client.invalidate_row("plate", "x"), "row must be a whole number, not 'x'"),
        (lambda client: client.restore_row("plate", 1.5), "row must be a whole number, not 1.5"),
        (lambda client: client.restore_row("plate", math.inf), "row must be a whole number"),
        (lambda client: client.withdraw_import("plate", None), "number must be a whole number, n"),
        (lambda client: client.import_table("plate", 3), "table must be a path, or the content"),
        (lambda _: Client("127.0.0.1:99999"), "not the address of a server"),
        (lambda _: Client("http://127.0.0.1:x"), "not the address of a server"),
        (lambda _: Client("http//x"), "'http//x' is not the address of a server"),
        (lambda _: Client(None), "None is not the address of a server"),
        (lambda _: Client("http://plate..lab:8000"), "not the address of a server"),
        (lambda _: Client(timeout="5"), "timeout must be above 0 s .*, such as 10.0, not '5'"),
        (lambda _: Client(timeout=-1), "timeout must be above 0 s .*, such as 10.0, not -1"),
        (lambda _: Client(timeout=math.inf), "at most 1,000,000 s, such as 10.0, not inf"),
        (lambda _: Client(timeout=1e30), r"at most 1,000,000 s, such as 10.0, not 1e\+30"),
    ],
)
def test_an_argument_of_another_type_is_named_and_nothing_is_sent(
    stub: Stub, client: Client, call, text: str
):
    with pytest.raises(InvalidArgument, match=text):
        call(client)
    assert not stub.seen
