"""Rows between table files and the ledger: what an import may insert, what an export holds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.ledger import Ledger, NewRow
from service.library.component import Component
from service.tablefile import ParsedTable, RowError

FEA = "fea"
MEASURED = "measured"


@dataclass(frozen=True)
class ExportRows:
    """A component's usable rows as table files hold them; arrays as in `ParsedTable`."""

    wrench: np.ndarray
    displacement: np.ndarray
    uncertainty: np.ndarray
    source: list[str]
    note: list[str]
    fingerprint: list[str]


def usable_rows(ledger: Ledger, component: Component) -> ExportRows:
    """Return a component's rows: those of its present setup and the measured ones."""
    rows = [
        row for row in ledger.rows(component.name) if row.fingerprint in ("", component.fingerprint)
    ]
    unknown = (np.nan,) * 6
    return ExportRows(
        wrench=np.array([row.wrench for row in rows]).reshape(-1, 6),
        displacement=np.array([row.displacement for row in rows]).reshape(-1, 6),
        uncertainty=np.array([row.uncertainty or unknown for row in rows]).reshape(-1, 6),
        source=[row.source for row in rows],
        note=[row.origin for row in rows],
        fingerprint=[row.fingerprint for row in rows],
    )


def foreign_rows(component: Component, table: ParsedTable) -> list[RowError]:
    """Name the rows of a file that are solves of another setup than the component's present one.

    Rows of different setups are never mixed: a row may say that it is a solve only together with
    the fingerprint of the setup that was solved, as exports write it.
    """
    errors = []
    for place in range(len(table)):
        fingerprint, source = table.fingerprint[place], table.source[place]
        if fingerprint == component.fingerprint or (not fingerprint and source != FEA):
            continue
        other = f"the setup {fingerprint}" if fingerprint else "a setup that the row does not name"
        errors.append(
            RowError(
                int(table.row[place]),
                "fingerprint",
                f"is a solve of {other}, this component's setup is {component.fingerprint}; rows "
                "of different setups are never mixed. Leave the row out, or load it as measured: "
                "an empty fingerprint and another source",
            )
        )
    return errors


def insert(
    ledger: Ledger, component: Component, table: ParsedTable, *, dry_run: bool
) -> tuple[int, int]:
    """Insert a file's rows in one transaction; return how many were new and how many known."""
    rows = [_new_row(table, place) for place in range(len(table))]
    return ledger.insert_rows(component.name, "", rows, dry_run=dry_run)


def _new_row(table: ParsedTable, place: int) -> NewRow:
    uncertainty = table.uncertainty[place]
    return NewRow(
        wrench=table.wrench[place].tolist(),
        displacement=table.displacement[place].tolist(),
        source=table.source[place] or MEASURED,
        # Where only some outputs have one, the others are taken as exact.
        uncertainty=(
            np.nan_to_num(uncertainty).tolist() if np.isfinite(uncertainty).any() else None
        ),
        origin=table.note[place],
        fingerprint=table.fingerprint[place],
    )
