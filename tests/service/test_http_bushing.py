"""Load over displacement of each axis, for a bushing of a multibody program."""

import csv
import io

import numpy as np
import pytest

from tests.service.test_http_comparison import COMPLIANCE, bar, http  # noqa: F401 (fixtures)
from tests.service.test_http_library import load
from wrenchbook.service.contract import OUTPUTS

AXES = [*OUTPUTS]


def curves(http, name="bar", **query):  # noqa: F811
    reply = http.get(f"/v1/components/{name}/table", params={"format": "bushing"} | query)
    assert reply.status_code == 200, reply.text
    result = {}
    for axis, *numbers in [*csv.reader(io.StringIO(reply.text))][1:]:
        result.setdefault(axis, []).append([float(cell or "nan") for cell in numbers[:4]])
    return {axis: np.array(lines).T for axis, lines in result.items()}


def looped(http, count=121, width=0.04):  # noqa: F811
    """Import three cycles of fz with a loop, as a share of the output's range."""
    turn = np.linspace(0, 6 * np.pi, count)
    force, loop = 800 * np.sin(turn), np.where(np.cos(turn) > 0, 0.5, -0.5)
    moved = 1e-6 * force + width * 1.6e-3 * loop
    moved += np.random.default_rng(0).normal(0, 2e-6, count)
    rows = np.zeros((count, 9))
    rows[:, 2], rows[:, 6:8], rows[:, 8] = force, np.nan, moved
    text = "\n".join(f"{f!r},{u!r}" for f, u in rows[:, [2, 8]].tolist())
    query = {"missing_loads": "zero", "load_cell": "moving", "wait_s": 60}
    head = {"content-type": "text/csv"}
    path = "/v1/components/rig/table"
    assert http.post(path, content=f"fz [N],uz [m]\n{text}", params=query, headers=head).is_success


@pytest.mark.parametrize("others", ["displacement", "load"])
def test_the_load_of_a_curve_gives_its_displacement_back(bar, others):  # noqa: F811
    stiffness = np.linalg.inv(COMPLIANCE)
    for k, (axis, (d, force, _, _)) in enumerate(curves(bar, points=11, others=others).items()):
        assert axis == AXES[k]
        assert np.allclose(np.diff(d), np.ptp(d) / 10)
        wrench = np.zeros((11, 6))
        wrench[:, k] = force
        if others == "displacement":  # with the loads that hold the other axes
            wrench = force[:, None] * stiffness[:, k] / stiffness[k, k]
        body = {"wrenches": wrench.tolist(), "on_thin": "estimate"}
        reply = bar.post("/v1/components/bar/displacements", json=body).json()
        moved = np.array(reply["displacements"])
        assert np.abs(moved[:, k] - d).max() < 1e-9 * np.ptp(d)
        if others == "displacement":
            assert np.abs(np.delete(moved, k, axis=1)).max() < 1e-9 * np.ptp(d)


def test_curves_end_with_the_load_range_and_have_the_bar_of_their_load(bar):  # noqa: F811
    d, force, error, loop = curves(bar, others="load", points=3)["uz"]
    assert force == pytest.approx([-100, 0, 100], abs=1e-9)
    assert d == pytest.approx(COMPLIANCE[2, 2] * force, rel=1e-9, abs=1e-15)
    assert error[[0, 2]] == pytest.approx([0.1, 0.1], rel=0.01)  # a tenth of a percent
    assert loop.tolist() == [0, 0, 0]


def test_a_rig_with_a_loop_has_its_width_and_one_axis_alone(http):  # noqa: F811
    looped(http)
    results = curves(http, "rig", others="load", points=5)
    assert set(results) == {"uz"}
    d, force, _, loop = results["uz"]
    assert force == pytest.approx(1e6 * d, abs=20)
    assert loop == pytest.approx(np.full(5, 0.04 * 1600), rel=0.15)


def test_rows_that_tell_no_loop_leave_its_width_empty(http):  # noqa: F811
    force = np.linspace(-800, 800, 30)  # loaded alone, never unloaded
    rows = np.zeros((30, 9))
    rows[:, 2], rows[:, 8] = force, 1e-6 * force
    rows[:, 8] += np.random.default_rng(0).normal(0, 2e-6, 30)
    load(http, rows, load_cell="moving")
    assert np.isnan(curves(http, "rig", others="load", points=3)["uz"][3]).all()


def test_curves_end_where_the_rows_of_a_test_to_one_side_do(http):  # noqa: F811
    force = np.linspace(50, 700, 30)  # the curve begins at no load
    rows = np.zeros((30, 9))
    rows[:, 2], rows[:, 8] = force, 1e-6 * force
    rows[:, 8] += np.random.default_rng(0).normal(0, 2e-6, 30)
    load(http, rows, load_cell="moving")
    d, force, error, _ = curves(http, "rig", others="load", points=5)["uz"]
    assert force[[0, -1]] == pytest.approx([0, 700], abs=0.06 * 700)  # `covered` ends a bit later
    assert force == pytest.approx(1e6 * d, abs=10)
    assert np.isfinite(error[1:]).all()


def test_a_table_without_curves_says_what_to_do(http):  # noqa: F811
    looped(http)
    refused = http.get("/v1/components/rig/table", params={"format": "bushing"})
    assert (refused.status_code, "others=load" in refused.json()["detail"]) == (409, True)
    several = http.get("/v1/components/link/table", params={"format": "bushing"})
    assert (several.status_code, "one interface" in several.json()["detail"]) == (409, True)


def test_a_curve_of_a_load_range_without_zero_names_the_load(http):  # noqa: F811
    pulled = {"force": [[20, 100], [-1, 1], [-1, 1]], "moment": [1, 1, 1]}
    rig = {"name": "pulled", "title": "A rig", "range": pulled}
    rig["tolerance"] = {"translation": 1e-4, "rotation": 1e-3}
    assert http.post("/v1/components", json=rig).is_success
    load(http, [[50.0, *[0.0] * 8]], name="pulled")
    refused = http.get("/v1/components/pulled/table", params={"format": "bushing"})
    text = "ux: the load range of fx, 20 to 100 N, does not contain 0 N, where the curve starts"
    assert text in refused.json()["detail"]


def test_a_displacement_that_no_load_changes_has_no_curve(http):  # noqa: F811
    """A division by its slope of zero made the stiffness infinite."""
    load(http, [[0.0, 0.0, 1.0, *[0.0] * 3, 0.0, 0.0, 1e-6]], load_cell="moving")
    query = {"format": "bushing", "others": "load"}
    refused = http.get("/v1/components/rig/table", params=query)
    assert refused.status_code == 409
    assert "do not change its displacement; add rows at other loads" in refused.json()["detail"]


def test_a_curve_of_a_table_without_rows_asks_for_rows(http):  # noqa: F811
    """It asked for a wider load range."""
    query = {"format": "bushing", "others": "load"}
    refused = http.get("/v1/components/rig/table", params=query)
    assert refused.status_code == 409
    assert "the table has no rows; fill it (wrenchbook fill)" in refused.json()["detail"]
