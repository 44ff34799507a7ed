"""The main job with real servers, real solvers and the simulator's client."""

import contextlib
import os
import signal

import numpy as np
import pytest

from tests.until import until

WRENCH = ([0.0, 0.0, -60.0], [0.0, 5.0, 0.0])


def test_a_linear_component_needs_one_solve_for_its_whole_range(server):
    client = server.start()
    first = client.displacement("bar", *WRENCH)
    assert first.job is not None
    assert client.wait(first.job).status == "done"
    assert client.component("bar")["rows"] >= 1  # it waits for the row
    again = client.displacement("bar", [12.0, -7.0, 3.0], [1.0, 2.0, 3.0], on_thin="wait")
    assert (again.coverage, again.source, again.method) == ("covered", "table", "linear")
    inertia, young, length = 0.02**4 / 12, 210e9, 1.0
    told = client.displacement("bar", [0, 0, 1.0], [0, 0, 0]).translation[2]
    assert told == pytest.approx(length**3 / (3 * young * inertia), rel=0.005)


def test_a_thin_table_is_solved_filled_and_then_covers(server):
    client = server.start()
    answer = client.displacement("plate_thin", *WRENCH, on_thin="wait", wait_s=60)
    assert answer.source == "fea"
    for round_ in client.fill_until("plate_thin", budget=18, round_size=18):
        assert {job.status for job in round_.jobs} <= {"done"}  # none once the tolerance is met
    tolerance = {"translation": 2e-3, "rotation": 2e-2}
    told = client.displacement("plate_thin", [0, 0, -500.0], [10.0, 0, 0], tolerance=tolerance)
    assert (told.coverage, told.source) == ("covered", "table")
    assert told.elapsed_us > 0
    true = client.solve("plate_thin", [0, 0, -500.0], [10.0, 0, 0], wait_s=60)
    error = np.abs(told.vector - true.vector)
    assert error[:3].max() <= tolerance["translation"]
    assert error[3:].max() <= tolerance["rotation"]


def test_killed_servers_and_solvers_lose_no_accepted_job_and_double_no_row(server):
    client = server.start()
    wrenches = np.zeros((5, 6))
    wrenches[:, 2] = -np.arange(1.0, 6.0) * 50
    jobs = [client.solve("plate_thin", wrench).job for wrench in wrenches]  # nothing is joined
    assert len({job.id for job in jobs}) == 5
    _wait_until_running(client)
    server.kill()
    client = server.start()
    _wait_until_running(client)
    _kill_a_solver(server.folder)
    for job in jobs:
        assert client.wait(job, timeout=120).status == "done"
    rows = client.call_json("GET", "/v1/components/plate_thin/table")["rows"]
    asked = sorted(tuple(wrench) for wrench in wrenches.tolist())
    assert sorted(tuple(row["wrench"]) for row in rows) == asked


def test_a_restarted_server_answers_as_before(server):
    client = server.start()
    client.solve("bar", *WRENCH, wait_s=60)
    for job in client.jobs("bar"):  # the solve asks for the whole compliance besides
        client.wait(job)
    client.component("bar")
    before = client.displacement("bar", [1, 2, 3], [4, 5, 6])
    server.stop()
    after = server.start().displacement("bar", [1, 2, 3], [4, 5, 6])
    assert after.vector.tolist() == before.vector.tolist()
    assert after.table_version == before.table_version


def _wait_until_running(client):
    until(lambda: client.jobs("plate_thin", "running"))


def _kill_a_solver(folder):
    """Kill a solver of this server; its pid stands in the lock it holds."""

    def killed():
        for lock in folder.glob("jobs/*/*/lock"):
            if not lock.with_name("result.json").exists() and lock.read_text().strip():
                with contextlib.suppress(ProcessLookupError):
                    os.kill(int(lock.read_text()), signal.SIGKILL)
                    return True
        return False

    until(killed)
