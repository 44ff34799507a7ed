"""Rows of one component into another of the same setup."""

from __future__ import annotations

import time
from collections.abc import Iterator

from wrenchbook.service.ledger import About, Ledger, PackedRow, packed_columns
from wrenchbook.service.library.component import Component
from wrenchbook.service.tables.rows import export_rows, rows_for


def copy_rows(ledger: Ledger, source: Component, target: Component, about: About) -> int:
    """Copy the rows_for rows that a component has now; returns how many.

    Raises
    ------
    ImportRunningError, LedgerUnavailableError
        If they cannot be written now; none is copied then.
    """
    with ledger.table_at(source.name) as table:

        def blocks() -> Iterator[list[PackedRow]]:
            for lot in table.lots:
                rows = export_rows(rows_for(lot, source), ())
                columns = rows.wrench, rows.displacement, rows.uncertainty, rows.compliance
                texts = rows.source, rows.fingerprint, rows.note
                yield packed_columns(target.name, columns, texts, time.time())

        return ledger.import_rows(target.name, blocks(), about)[0]
