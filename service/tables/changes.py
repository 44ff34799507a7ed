"""From what the ledger says happened to rows to the rows of a table."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from wrenchbook.service.ledger import LedgerRow, RowChanges
from wrenchbook.service.library.component import Component
from wrenchbook.surrogate.table.rows import Rows


def without(rows: Rows, row_changes: RowChanges) -> Rows:
    """Return rows without those that the row_changes take out, to come back or not."""
    return rows.take(~np.isin(rows.seq, list(row_changes.gone)))


def rows_for(component: Component, row_changes: RowChanges) -> Rows:
    """Return the row_changes' rows of this setup and measured ones.

    FEA rows of another setup are never mixed in.
    """
    return table_rows(
        row for row in row_changes.rows if row.fingerprint in ("", component.fingerprint)
    )


def table_rows(rows: Iterable[LedgerRow]) -> Rows:
    """Return rows of the ledger as those of a table."""
    return Rows.from_records(
        {
            "seq": row.seq,
            "wrench": row.wrench,
            "displacement": row.displacement,
            "compliance": row.compliance,
            "uncertainty": row.uncertainty,
            "source": row.source,
            "fingerprint": row.fingerprint,
        }
        for row in rows
    )
