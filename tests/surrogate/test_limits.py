"""No table gives an estimate that no row could have: beyond 20 degrees or 10 m."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.surrogate.law import build
from wrenchbook.surrogate.kernel.reasons import LEAVES_LIMITS
from wrenchbook.surrogate.packed.writer import packed_of
from wrenchbook.surrogate.table.rows import LoadRange, Rows

TURN = math.radians(20.0)
EDGE = [
    ((10.0, 0, 0, 0, 0, 0), True),
    ((0, -10.001, 0, 0, 0, 0), False),
    ((0, 0, 0, 0, TURN, 0), True),
    ((0, 0, 0, 0, 0.8 * TURN, -0.8 * TURN), False),
    ((0, 0, 0, 1e6, 0, 0), False),
    ((None, 3.0, None, None, 0.1, None), True),
    ((None, 30.0, None, None, 0.1, None), False),
]


@pytest.mark.parametrize(("moved", "given"), EDGE)
def test_one_answer_and_a_batch_draw_the_same_line(
    moved: tuple[float | None, ...], given: bool
) -> None:
    told = np.zeros((6, 6))
    told[0] = np.array(moved, dtype=float) / 2
    told[1:, np.isnan(told[0])] = np.nan
    for high, coverage in ((2.0, "covered"), (1.0, "outside")):
        span = LoadRange(-np.full(6, high), np.full(6, high))
        packed = packed_of(build(Rows.of(np.eye(6), told), span, linear=True))
        wrench = [2.0, 0, 0, 0, 0, 0]
        one, many = packed.answer(wrench, [1e9] * 6), packed.batch([wrench], [1e9] * 6)
        assert one.coverage == coverage
        assert (LEAVES_LIMITS in one.reason) == (not given and coverage == "outside")
        if LEAVES_LIMITS in one.reason:
            assert (one.outputs, one.error) == (None, None)
            assert np.isnan(many.outputs).all()
            assert np.isnan(many.errors).all()
        else:
            assert one.outputs == pytest.approx(moved)
            np.testing.assert_allclose(many.outputs[0], np.array(moved, dtype=float))


def soft(partial: bool) -> Rows:
    """Rows along z that turn by 14 degrees at the range's end; some lack rotations if partial."""
    wrench = np.linspace(-1, 1, 9)[:, None] * np.array([0, 0, 1.0, 0, 0, 0])
    moved = wrench[:, 2:3] * np.array([0, 0, 1.0, TURN / 2, TURN / 2, 0])
    if partial:
        moved[:, 3] = np.nan
        moved[::2, 4] = np.nan
    return Rows.of(wrench, moved)


@pytest.mark.parametrize("partial", [False, True])
def test_a_table_leaves_out_estimates_beyond_the_limits(partial: bool) -> None:
    """Of several groups of outputs the whole displacement counts, and all of it goes."""
    table = build(soft(partial), LoadRange(-np.ones(6), np.ones(6)))
    assert table.answer([0, 0, 1.3, 0, 0, 0]).displacement is not None
    for load in (2.5, 20.0):
        wrench = [0, 0, load, 0, 0, 0]
        answer, found = packed_of(table).answer(wrench), table.batch([wrench])
        assert (answer.outputs, answer.error) == (None, None)
        assert LEAVES_LIMITS in answer.reason
        assert answer.coverage == "outside"
        assert np.isnan(found.displacement).all()
        assert np.isnan(found.error).all()


def test_a_row_beyond_the_limits_answers_its_own_wrench() -> None:
    """No import takes one, but what a table has it tells."""
    rows = Rows.of([[0, 0, 3.0, 0, 0, 0]], [[0, 0, 30.0, 0, 0, 0]], source=np.array(["fea"]))
    answer = build(rows, _RANGE).answer(rows.wrench[0].tolist())
    assert (answer.method, answer.coverage) == ("row", "covered")
    assert answer.displacement == tuple(rows.displacement[0].tolist())


_RANGE = LoadRange(-np.ones(6), np.ones(6))
