from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial import KDTree

from tests.surrogate.responses import HIGH, RANGE, clean_wrenches, full_wrenches, smooth, table
from wrenchbook.surrogate.build import STEEPER
from wrenchbook.surrogate.table import merging
from wrenchbook.surrogate.table import rows as limits
from wrenchbook.surrogate.table.axes import AXES, axis_rows, single_axis_rows
from wrenchbook.surrogate.table.compliance import fit_compliance
from wrenchbook.surrogate.table.merging import NEAR, close_groups, merge
from wrenchbook.surrogate.table.rows import (
    LoadRange,
    RowError,
    Rows,
    Tolerance,
    joined,
    unknown_column,
)
from wrenchbook.surrogate.table.space import Input, space_of

HEADER = Path(limits.__file__).resolve().parents[1] / "kernel" / "wb_internal.h"


def test_columns_that_nobody_knows_are_unknown() -> None:
    rows = Rows.of(np.eye(6)[:2], np.eye(6)[:2], source=["", "fea"])
    assert rows.seq.tolist() == [1, 2]
    assert rows.source.tolist() == ["", "fea"]
    assert np.isnan(rows.compliance).all()
    assert np.isnan(rows.uncertainty).all()


def test_an_empty_table_has_no_rows() -> None:
    assert len(Rows.empty()) == 0
    assert len(Rows.empty() + Rows.of(np.eye(6)[:1], np.eye(6)[:1])) == 1


def test_a_number_that_is_none_is_refused_by_row_and_field() -> None:
    with pytest.raises(RowError, match="row 7: uy must be finite"):
        Rows.of(np.eye(6)[:1], [0, np.inf, 0, 0, 0, 0], seq=[7])
    with pytest.raises(RowError, match="row 7: mz"):
        Rows.of([0, 0, 0, 0, 0, np.inf], np.eye(6)[:1], seq=[7])


def test_columns_of_differing_length_are_refused() -> None:
    with pytest.raises(RowError, match="displacement"):
        Rows.of(np.zeros((2, 6)), np.zeros((1, 6)))


def test_taken_rows_keep_all_their_columns() -> None:
    rows = Rows.of(np.eye(6), np.eye(6), source=list("abcdef"))
    assert rows.take([2, 0]).source.tolist() == ["c", "a"]
    assert rows.take(rows.wrench[:, 1] > 0).seq.tolist() == [2]


def test_a_load_range_scale_is_never_zero() -> None:
    scale = LoadRange(np.array([-2.0, 0, 5, 0, -1, 1]), np.array([2.0, 4, 5, 0, 3, 1])).scale
    assert scale.tolist() == [2, 2, 5, 1, 2, 1]


def test_a_load_range_must_be_finite_and_in_order() -> None:
    with pytest.raises(RowError, match="fy"):
        LoadRange(np.array([0.0, 1, 0, 0, 0, 0]), np.zeros(6))
    with pytest.raises(RowError, match="low of fx must be finite, not nan"):
        LoadRange(np.array([np.nan, 0, 0, 0, 0, 0]), np.zeros(6))
    with pytest.raises(RowError, match=r"low needs 6 numbers, .* of shape \(5,\)"):
        LoadRange(np.zeros(5), np.zeros(6))


def test_a_tolerance_is_above_zero() -> None:
    with pytest.raises(RowError):
        Tolerance(0.0, 1e-4)
    with pytest.raises(RowError):
        Tolerance(1e-4, float("nan"))


THIRDS = np.arange(112.0).reshape(2, 56)


def test_rows_joined_with_others_keep_their_third_derivatives() -> None:
    known, bare = (
        Rows.of(np.eye(6)[:2], np.eye(6)[:2], curvature=THIRDS),
        Rows.of([[0] * 6], [[0] * 6]),
    )
    both = bare + known
    assert np.isnan(both.curvature[0]).all()
    assert both.curvature[1:].tobytes() == known.curvature.tobytes()


def test_joined_rows_of_no_table_or_of_other_inputs_are_refused() -> None:
    warm = space_of(scalars=(Input("temperature", "K", "scalar"),))
    cold = Rows.of(np.eye(6)[:1], np.eye(6)[:1])
    with pytest.raises(RowError, match="at least one table"):
        joined([])
    with pytest.raises(RowError, match=r"'temperature'.* cannot be joined"):
        joined([cold, Rows.of(np.eye(7)[:1], np.eye(6)[:1], warm)])
    assert joined([Rows.empty(warm), cold]) is cold


def test_values_with_arrays_are_equal_to_themselves_only() -> None:
    columns = np.eye(6)
    first, second = (LoadRange(-np.ones(6), np.ones(6)) for _ in range(2))
    assert first != second
    assert len({first, second}) == 2
    assert Rows.of(columns, columns) != Rows.of(columns, columns)


def test_rows_without_third_derivatives_take_no_memory_for_them() -> None:
    known, bare = (
        Rows.of(np.eye(6)[:2], np.eye(6)[:2], curvature=THIRDS),
        Rows.of([[0] * 6], [[0] * 6]),
    )
    assert (known + bare).take([2]).curvature.shape == (1, 0)
    assert known.take(np.zeros(2, dtype=bool)).curvature.shape == (0, 0)


def test_third_derivatives_of_another_number_are_refused() -> None:
    with pytest.raises(RowError, match=r"curvature has shape \(1, 55\), not \(1, 56\)"):
        Rows.of(np.eye(6)[:1], np.eye(6)[:1], curvature=np.zeros((1, 55)))


@pytest.mark.parametrize("wrong", [np.inf, np.nan])
def test_an_infinite_or_missing_third_derivative_is_refused_by_row(wrong: float) -> None:
    thirds = THIRDS.copy()
    thirds[1, 7] = wrong
    with pytest.raises(RowError, match=r"row 2: curvature must be 56 finite .*; 55 of them"):
        Rows.of(np.eye(6)[:2], np.eye(6)[:2], curvature=thirds)


def test_the_kernel_calls_the_same_wrenches_one_and_the_same_loads_none() -> None:
    lines = [line.split() for line in HEADER.read_text().splitlines()]
    result = {line[1]: float(line[2]) for line in lines if line[:1] == ["#define"] and line[2:]}
    same = {f"WB_{name}": getattr(limits, name) for name in ("ZERO_LOAD", "NEAR", "ROUNDING")}
    assert result.items() >= {**same, "WB_STEEPER": STEEPER}.items()


@pytest.mark.parametrize("dimensions", [1, 3, 7])
def test_groups_are_those_that_all_distances_give(dimensions):
    rng = np.random.default_rng(dimensions)
    points = rng.uniform(-1, 1, (1500, dimensions))
    steps = rng.choice([0.0, 0.4, 0.99, 1.01, 3.0], (500, dimensions)) * NEAR
    points[1000:] = points[:500] + steps * rng.choice([-1, 1], (500, dimensions))
    groups = close_groups(points)
    for first, second in KDTree(points).query_pairs(0.995 * NEAR, p=np.inf):
        assert groups[first] == groups[second]
    for item in np.unique(groups):
        members = points[groups == item]
        if len(members) == 2:
            assert np.abs(members[0] - members[1]).max() <= 1.0001 * NEAR
    assert 1000 < len(np.unique(groups)) < 1500


def test_merging_rows_without_tangents_makes_none_up():
    wrenches = np.zeros((5, 6))
    wrenches[:, 0] = [0.0, 1.0, 1.0, 2.0, 3.0]
    rows = Rows.of(wrenches, 1e-6 * (wrenches + np.arange(5)[:, None]))
    merged = merge(rows, LoadRange(-5 * np.ones(6), 5 * np.ones(6)))
    assert merged.members == ((1,), (2, 3), (4,), (5,))
    assert np.isnan(merged.rows.compliance).all()
    assert merged.rows.uncertainty[1] == pytest.approx(0.5e-6)
    assert np.isnan(merged.rows.uncertainty[[0, 2, 3]]).all()


@pytest.mark.parametrize("known", [[1], [0, 1]])
def test_merged_rows_have_the_mean_of_the_third_derivatives_they_bring(known):
    wrenches = np.zeros((4, 6))
    wrenches[:, 0] = [1.0, 1.0, 2.0, 3.0]
    thirds = np.full((4, 56), np.nan)
    thirds[known] = np.arange(len(known))[:, None] + np.arange(56.0)
    rows = Rows.of(wrenches, 1e-6 * wrenches, curvature=thirds)
    merged = merge(rows, LoadRange(-5 * np.ones(6), 5 * np.ones(6))).rows
    assert merged.curvature[0].tolist() == rows.curvature[known].mean(axis=0).tolist()
    assert np.isnan(merged.curvature[1:]).all()


def test_a_column_nobody_knows_takes_no_memory_however_rows_are_picked_and_joined():
    rows = Rows.of(np.eye(6), np.eye(6))
    both = rows.take([0, 2, 4]) + rows.take(np.arange(6) > 3)
    assert both.compliance.strides == (0, 0, 0)
    assert (both.compliance.shape, both.uncertainty.shape) == ((5, 6, 6), (5, 6))
    known = Rows.of(np.eye(6), np.eye(6), compliance=np.ones((6, 6, 6)))
    joined = rows + known
    assert np.isnan(joined.compliance[:6]).all()
    assert (joined.compliance[6:] == known.compliance).all()
    assert np.isnan(unknown_column(3, 6)).all()


def test_a_known_column_of_one_broadcast_number_stays_known():
    rows = Rows.of(np.eye(6), np.eye(6), uncertainty=np.zeros((6, 6)))
    rows = replace(rows, uncertainty=np.broadcast_to(1e-6, (6, 6)))
    assert (rows.take([0, 2]).uncertainty == 1e-6).all()
    assert ((rows + rows).uncertainty == 1e-6).all()


def test_readings_of_a_held_load_are_one_row_in_memory_that_does_not_grow_by_their_square(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(merging, "MAX_PAIRS", 1000)
    rng = np.random.default_rng(4)
    held = np.repeat(rng.uniform(-1, 1, (3, 6)), 400, axis=0)
    points = held + rng.uniform(-1e-7, 1e-7, held.shape)
    asked: list[int] = []

    class Counting(merging.KDTree):
        def query_pairs(self, *args: Any, **options: Any) -> np.ndarray:
            pairs = super().query_pairs(*args, **options)
            asked.append(len(pairs))
            return pairs

    monkeypatch.setattr(merging, "KDTree", Counting)
    assert merging.close_groups(points).tolist() == [0] * 400 + [1] * 400 + [2] * 400
    assert max(asked) <= 1000


COMPLIANCE = np.array(np.random.default_rng(0).normal(size=(6, 6))) * 1e-6


def linear(x: np.ndarray) -> np.ndarray:
    return (x * HIGH) @ COMPLIANCE.T


def rows_of(axis: int, rows: Rows, off_axis: str) -> tuple[np.ndarray, list[int]]:
    fit = fit_compliance(rows, RANGE, linear=False)
    chosen = axis_rows(rows, RANGE, AXES[axis], fit, off_axis)  # type: ignore[arg-type]
    return chosen.displacement, rows.seq[[m for ms in chosen.members for m in ms]].tolist()


def test_each_axis_has_its_force_and_the_two_other_moments() -> None:
    assert [axis.inputs for axis in AXES] == [(0, 4, 5), (1, 5, 3), (2, 3, 4)]
    assert [axis.outputs for axis in AXES] == [(0, 3, 4, 5), (1, 3, 4, 5), (2, 3, 4, 5)]


def test_a_pure_moment_is_clean_for_two_axes_and_no_load_for_all() -> None:
    wrench = np.diag(HIGH)
    wrench = np.concatenate((wrench, np.zeros((1, 6)), np.ones((1, 6))))
    clean = single_axis_rows(Rows.of(wrench, np.zeros((8, 6))), RANGE)
    assert clean[:3].tolist() == np.eye(3, dtype=bool).tolist()
    assert clean[3:6].tolist() == (~np.eye(3, dtype=bool)).tolist()
    assert clean[6].all()
    assert not clean[7].any()


def test_loads_below_a_billionth_of_the_range_do_not_spoil_a_row() -> None:
    wrench = np.array([[100.0, 1e-10, 0, 0, 0, 0], [100.0, 1e-3, 0, 0, 0, 0]])
    clean = single_axis_rows(Rows.of(wrench, np.zeros((2, 6))), RANGE)
    assert clean.tolist() == [[True, False, False], [False, False, False]]


def test_a_row_clean_for_one_axis_never_joins_another() -> None:
    rows = table(smooth, clean_wrenches(20, 1))
    for axis in range(3):
        _, used = rows_of(axis, rows, "ignore")
        assert used == sorted(used, key=used.index)
        assert set(used) == set(range(20 * axis + 1, 20 * axis + 21))


def test_full_wrenches_join_all_three_axes_with_their_linear_off_axis_part_removed() -> None:
    scaled = np.concatenate((clean_wrenches(20, 1), full_wrenches(5, 2)))
    rows = table(linear, scaled)
    for axis in AXES:
        fit = fit_compliance(rows, RANGE, linear=False)
        chosen = axis_rows(rows, RANGE, axis, fit, "correct")
        alone = np.zeros((len(chosen.points), 6))
        alone[:, list(axis.inputs)] = chosen.points
        assert len(chosen.points) == 25
        assert chosen.single_axis.sum() == 20
        np.testing.assert_allclose(chosen.displacement, linear(alone), rtol=0, atol=1e-15)


@pytest.mark.parametrize(("off_axis", "count"), [("ignore", 25), ("exclude", 20)])
def test_full_wrenches_can_be_used_as_they_are_or_left_out(off_axis: str, count: int) -> None:
    rows = table(linear, np.concatenate((clean_wrenches(20, 1), full_wrenches(5, 2))))
    displacement, used = rows_of(0, rows, off_axis)
    assert len(used) == count
    if off_axis == "ignore":
        assert {tuple(d) for d in rows.displacement[60:]} <= {tuple(d) for d in displacement}


def test_a_full_wrench_stays_out_while_no_row_tells_its_off_axis_loads() -> None:
    rows = table(linear, np.concatenate((clean_wrenches(20, 1)[:20], full_wrenches(2, 2))))
    assert len(rows_of(0, rows, "correct")[1]) == 20


def test_equal_wrenches_merge_to_their_mean() -> None:
    wrench = np.zeros((3, 6))
    wrench[:, 0] = [100, 100, 200]
    displacement = np.array([[1.0] * 6, [3.0] * 6, [5.0] * 6])
    rows = Rows.of(wrench, displacement, uncertainty=np.full((3, 6), 0.25))
    fit = fit_compliance(rows, RANGE, linear=False)
    merged = axis_rows(rows, RANGE, AXES[0], fit, "correct")
    assert merged.members == ((0, 1), (2,))
    mean = rows.displacement[:2, 0].mean()
    assert merged.displacement[:, 0].tolist() == [mean, rows.displacement[2, 0]]


def test_a_full_wrench_gives_way_to_a_clean_row_at_the_same_inputs() -> None:
    wrench = np.array([[100.0, 0, 0, 0, 0, 0], [100.0, 50, 0, 9, 0, 0]])
    rows = Rows.of(wrench, np.array([[1.0] * 6, [7.0] * 6]))
    displacement, used = rows_of(0, rows, "ignore")
    assert used == [1]
    assert displacement[:, 0].tolist() == [rows.displacement[0, 0]]
