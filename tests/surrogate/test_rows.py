import numpy as np
import pytest

from wrenchbook.surrogate.table.rows import LoadRange, RowError, Rows, Tolerance

RECORD = {"seq": 7, "wrench": [1, 0, 0, 0, 0, 0], "displacement": [1e-6, 0, 0, 0, 0, 0]}


def test_records_become_rows_with_unknown_columns_marked() -> None:
    rows = Rows.from_records([RECORD, {**RECORD, "seq": 8, "source": "fea"}])
    assert rows.seq.tolist() == [7, 8]
    assert rows.source.tolist() == ["", "fea"]
    assert np.isnan(rows.compliance).all()
    assert np.isnan(rows.uncertainty).all()


def test_no_records_are_an_empty_table() -> None:
    assert len(Rows.empty()) == 0
    assert len(Rows.empty() + Rows.from_records([RECORD])) == 1


@pytest.mark.parametrize("key", ["seq", "wrench", "displacement"])
def test_a_record_without_a_needed_key_is_refused_by_name(key: str) -> None:
    with pytest.raises(RowError, match=key):
        Rows.from_records([{k: v for k, v in RECORD.items() if k != key}])


def test_a_number_that_is_none_is_refused_by_row_and_field() -> None:
    with pytest.raises(RowError, match="row 7: uy is not a finite number"):
        Rows.from_records([{**RECORD, "displacement": [0, np.inf, 0, 0, 0, 0]}])
    with pytest.raises(RowError, match="row 7: mz"):
        Rows.from_records([{**RECORD, "wrench": [0, 0, 0, 0, 0, np.inf]}])


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
