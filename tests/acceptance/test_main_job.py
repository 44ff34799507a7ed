"""The main job with real servers, real solvers and the simulator's client."""

import numpy as np
import pytest

WRENCH = ([0.0, 0.0, -60.0], [0.0, 5.0, 0.0])


def test_a_linear_component_needs_one_solve_for_its_whole_range(server):
    client = server.start()
    first = client.displacement("bar", *WRENCH)
    assert first.job is not None
    assert client.wait(first.job).status == "done"
    assert client.component("bar", wait_s=60)["rows"] >= 1  # it waits for the row
    again = client.displacement("bar", [12.0, -7.0, 3.0], [1.0, 2.0, 3.0], on_thin="wait")
    assert (again.coverage, again.source, again.method) == ("covered", "table", "linear")
    inertia, young, length = 0.02**4 / 12, 210e9, 1.0
    reported = client.displacement("bar", [0, 0, 1.0], [0, 0, 0]).translation[2]
    assert reported == pytest.approx(length**3 / (3 * young * inertia), rel=0.005)


def test_a_thin_table_is_solved_filled_and_then_covers(server):
    client = server.start()
    answer = client.displacement("plate_thin", *WRENCH, on_thin="wait", wait_s=60)
    assert answer.source == "fea"
    for round_ in client.fill_until("plate_thin", budget=18, round_size=18):
        assert {job.status for job in round_.jobs} <= {"done"}  # none once the tolerance is met
    client.component("plate_thin", wait_s=60)  # until the table has the last round
    tolerance = {"translation": 2e-3, "rotation": 2e-2}
    reported = client.displacement("plate_thin", [0, 0, -500.0], [10.0, 0, 0], tolerance=tolerance)
    assert (reported.coverage, reported.source) == ("covered", "table")
    assert reported.elapsed_us > 0
    true = client.solve("plate_thin", [0, 0, -500.0], [10.0, 0, 0], wait_s=60)
    error = np.abs(reported.vector - true.vector)
    assert error[:3].max() <= tolerance["translation"]
    assert error[3:].max() <= tolerance["rotation"]


def test_a_restarted_server_answers_as_before(server):
    client = server.start()
    client.solve("bar", *WRENCH, wait_s=60)
    for job in client.jobs("bar"):  # the solve asks for the whole compliance besides
        client.wait(job)
    client.component("bar", wait_s=60)
    before = client.displacement("bar", [1, 2, 3], [4, 5, 6])
    server.stop()
    after = server.start().displacement("bar", [1, 2, 3], [4, 5, 6])
    assert after.vector.tolist() == before.vector.tolist()
    assert after.table_version == before.table_version
