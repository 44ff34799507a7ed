"""Tables whose rows lack outputs, as of a test rig that measured only some."""

import numpy as np
import pytest

from tests.surrogate.law import build
from tests.surrogate.responses import HIGH, RANGE, clean_wrenches, full_wrenches, smooth
from wrenchbook.surrogate.table.rows import RowError, Rows, Tolerance, joined

SCALED = clean_wrenches(40, 1)
ASKED = full_wrenches(50, 2) * 0.8


def rows_with(measured: np.ndarray) -> Rows:
    moved = np.where(measured, smooth(SCALED), np.nan)
    return Rows.of(SCALED * HIGH, moved, source=["measured"] * len(SCALED))


def test_an_output_nobody_measured_is_none_and_the_reason_says_so() -> None:
    measured = np.zeros((len(SCALED), 6), dtype=bool)
    measured[:, 2] = True
    surrogate = build(rows_with(measured), RANGE)
    whole = build(Rows.of(SCALED * HIGH, smooth(SCALED)), RANGE)
    answer = surrogate.answer((ASKED[0] * HIGH).tolist(), method="griddata")
    assert answer.displacement is not None
    expected = whole.answer((ASKED[0] * HIGH).tolist(), method="griddata").displacement
    assert expected is not None
    assert answer.displacement[2] == pytest.approx(expected[2], rel=1e-12)
    others = [value for k, value in enumerate(answer.displacement) if k != 2]
    assert others == [None] * 5
    assert answer.error is None  # no row loads several axes
    assert answer.coverage == "thin"
    assert answer.missing == ("ux", "uy", "rx", "ry", "rz")
    only_z = surrogate.answer([0.0, 0.0, 2000.0, 50.0, 50.0, 0.0], Tolerance(1.0, 1.0))
    assert only_z.coverage == "covered"
    assert only_z.error is not None
    assert [value for k, value in enumerate(only_z.error) if k != 2] == [None] * 5
    assert only_z.missing == answer.missing
    assert only_z.reason == "not measured in any row: ux, uy, rx, ry, rz"
    assert surrogate.coverage_summary()["unmeasured"] == ["ux", "uy", "rx", "ry", "rz"]


def test_each_output_uses_all_rows_that_hold_it_and_no_other() -> None:
    measured = np.ones((len(SCALED), 6), dtype=bool)
    measured[::3, 3:] = False
    surrogate = build(rows_with(measured), RANGE)
    whole = build(Rows.of(SCALED * HIGH, smooth(SCALED)), RANGE)
    fewer = build(rows_with(measured).take(measured[:, 3]), RANGE)
    for method in ("griddata", "additive"):
        batch, of_whole, of_fewer = (
            each.batch(ASKED * HIGH, method=method).displacement
            for each in (surrogate, whole, fewer)
        )
        np.testing.assert_array_equal(batch[:, :3], of_whole[:, :3])
        np.testing.assert_array_equal(batch[:, 3:], of_fewer[:, 3:])
    assert surrogate.coverage_summary()["rows_per_output"] == {
        **dict.fromkeys(("ux", "uy", "uz"), 120),
        **dict.fromkeys(("rx", "ry", "rz"), 80),
    }


def test_a_row_without_any_output_is_refused() -> None:
    with pytest.raises(RowError, match="row 1: no displacement"):
        Rows.of(np.zeros(6), np.full(6, np.nan))
    with pytest.raises(RowError, match="uy is not a finite number"):
        Rows.of(np.zeros(6), [0, np.inf, 0, 0, 0, 0])


def test_whole_fields_are_told_by_the_kriging_of_whole_rows_though_others_lack_outputs() -> None:
    few = full_wrenches(24, 3)
    whole = Rows.of(few * HIGH, smooth(few), source=["fea"] * len(few))
    wrong = np.full((2, 6), np.nan)
    wrong[:, 2] = 1.2 * smooth(ASKED[:2])[:, 2]
    measured = Rows.of(ASKED[:2] * HIGH, wrong, source=["measured"] * 2)
    found = build(joined([whole, measured]), RANGE)
    assert found.rows.partial
    fullest, _ = found.groups
    assert len(fullest.rows) == len(whole)
    assert fullest.kriging is not None
