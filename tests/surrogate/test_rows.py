from pathlib import Path

import numpy as np
import pytest

from wrenchbook.surrogate.build import STEEPER
from wrenchbook.surrogate.table import rows as limits
from wrenchbook.surrogate.table.rows import LoadRange, RowError, Rows, Tolerance

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
    with pytest.raises(RowError, match="row 7: uy is not a finite number"):
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
    with pytest.raises(RowError, match="6 finite"):
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
    with pytest.raises(RowError, match="row 2: curvature is not 56 finite numbers"):
        Rows.of(np.eye(6)[:2], np.eye(6)[:2], curvature=thirds)


def test_the_kernel_calls_the_same_wrenches_one_and_the_same_loads_none() -> None:
    lines = [line.split() for line in HEADER.read_text().splitlines()]
    found = {line[1]: float(line[2]) for line in lines if line[:1] == ["#define"] and line[2:]}
    same = {f"WB_{name}": getattr(limits, name) for name in ("ZERO_LOAD", "NEAR", "ROUNDING")}
    assert found.items() >= {**same, "WB_STEEPER": STEEPER}.items()
