"""Tables that made answers look surer than they were, each named after the symptom."""

from __future__ import annotations

import json
from itertools import product
from typing import Any

import numpy as np
import pytest

from tests.surrogate.calibrating import with_slopes
from tests.surrogate.kriging.responses import RESPONSES, noisy_rows
from tests.surrogate.law import build
from tests.surrogate.responses import (
    HIGH,
    RANGE,
    Response,
    clean_wrenches,
    coupled,
    full_wrenches,
    smooth,
    table,
)
from wrenchbook.surrogate.answer import METHODS
from wrenchbook.surrogate.kernel.reasons import UNKNOWN_TOGETHER
from wrenchbook.surrogate.packed.writer import packed_of
from wrenchbook.surrogate.table.axes import AXES
from wrenchbook.surrogate.table.rows import Rows, Tolerance

CLEAN = clean_wrenches(25, 1)
ASKED = full_wrenches(80, 2) * 0.9


def test_one_solve_at_25_times_the_range_changes_no_answer_but_its_own() -> None:
    rows = with_slopes(smooth, CLEAN)
    far = np.array([[0.0, 0, 25, 0, 0, 0]])
    odd = with_slopes(lambda x: 0.2 * smooth(x), far)
    odd.seq[:] = 1000
    with_odd, without = build(rows + odd, RANGE), build(rows, RANGE)
    for method in (None, "linear", "griddata"):
        reported, expected = (s.batch(ASKED * HIGH, method=method) for s in (with_odd, without))
        for one, other in zip(reported, expected, strict=True):
            np.testing.assert_array_equal(one, other)
    np.testing.assert_array_equal(with_odd.fit.matrix, without.fit.matrix)
    own = with_odd.answer(odd.wrench[0].tolist())
    assert (own.coverage, own.method) == ("covered", "row")
    assert own.displacement == tuple(odd.displacement[0].tolist())
    assert with_odd.answer((odd.wrench[0] * 0.99).tolist()).coverage == "outside"
    assert with_odd.coverage_summary()["beyond_range"] == 1


def test_a_row_a_billionth_beyond_the_range_is_used() -> None:
    rows = table(smooth, CLEAN * (1 + 5e-10))
    assert len(build(rows, RANGE).used) == len(rows)


def test_almost_equal_rows_do_not_make_slopes_of_their_noise() -> None:
    """Loads times 1 + 1e-8 and 0.1 % apart: 5e-2 m was answered, 4e-4 is true."""
    near = Rows.of(
        CLEAN * HIGH * (1 - 1e-8), smooth(CLEAN) * 1.001, seq=1000 + np.arange(len(CLEAN))
    )
    rows = table(smooth, CLEAN) + near
    surrogate = build(rows, RANGE)
    assert len(surrogate.used) == len(CLEAN)
    x = ASKED[:, [0, 4, 5]] * 1.2
    asked = np.zeros((len(x), 6))
    asked[:, [0, 4, 5]] = x
    reported = surrogate.batch(asked * HIGH)
    assert np.abs(reported.displacement).max() < 2 * np.abs(smooth(asked)).max()
    merged = surrogate.answer((CLEAN[10] * HIGH * (1 - 1e-8)).tolist())
    assert merged.displacement is not None
    assert merged.error is not None
    np.testing.assert_allclose(merged.displacement[0], smooth(CLEAN[10:11])[0, 0], rtol=1e-3)
    assert merged.error[0] > abs(merged.displacement[0] - 1.0005 * smooth(CLEAN[10:11])[0, 0])
    behind = surrogate.explain((CLEAN[10] * HIGH).tolist())[0]["rows"]
    assert {11, 1010} <= set(behind)


@pytest.mark.parametrize("method", METHODS)
def test_full_wrenches_are_thin_on_tables_without_full_wrenches(method: str) -> None:
    surrogate = build(table(coupled, CLEAN), RANGE)
    one = surrogate.answer((ASKED[0] * HIGH).tolist(), method=method)
    assert one.coverage == "thin"
    assert one.error is None
    assert one.reason == UNKNOWN_TOGETHER
    assert (surrogate.batch(ASKED[:9] * HIGH, method=method).coverage == 1).all()
    # whatever its bar: one axis alone is not in doubt
    clean = surrogate.answer([100.0, 0, 0, 0, 5, 5], Tolerance(1.0, 1.0), method)
    assert clean.coverage == "covered"


@pytest.mark.parametrize(("rows_of", "count"), [(table, 15), (with_slopes, 2), (with_slopes, 8)])
def test_errors_are_known_of_wrenches_that_load_as_much_at_once_as_a_row_does(
    rows_of: Any, count: int
) -> None:
    """Of rows without slopes from fifteen on: their left-out errors are in the bars."""
    rows = rows_of(coupled, np.concatenate((CLEAN, 0.5 * full_wrenches(count, 5))))
    surrogate = build(rows, RANGE)
    near, far = (surrogate.batch(part * ASKED * HIGH) for part in (0.3, 1.0))
    assert np.isfinite(near.error).all(axis=1).mean() > 0.5
    besides_an_axis = np.min([np.abs(ASKED[:, axis.others]).max(axis=1) for axis in AXES], axis=0)
    assert np.isnan(far.error[besides_an_axis > 0.6]).all()
    missed = np.abs(near.displacement - coupled(0.3 * ASKED)) > near.error
    assert missed[np.isfinite(near.error)].mean() <= 0.1


def test_forty_full_wrenches_show_the_errors_of_most_full_wrenches() -> None:
    rows = table(coupled, np.concatenate((CLEAN, full_wrenches(40, 5))))
    result = build(rows, RANGE).batch(ASKED * HIGH, Tolerance(1.0, 1.0))
    assert (result.coverage == 0).mean() > 0.8


def test_tangents_of_clean_rows_alone_cover_no_full_wrench() -> None:
    """A product of three forces, and its slopes, are zero wherever one axis is loaded."""
    product = RESPONSES["strongly_coupled"]
    surrogate = build(with_slopes(product, CLEAN), RANGE)
    reported = surrogate.batch(ASKED * HIGH)
    assert np.isnan(reported.error).all()
    assert (reported.coverage == 1).all()
    one = surrogate.answer((ASKED[0] * HIGH).tolist())
    assert one.reason == UNKNOWN_TOGETHER


@pytest.mark.parametrize("count", range(1, 9))
@pytest.mark.parametrize("tangents", [True, False])
def test_linear_asked_of_a_few_nonlinear_rows_has_an_unknown_error_or_one_that_holds(
    count: int, tangents: bool
) -> None:
    """Its error bar was nothing, then the compliance's own: an unknown error is null, never 0."""
    scaled = np.concatenate((np.eye(6), -np.eye(6)[:2]))[:count]
    rows = with_slopes(smooth, scaled) if tangents else table(smooth, scaled)
    rows.source[:] = "fea"
    surrogate = build(rows, RANGE)
    asked = scaled * 0.5
    reported = surrogate.batch(asked * HIGH, method="linear")
    missed = np.abs(reported.displacement - smooth(asked))
    unknown = np.isnan(reported.error)
    assert (unknown | (missed <= reported.error + 1e-12)).mean() >= 0.9
    assert (reported.coverage[unknown.any(axis=1)] != 0).all()


@pytest.mark.parametrize("method", METHODS)
def test_no_bar_is_nothing_off_a_row(method: str) -> None:
    for rows in (
        table(smooth, full_wrenches(25, 1)),
        table(smooth, CLEAN * [0, 0, 1, 0, 0, 0]),
        table(lambda x: 0 * x, np.concatenate((CLEAN, np.zeros((1, 6))))),
    ):
        reported = build(rows, RANGE).batch(ASKED[:5] * HIGH * [0, 0, 1, 0, 0, 0], method=method)
        assert not (reported.error == 0).any()


def test_source_of_a_partly_measured_table_is_that_of_the_row_itself() -> None:
    moved = smooth(CLEAN)
    moved[:20, 3:] = np.nan
    source = [f"rig {place}" for place in range(len(CLEAN))]
    surrogate = build(Rows.of(CLEAN * HIGH, moved, source=source), RANGE)
    assert surrogate.rows.partial
    reported = [
        packed_of(surrogate).answer(surrogate.rows.wrench[place].tolist(), [0.0] * 6).source
        for place in (20, 50, 0)
    ]
    assert reported == ["rig 20", "rig 50", None]  # the first rows lack outputs, which others tell
    assert packed_of(surrogate).answer([1.0] * 6).source is None


def test_two_thousandths_of_a_newton_across_the_hull_do_not_jump() -> None:
    """-1999.999 to -2000.001 N moved u_z by 44 um, and -2000 was said to lie outside -2000."""
    wrench = np.zeros((9, 6))
    wrench[:, 2] = np.linspace(-2000, 2000, 9)
    moved = np.tanh(wrench[:, 2:3] / 1000) * np.full(6, 1e-3)
    surrogate = build(Rows.of(wrench, moved), RANGE)
    # A row is within 1e-6 of the range of -2000.001 N: that is the row's own.
    asked = (-1999.999, -2000.001, -2000.01)
    inside, beside, outside = (
        surrogate.answer([0, 0, f, 0, 0, 0], method="griddata") for f in asked
    )
    assert inside.displacement is not None
    assert beside.displacement is not None
    assert outside.displacement is not None
    assert abs(inside.displacement[2] - beside.displacement[2]) < 1e-9
    assert abs(inside.displacement[2] - outside.displacement[2]) < 5e-9
    assert (beside.coverage, beside.method) == ("covered", "row")
    assert outside.coverage == "outside"
    assert "-2000.01 N lies outside the rows, which span -2000..2000 N" in outside.reason
    assert surrogate.answer([0, 0, -2000 - 1e-7, 0, 0, 0]).coverage == "covered"


@pytest.mark.parametrize("slopes", [True, False])
@pytest.mark.parametrize("seed", range(5))  # lines of them leave the load range
def test_estimates_are_continuous_across_the_hull_along_any_line(seed: int, slopes: bool) -> None:
    rng = np.random.default_rng(seed)
    scaled = np.zeros((40, 6))
    scaled[:, [0, 4, 5]] = rng.uniform(-0.8, 0.8, (40, 3))
    surrogate = build((with_slopes if slopes else table)(smooth, scaled), RANGE)
    line = np.linspace(0, 1, 4001)[:, None]
    start, end = rng.uniform(-0.1, 0.1, 3), rng.normal(size=3)
    asked = np.zeros((len(line), 6))
    asked[:, [0, 4, 5]] = start + line * (1.6 * end / np.linalg.norm(end) - start)
    reported = surrogate.batch(asked * HIGH)
    assert set(reported.coverage) >= {2}
    assert len(set(reported.coverage)) > 1
    outputs = [0, 3, 4, 5]
    out = reported.coverage == 2
    steps = np.abs(np.diff(reported.displacement[:, outputs], axis=0))
    assert steps[out[1:] & out[:-1]].max() < 4e-5  # of 4e-4 of the way, outside as well
    for place in np.flatnonzero(np.diff(out.astype(int)))[:6]:
        near, far = asked[place], asked[place + 1]
        for _ in range(24):  # to some 1e-11 of the range
            middle = (near + far) / 2
            same = (surrogate.batch(middle * HIGH).coverage[0] == 2) == out[place]
            near, far = (middle, far) if same else (near, middle)
        pair = surrogate.batch(np.array([near, far]) * HIGH).displacement[:, outputs]
        assert np.abs(pair[0] - pair[1]).max() < 1e-9


def _nearest_on_hull(points: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return the points (k, 3) of the axis x from which steps to points off its hull begin.

    The rows' translation is a coordinate in turn, and stated slopes of zero add nothing to it.
    """
    wrenches, asked = np.zeros((len(points), 6)), np.zeros((len(x), 6))
    wrenches[:, [0, 4, 5]], asked[:, [0, 4, 5]] = points / 10, x / 10
    slopes, nearest = np.zeros((len(points), 6, 6)), []
    for coordinate in points.T:
        moved = np.zeros((len(points), 6))
        moved[:, 0] = 1e-3 * coordinate
        packed = packed_of(build(Rows.of(wrenches * HIGH, moved, compliance=slopes), RANGE))
        nearest.append(1e3 * packed.batch(asked * HIGH, None, "griddata").outputs[:, 0])
    return np.stack(nearest, axis=1)


def test_the_nearest_point_of_a_hull_is_nearer_than_any_other() -> None:
    rng = np.random.default_rng(3)
    for points in (rng.normal(size=(60, 3)), rng.normal(size=(20, 3)) * [1, 1, 0], np.ones((1, 3))):
        x = 5 * rng.normal(size=(200, 3))
        x = x[np.linalg.norm(x, axis=1) > 4]
        nearest = _nearest_on_hull(points, x)
        way = x - nearest
        farther = (way @ points.T).max(axis=1) - (way * nearest).sum(axis=1)
        assert farther.max() < 1e-10


def test_the_summary_tells_what_is_not_used_in_plain_values() -> None:
    rows = table(smooth, np.concatenate((CLEAN, CLEAN[:3], 9 * CLEAN[:1])))
    summary = json.loads(json.dumps(build(rows, RANGE).coverage_summary(), allow_nan=False))
    assert (summary["rows"], summary["used_rows"], summary["beyond_range"]) == (79, 75, 1)


def composite(star: float = 1.0) -> np.ndarray:
    """Half the corners of the range, its middle, and each load alone, scaled, (45, 6)."""
    corners = np.array(list(product((-1.0, 1.0), repeat=6)))
    half = corners[corners.prod(axis=1) > 0]
    return np.concatenate((half, np.zeros((1, 6)), star * np.eye(6), -star * np.eye(6)))


@pytest.mark.parametrize("noise", [0.0, 5e-7])
@pytest.mark.parametrize("method", [None, "kriging", "griddata", "additive"])
def test_rows_at_three_values_of_each_load_cover_nothing_between_them(method, noise) -> None:
    """All was covered with error bars of 1e-14 m, and wrong by 28 % of the range."""
    x = composite()
    moved = 1e-3 * np.tanh(2 * x)
    moved += noise * np.random.default_rng(1).normal(size=moved.shape)
    result = build(Rows.of(x * HIGH, moved), RANGE)
    asked = full_wrenches(200, 2) * HIGH
    assert (result.batch(asked, None, method).coverage > 0).all()


def sweeps(response: Response) -> Any:
    """Nine values of each load alone."""
    steps = np.linspace(-1, 1, 9)
    x = np.unique(np.concatenate([step * np.eye(6) for step in steps]), axis=0)
    return build(table(response, x), RANGE)


def twisted(x: np.ndarray) -> np.ndarray:
    """Of each load by itself, but for what F_z and M_x do together."""
    return 1e-3 * (np.tanh(x) + 0.5 * (x[:, 2] * x[:, 3])[:, None])


def test_loads_swept_one_at_a_time_cover_no_two_of_them_at_once_and_say_why() -> None:
    answer = sweeps(twisted).answer((HIGH * [0, 0, 0.44, 0.44, 0, 0]).tolist())
    assert (answer.coverage, answer.reason) == ("thin", UNKNOWN_TOGETHER)


def test_loads_swept_one_at_a_time_cover_each_alone() -> None:
    result = sweeps(twisted)
    for load in range(6):
        wrench = (HIGH * 0.44 * np.eye(6)[load]).tolist()
        assert result.answer(wrench, Tolerance(5e-5, 5e-5)).coverage == "covered"


@pytest.mark.parametrize("lowest", [0.0, -0.02])
def test_noisy_rows_of_tension_show_no_error_of_compression(lowest: float) -> None:
    """A part that is stiffer in compression was answered there, wrong by 126 error bars."""
    pulls = np.zeros((40, 6))
    pulls[:, 2] = np.linspace(lowest, 0.8, 40)
    rows = build(noisy_rows(smooth, pulls, 1, told=False), RANGE)
    for load, is_known in ((lowest, True), (0.83, True), (2 * lowest - 0.02, False)):
        answer = rows.answer([0.0, 0, load * HIGH[2], 0, 0, 0])
        assert ("beyond the rows that show errors" not in answer.reason) == is_known
