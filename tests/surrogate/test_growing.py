"""Tables that grow: what is taken over from the version before, and what is never made."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.surrogate.law import build
from tests.surrogate.responses import (
    HIGH,
    RANGE,
    clean_wrenches,
    full_wrenches,
    smooth,
    table,
)
from wrenchbook.surrogate.build import Table
from wrenchbook.surrogate.table import axes as thinning
from wrenchbook.surrogate.table.axes import evenly_chosen
from wrenchbook.surrogate.table.merging import RowIndex
from wrenchbook.surrogate.table.rows import Rows, Tolerance

ASKED = np.concatenate((full_wrenches(80, 11), clean_wrenches(20, 12) * 0.9)) * HIGH


def same_digits(one: Table, other: Table) -> bool:
    for method in ("griddata", "additive", None):
        ours, theirs = one.batch(ASKED, method=method), other.batch(ASKED, method=method)
        if any(a.tobytes() != b.tobytes() for a, b in zip(ours, theirs, strict=True)):
            return False
        slopes = one.derivatives(ASKED, method=method), other.derivatives(ASKED, method=method)
        if slopes[0].tobytes() != slopes[1].tobytes():
            return False
    return one.coverage_summary() == other.coverage_summary()


def one_more(rows: Rows, scaled: list[float]) -> Rows:
    wrench = np.array([scaled])
    more = Rows.of(wrench * HIGH, smooth(wrench), seq=[int(rows.seq.max(initial=0)) + 1])
    return rows + more


@settings(max_examples=6)
@given(data=st.data())
def test_a_table_that_has_grown_has_the_digits_of_one_built_at_once(data: st.DataObject) -> None:
    rows = table(smooth, clean_wrenches(data.draw(st.integers(4, 14)), 3))
    grown = build(rows, RANGE)
    loads = st.sampled_from((0.0, 0.1, -0.35, 0.8, 1.0))
    for _ in range(data.draw(st.integers(1, 3))):
        if len(rows) > 12 and data.draw(st.booleans()):  # a row is withdrawn
            gone = data.draw(st.integers(0, len(rows) - 1))
            rows = rows.take(np.arange(len(rows)) != gone)
        else:
            rows = one_more(rows, [data.draw(loads) for _ in range(6)])
        grown = build(rows, RANGE, before=grown)
        assert same_digits(grown, build(rows, RANGE))


def test_a_row_of_one_axis_has_the_others_taken_over() -> None:
    rows = table(smooth, clean_wrenches(50, 1))
    before = build(rows, RANGE)
    earlier = before.axes  # made by its packing, before the next version is built
    after = build(one_more(rows, [0.3, 0, 0, 0, 0.1, 0.2]), RANGE, before=before)
    kept = [
        one.triangulation is other.triangulation  # type: ignore[union-attr]
        for one, other in zip(after.axes.tables, earlier.tables, strict=True)
    ]
    assert kept == [False, True, True]


def test_a_withdrawn_row_that_is_restored_gives_the_digits_before() -> None:
    rows = table(smooth, clean_wrenches(50, 1))
    first = build(rows, RANGE)
    without = build(rows.take(np.arange(len(rows)) != 60), RANGE, before=first)
    assert not same_digits(without, first)
    assert same_digits(build(rows, RANGE, before=without), first)


def test_rows_after_which_the_same_points_have_other_numbers_name_the_new_ones() -> None:
    rows = table(smooth, clean_wrenches(30, 1))
    moved = Rows.of(rows.wrench, rows.displacement, seq=rows.seq + 1000)
    after = build(moved, RANGE, before=build(rows, RANGE))
    wrench = (0.5 * rows.wrench[10]).tolist()
    named = after.explain(wrench)
    assert named == build(moved, RANGE).explain(wrench)


def test_tables_that_lack_outputs_grow_to_the_same_digits() -> None:
    rows = table(smooth, clean_wrenches(30, 1))
    moved = rows.displacement.copy()
    moved[:20, 3:] = np.nan
    partial = Rows.of(rows.wrench, moved)
    before = build(partial, RANGE)
    assert before.rows.partial
    grown = build(one_more(partial, [0.3, 0, 0, 0, 0.1, 0.2]), RANGE, before=before)
    asked = ASKED[0].tolist()
    fresh = build(one_more(partial, [0.3, 0, 0, 0, 0.1, 0.2]), RANGE)
    assert grown.answer(asked) == fresh.answer(asked)


def test_no_version_holds_the_one_before() -> None:
    rows = table(smooth, clean_wrenches(30, 1))
    before = build(rows, RANGE)
    after = build(one_more(rows, [0.3, 0, 0, 0, 0.1, 0.2]), RANGE, before=before)
    shapes = [item.triangulation for item in after.axes.tables]
    assert all(cut.shape in shapes for cuts in after.axes.cuts for cut in cuts)
    assert all(item not in after.axes.tables for item in before.axes.tables)
    holders = after.table, after.groups[0]
    assert all(value is not before.table for holder in holders for value in vars(holder).values())
    assert all(value is not before.groups[0] for value in vars(after.groups[0]).values())


def test_a_thinned_axis_is_told(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(thinning, "MAX_POINTS", 1000)
    rows = table(smooth, clean_wrenches(3500, 1))
    surrogate = build(rows, RANGE, tolerance=Tolerance(1.0, 1.0))
    reported = [axis["rows"] for axis in surrogate.coverage_summary()["axes"]]
    assert reported == [len(item.values) for item in surrogate.axes.tables]
    assert all(len(item.values) < 1500 for item in surrogate.axes.tables if item)


def test_a_thinned_table_that_grows_has_the_digits_of_one_built_at_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(thinning, "MAX_POINTS", 12)
    rows = table(smooth, clean_wrenches(25, 1))
    grown = build(rows, RANGE)
    for step in range(3):
        rows = one_more(rows, [0.1 * step + 0.05, 0, 0, 0, 0.1, 0.2])
        grown = build(rows, RANGE, before=grown)
        assert same_digits(grown, build(rows, RANGE))


def test_a_new_point_moves_no_other_in_or_out_of_the_choice(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(thinning, "MAX_POINTS", 100)
    points = np.random.default_rng(1).uniform(-1, 1, (300, 3))
    fewer = evenly_chosen(points[:-1])
    assert (evenly_chosen(points)[:-1] == fewer).mean() > 0.99


def test_the_corners_of_a_thinned_axis_stay(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(thinning, "MAX_POINTS", 100)
    points = np.random.default_rng(1).uniform(-1, 1, (5000, 3))
    points[:8] = np.array(np.meshgrid(*[[-1, 1]] * 3)).reshape(3, -1).T
    assert evenly_chosen(points)[:8].all()


def test_the_first_of_rows_with_one_wrench_is_found_and_zero_has_no_sign() -> None:
    wrenches = np.array([[1.0, 0, 0, 0, 0, 0], [0.0] * 6, [1.0, 0, 0, 0, 0, 0], [2.0] * 6])
    index = RowIndex(wrenches, np.ones(6))
    asked = np.array([[1.0, -0.0, 0, 0, 0, 0], [-0.0] * 6, [3.0] * 6, [2.0] * 6])
    assert index.indices(asked).tolist() == [0, 1, -1, 3]
    assert RowIndex(np.empty((0, 6)), np.ones(6)).indices(asked).tolist() == [-1] * 4
