"""What Prometheus is told is what has happened, at a cost no loop notices."""

import numpy as np
import pytest
from prometheus_client.parser import text_string_to_metric_families

import wrenchbook
from tests.service.ledger_rows import claim
from tests.service.live import answer_fast, as_rows, clean_wrenches, moved
from wrenchbook.service.ops.counts import EDGES, Counts

RANGE = {"force": [100.0] * 3, "moment": [10.0] * 3}


def samples(http):
    reply = http.get("/metrics")
    assert reply.status_code == 200
    assert reply.headers["content-type"].startswith("text/plain")
    return {
        (sample.name, *sorted(sample.labels.values())): sample.value
        for family in text_string_to_metric_families(reply.text)
        for sample in family.samples
    }


@pytest.fixture
def rig(http):
    http.post("/v1/components", json={"name": "rig", "title": "Rig", "range": RANGE})
    wrenches = clean_wrenches()
    rows = as_rows(wrenches, moved(wrenches))
    http.post("/v1/components/rig/table?format=json", json={"rows": rows})
    http.get("/v1/components/rig")
    return http


def queries(result, coverage):
    return sum(
        value
        for (name, *texts), value in result.items()
        if name == "wrenchbook_queries_total" and coverage in texts
    )


def test_each_wrench_is_counted_once_by_coverage_whichever_way_it_was_asked(rig):
    inside = {"force": [0, 0, 5], "moment": [0, 0, 0], "on_thin": "estimate"}
    outside = {"force": [0, 0, 500], "moment": [0, 0, 0], "on_thin": "estimate"}
    before = samples(rig)
    for body in (inside, inside, outside):
        assert rig.post("/v1/components/rig/displacement", json=body).status_code == 200
    batch = {"wrenches": [[0, 0, 5, 0, 0, 0]] * 7, "on_thin": "estimate"}
    assert rig.post("/v1/components/rig/displacements", json=batch).status_code == 200
    after = samples(rig)
    count = ("wrenchbook_query_seconds_count",)
    assert sum(queries(after, word) - queries(before, word) for word in ("covered", "thin")) == 9
    assert queries(after, "outside") - queries(before, "outside") == 1
    assert after[count] - before[count] == 4


def requests(result, route):
    return {
        tuple(texts): value
        for (name, *texts), value in result.items()
        if name == "wrenchbook_http_requests_total" and route in texts
    }


def test_requests_are_counted_by_route_template_method_and_status(rig):
    before = samples(rig)
    for number in (7, 8):
        assert rig.get(f"/v1/jobs/{number}").status_code == 404
    assert rig.request("MADE-UP", "/v1/jobs").status_code == 405
    after = samples(rig)
    assert requests(before, "/v1/jobs/{job_id}") == {}
    assert requests(after, "/v1/jobs/{job_id}") == {("/v1/jobs/{job_id}", "404", "GET"): 2}
    assert requests(after, "/v1/jobs") == {("/v1/jobs", "405", "other"): 1}
    assert after["wrenchbook_http_request_seconds_count", "/v1/jobs/{job_id}"] == 2


@pytest.mark.parametrize("call", ["recording", "envelope"])
def test_a_block_of_wrenches_is_counted_by_the_template_of_its_calls_whole_path(rig, call):
    route = "/v1/components/{name}/" + call
    block = {"wrenches": [[0, 0, 5, 0, 0, 0]]}
    assert rig.post(route.format(name="rig"), json=block).status_code in (200, 201)
    result = samples(rig)
    assert [texts[0] for texts in requests(result, route)] == [route]
    assert requests(result, "/" + call) == {}


def test_a_query_of_the_fast_path_and_of_the_usual_one_are_counted_as_requests(rig):
    route = "/v1/components/{name}/displacement"
    body = b'{"force": [0, 0, 5], "moment": [0, 0, 0], "on_thin": "estimate"}'
    result = samples(rig)
    assert isinstance(answer_fast(rig.app, "rig", body), bytes)
    assert rig.post(route.format(name="rig"), content=body).status_code == 200
    before, result = result, samples(rig)
    assert requests(result, route) == {(route, "200", "POST"): 2}
    count = ("wrenchbook_query_seconds_count",)
    assert result[count] - before[count] == 2
    assert result["wrenchbook_http_request_seconds_count", route] == 2


def test_the_build_and_the_process_are_in_the_metrics(rig):
    results = samples(rig)
    (build,) = [texts for name, *texts in results if name == "wrenchbook_build_info"]
    assert wrenchbook.__version__ in build
    for what in ("cpu_seconds_total", "resident_memory_bytes", "open_fds", "start_time_seconds"):
        assert results[f"process_{what}", "1"] > 0


def test_counts_of_requests_survive_a_restart_and_add_up():
    counts, other = Counts(), Counts()
    counts.add_request("/v1/jobs", "GET", 200, 0.002)
    other.add_all(Counts.from_json(counts.as_json()))
    other.add_all(counts)
    ((key, numbers),) = other.of("request")
    assert key == ("/v1/jobs", "GET", "200")
    assert (sum(numbers[:-1]), numbers[-1]) == (2, 0.004)


def test_the_histogram_is_cumulative_and_ends_with_all():
    counts = Counts()
    for elapsed in (1.0, 19.9, 20.0, 1e9):
        counts.add("thin", None, elapsed)
    reported = dict(counts.histogram())
    assert (reported[repr(EDGES[0])], reported["10.0"], reported["+Inf"]) == (3, 3, 4)
    counts.add_batch(np.array([0, 0, 2], dtype=np.uint8), "griddata", 10.0)
    assert counts.queries() == {
        ("thin", "none"): 4, ("covered", "griddata"): 2, ("outside", "griddata"): 1
    }  # fmt: skip


def test_jobs_solves_and_failures_are_told_by_status_and_kind(http, stand_in):
    stand_in("quick")
    http.post("/v1/components/spring/solve", json={"force": [0, 0, -5], "wait_s": 60})
    stand_in("diverges")
    http.post("/v1/components/spring/solve", json={"force": [0, 0, -7], "wait_s": 60})
    result = samples(http)
    assert result["wrenchbook_jobs", "done"] == 1
    assert result["wrenchbook_failed_jobs", "not_converged"] == 1
    assert result["wrenchbook_solve_seconds_count",] == 1
    assert result["wrenchbook_ledger_usable",] == 1


def test_tables_tell_version_rows_and_the_age_of_their_file(rig):
    rig.app.state.workspace.stop_building()  # writes what is not written yet
    result = samples(rig)
    assert result["wrenchbook_table_rows", "rig"] == 25
    assert result["wrenchbook_table_version", "rig"] == 25
    assert result["wrenchbook_table_file_age_seconds", "rig"] >= 0


def test_metrics_are_told_while_the_ledger_cannot_be_used(rig, folder, monkeypatch):
    (folder / "ledger.sqlite").rename(folder / "elsewhere.sqlite")
    monkeypatch.setattr("wrenchbook.service.ops.metrics.FRESH_S", 0.0)  # no cached statistics
    result = samples(rig)
    assert result["wrenchbook_ledger_usable",] == 0
    assert result["wrenchbook_ready",] == 0
    assert result["wrenchbook_table_rows", "rig"] == 25


def test_no_more_than_a_bounded_number_of_components_becomes_labels(rig, monkeypatch):
    monkeypatch.setattr("wrenchbook.service.ops.metrics.MAX_COMPONENTS", 2)
    results = samples(rig)
    assert sum(name == "wrenchbook_table_version" for name, *_ in results) <= 2
    assert results["wrenchbook_components",] == len(rig.app.state.workspace.library.names())


def test_kinds_of_failures_beyond_a_number_are_told_together(ledger, monkeypatch):
    monkeypatch.setattr("wrenchbook.service.ledger.job_statistics.MAX_KINDS", 3)
    for number in range(6):
        ledger.accept("a", "f", [float(number)] * 6)
        job = claim(ledger, "me")
        error = {"kind": f"k{number}", "message": "", "remedy": ""}
        ledger.fail(job.id, job.attempt, error)
    results = ledger.statistics().failures
    assert (len(results), results["other"]) == (4, 3)
