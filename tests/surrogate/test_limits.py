"""No table gives an estimate that no row could have: beyond 20 degrees or 10 m."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.surrogate.law import build
from tests.surrogate.law.answer import Answer, Batch
from tests.surrogate.law.limits import BEYOND_LIMITS, within_limits, within_limits_many
from wrenchbook.surrogate.answer import COVERED
from wrenchbook.surrogate.packed.writer import packed_of
from wrenchbook.surrogate.table.rows import LoadRange, Rows

TURN = math.radians(20.0)
EDGE = [
    ((10.0, 0, 0, 0, 0, 0), True),
    ((0, -10.001, 0, 0, 0, 0), False),
    ((0, 0, 0, 0, TURN, 0), True),
    ((0, 0, 0, 0, 0.8 * TURN, -0.8 * TURN), False),
    ((0, 0, 0, 1e300, 0, 0), False),
    ((None, 3.0, None, None, 0.1, None), True),
    ((None, 30.0, None, None, 0.1, None), False),
]


@pytest.mark.parametrize(("moved", "given"), EDGE)
def test_one_answer_and_a_batch_draw_the_same_line(
    moved: tuple[float | None, ...], given: bool
) -> None:
    for coverage, code in (("covered", COVERED), ("thin", 1), ("outside", 2)):
        answer = Answer(moved, (1.0,) * 6, coverage, "why", "griddata")  # pyright: ignore[reportArgumentType]
        found = within_limits(answer)
        many = Batch(np.array([moved], dtype=float), np.ones((1, 6)), np.array([code], np.uint8))
        many = within_limits_many(many)
        if given or coverage == "covered":
            assert found == answer
            assert np.isfinite(many.error).all()
        else:
            assert found == answer._replace(
                displacement=None, error=None, reason=f"why; {BEYOND_LIMITS}"
            )
            assert np.isnan(many.displacement).all()
            assert np.isnan(many.error).all()


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
        answer, packed = table.answer(wrench), packed_of(table).answer(wrench)
        assert (answer.displacement, answer.error) == (None, None)
        assert (packed.outputs, packed.error) == (None, None)
        assert BEYOND_LIMITS in answer.reason
        assert BEYOND_LIMITS in packed.reason
        assert answer.coverage == packed.coverage == "outside"
        found = table.batch([wrench])
        assert np.isnan(found.displacement).all()
        assert np.isnan(found.error).all()


def test_a_row_beyond_the_limits_answers_its_own_wrench() -> None:
    """No import takes one, but what a table has it tells."""
    rows = Rows.of([[0, 0, 3.0, 0, 0, 0]], [[0, 0, 30.0, 0, 0, 0]], source=np.array(["fea"]))
    answer = build(rows, _RANGE).answer(rows.wrench[0].tolist())
    assert (answer.method, answer.coverage) == ("row", "covered")
    assert answer.displacement == tuple(rows.displacement[0].tolist())


_RANGE = LoadRange(-np.ones(6), np.ones(6))
