"""The reply of a solve and the table that holds its row later are one law."""

from __future__ import annotations

import numpy as np
import pytest

from service.answering.solved import read_row
from service.ledger import LedgerRow
from service.tables.making import in_memory, packed_bytes
from service.tables.news import table_rows
from service.tables.served import ServedTable
from surrogate.build import build
from surrogate.table.rows import LoadRange, Rows, joined
from tests.surrogate.law.exact_rows import RowLaw

SCALE = np.array([100.0, 100, 500, 20, 20, 5])
RANGE = LoadRange(-SCALE, SCALE)
OTHERS = Rows.of(0.5 * np.eye(6) * SCALE, np.diag([3e-4] * 6), seq=np.arange(2, 8))


def row(wrench: np.ndarray, *, tangent: bool) -> LedgerRow:
    """A row that moves by a millionth of its wrench, as a deck's solve (no tangent) or another."""
    slopes = tuple(map(tuple, (1e-6 * np.eye(6)).tolist())) if tangent else None
    bar = (1e-9,) * 6
    moved = tuple((1e-6 * wrench).tolist())
    return LedgerRow(
        1, "plate", "f0", "fea", tuple(wrench.tolist()), moved, slopes, bar, 1, 0.0, ""
    )


def served(rows: Rows) -> ServedTable:
    table = build(rows, RANGE)
    return in_memory(table, packed_bytes(table, "plate", "f0"))


@pytest.mark.parametrize("tangent", [True, False])
@pytest.mark.parametrize("others", [Rows.empty(), OTHERS])
def test_a_solves_reply_and_its_row_in_the_table_tell_the_same_bar(
    tangent: bool, others: Rows
) -> None:
    """Without a tangent the reply's bar knew nothing of what other rows vary by."""
    solved = row(0.3 * SCALE * [1, 0, -1, 0, 0.5, 0], tangent=tangent)
    before = served(others)
    after = build(joined([table_rows([solved]), others]), RANGE)
    asked = np.array(solved.wrench) + 4e-7 * SCALE
    found = RowLaw(after.exact, RANGE, ()).at(asked.tolist(), [np.inf] * 6)
    assert found is not None
    displacement, error = read_row(solved, asked, before)
    np.testing.assert_array_equal(displacement, found.displacement)
    np.testing.assert_array_equal(error, found.error)
    assert (error > 1e-9).all() or tangent


def test_a_row_at_rest_alone_tells_no_bar_of_a_load_beside_it() -> None:
    solved = row(np.zeros(6), tangent=False)
    assert np.isnan(read_row(solved, 4e-7 * SCALE, served(Rows.empty()))[1]).all()
