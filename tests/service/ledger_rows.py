"""Single rows into a ledger and out of it, for tests."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from wrenchbook.service.ledger import JobRecord, Ledger, LedgerRow, NotedRows
from wrenchbook.surrogate.table.rows import Rows
from wrenchbook.surrogate.table.space import DEFAULT, Space


@dataclass(frozen=True)
class NewRow:
    """A row to be inserted; its columns are those of `Rows`, SI, with a note."""

    wrench: Sequence[float]
    displacement: Sequence[float]
    source: str = "measured"
    compliance: Sequence[Sequence[float]] | None = None
    uncertainty: Sequence[float] | None = None
    origin: str = ""
    fingerprint: str | None = None
    curvature: Sequence[float] | None = None


def claim(ledger: Ledger, owner: str, engine: str = "local") -> JobRecord | None:
    """Start the next waiting job's next attempt under `owner`; None if none waits."""
    claimed = ledger.claim_many(owner, engine, 1)
    return claimed[0] if claimed else None


def new_rows(count: int, first: int = 0) -> list[NewRow]:
    """Rows that lie on a grid of the first and the last load."""
    return [
        NewRow((i % 10, 0, 0, 0, 0, i // 10), (i * 1e-6, 0, 0, 0, 0, 1e-7))
        for i in range(first, first + count)
    ]


def noted(new: Iterable[NewRow], fingerprint: str = "", space: Space = DEFAULT) -> NotedRows:
    """Rows as columns; those without a fingerprint get the one given."""
    rows = list(new)
    loads, outputs = len(space.inputs), len(space.outputs)
    shapes = {"compliance": (outputs, loads), "uncertainty": (outputs,)}
    columns: dict[str, Any] = {
        "source": [row.source for row in rows],
        "fingerprint": [
            fingerprint if row.fingerprint is None else row.fingerprint for row in rows
        ],
    }
    for name, shape in {**shapes, "curvature": (space.curvatures,)}.items():
        unknown, values = np.full(shape, np.nan), [getattr(row, name) for row in rows]
        if any(value is not None for value in values):
            columns[name] = [unknown if value is None else value for value in values]
    moved = Rows.of(
        [row.wrench for row in rows], [row.displacement for row in rows], space, **columns
    )
    return NotedRows(moved, [row.origin for row in rows])


def insert(
    ledger: Ledger,
    component: str,
    fingerprint: str,
    new: Iterable[NewRow],
    above: int = 0,
    space: Space = DEFAULT,
) -> tuple[int, int]:
    """Insert rows; return how many were new and how many known."""
    block = noted(new, fingerprint, space)
    return ledger.insert_rows(component, block.rows, block.note, above=above)


def stored(
    ledger: Ledger,
    component: str,
    fingerprint: str | None = None,
    after: int = 0,
    space: Space = DEFAULT,
) -> list[LedgerRow]:
    """A component's rows with a seq above `after`, by seq, without withdrawn and damaged ones."""
    changes = ledger.row_changes(component, after, 10**9, space=space)
    rows = ledger.rows_of(changes.rows.seq.tolist())
    return [
        rows[seq]
        for seq in sorted(rows)
        if seq > after and fingerprint in (None, rows[seq].fingerprint)
    ]
