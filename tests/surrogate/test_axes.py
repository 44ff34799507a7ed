import numpy as np
import pytest

from tests.surrogate.responses import HIGH, RANGE, clean_wrenches, full_wrenches, smooth, table
from wrenchbook.surrogate.table.axes import AXES, axis_rows, single_axis_rows
from wrenchbook.surrogate.table.compliance import fit_compliance
from wrenchbook.surrogate.table.rows import Rows

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
