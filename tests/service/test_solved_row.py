"""The reply of a solve and the table that holds its row later are one law."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from wrenchbook.service.tables.build import build_table, packed_bytes
from wrenchbook.service.tables.mapped import ServedTable, row_table
from wrenchbook.surrogate.kernel.binding import PackedTable
from wrenchbook.surrogate.solver_error import SolverError
from wrenchbook.surrogate.table.rows import LoadRange, Rows, joined

SCALE = np.array([100.0, 100, 500, 20, 20, 5])
RANGE = LoadRange(-SCALE, SCALE)
OTHERS = Rows.of(
    0.5 * np.eye(6) * SCALE, np.diag([3e-4] * 6), seq=np.arange(2, 8), source=["fea"] * 6
)
MESH = SolverError({"mesh": (1e-9 * np.eye(6)).tolist(), "loads": SCALE.tolist()})
COMPONENT: Any = SimpleNamespace(
    name="plate",
    fingerprint="f0",
    load_range=RANGE,
    tolerance=None,
    idle=(),
    linear=False,
    has_fea=True,
)
LINEAR: Any = SimpleNamespace(**{**vars(COMPONENT), "linear": True})


def row(wrench: np.ndarray, *, tangent: bool, bar: float = 1e-9) -> Rows:
    """A row that moves by a millionth of its wrench, as a deck's solve (no tangent) or another."""
    one = Rows.of(wrench[None], 1e-6 * wrench[None], seq=np.array([1]))
    slopes = 1e-6 * np.eye(6) if tangent else np.full((6, 6), np.nan)
    return replace(
        one,
        compliance=slopes[None],
        uncertainty=np.full((1, 6), bar),
        source=np.array(["fea"]),
    )


def served(rows: Rows, component: Any = COMPONENT) -> ServedTable:
    table = build_table(component, rows, 1)
    return ServedTable(PackedTable.from_bytes(packed_bytes(table, component)), built=table)


@pytest.mark.parametrize(
    ("tangent", "others"), [(True, Rows.empty()), (False, Rows.empty()), (False, OTHERS)]
)
def test_a_solves_reply_and_its_row_in_the_table_tell_the_same_error_bar(
    tangent: bool, others: Rows
) -> None:
    """Without a tangent the reply's error knew nothing of what other rows vary by."""
    solved = row(0.3 * SCALE * [1, 0, -1, 0, 0.5, 0], tangent=tangent)
    asked = (solved.wrench[0] + 4e-7 * SCALE).tolist()
    result = row_table(COMPONENT, solved, None, served(others)).packed.answer(asked)
    after = served(joined([solved, others])).packed.answer(asked)
    assert result == after
    assert result.method == "row"
    assert min(result.error) > 1e-9 or tangent


def test_a_row_at_rest_alone_tells_no_error_of_a_load_near_it() -> None:
    alone = row_table(COMPONENT, row(np.zeros(6), tangent=False), None, served(Rows.empty()))
    assert alone.packed.answer((4e-7 * SCALE).tolist()).error is None


@pytest.mark.parametrize("component", [COMPONENT, LINEAR])
def test_the_row_of_a_first_solve_has_no_error_before_its_meshs_is_known(component: Any) -> None:
    """It was exactly 0, and 1.4 mm after the second solve."""
    solved = row(0.3 * SCALE, tangent=True, bar=np.nan)
    asked = solved.wrench[0].tolist()
    empty = served(Rows.empty(), component)
    result = row_table(component, solved, None, empty).packed.answer(asked)
    assert (result.coverage, result.error, result.within_tolerance) == ("covered", None, None)
    assert result.interpolation == (0.0,) * 6
    assert served(solved, component).packed.answer(asked).error is None
    known = row_table(component, solved, MESH, empty).packed.answer(asked)
    np.testing.assert_allclose(known.error, 0.3e-9 * SCALE)
