"""Rows between table files and the ledger: what an import may insert, what an export holds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.contract import CONTRACT
from service.ledger import Ledger, NewRow
from service.library.component import Component
from service.tablefile import ParsedTable, RowError
from surrogate.table.hdf5 import TableMeta

FEA = "fea"
MEASURED = "measured"


@dataclass(frozen=True)
class ExportRows:
    """A component's usable rows as table files hold them.

    Attributes
    ----------
    seq : list of int
        The ledger's number of each row.
    wrench : ndarray, shape (n, 6), N and N·m
    displacement, uncertainty : ndarray, shape (n, 6), m and rad
        NaN where not measured, not known.
    compliance : ndarray, shape (n, 6, 6), m and rad over N and N·m
        NaN where not known.
    source, note, fingerprint : list of str
    version : int
        The table's version: the number of the ledger's newest change of it.
    """

    seq: list[int]
    wrench: np.ndarray
    displacement: np.ndarray
    uncertainty: np.ndarray
    compliance: np.ndarray
    source: list[str]
    note: list[str]
    fingerprint: list[str]
    version: int


def usable_rows(ledger: Ledger, component: Component) -> ExportRows:
    """Return a component's rows: those of its present setup and the measured ones."""
    news = ledger.news(component.name, 0)  # rows and version as one committed state
    rows = [row for row in news.rows if row.fingerprint in ("", component.fingerprint)]
    unknown, no_tangent = (np.nan,) * 6, ((np.nan,) * 6,) * 6
    return ExportRows(
        seq=[row.seq for row in rows],
        wrench=np.array([row.wrench for row in rows]).reshape(-1, 6),
        displacement=np.array([row.displacement for row in rows]).reshape(-1, 6),
        uncertainty=np.array([row.uncertainty or unknown for row in rows]).reshape(-1, 6),
        compliance=np.array([row.compliance or no_tangent for row in rows]).reshape(-1, 6, 6),
        source=[row.source for row in rows],
        note=[row.origin for row in rows],
        fingerprint=[row.fingerprint for row in rows],
        version=news.last_seq,
    )


def table_meta(component: Component, rows: ExportRows) -> TableMeta:
    """Return what an HDF5 export says about its rows."""
    return TableMeta(
        component=component.name,
        last_seq=rows.version,
        load_range=component.load_range,
        fingerprint=component.fingerprint,
        title=component.title,
        tolerance=component.tolerance,
        linear=component.linear,
        contract=" ".join(f"{word}: {meaning}." for word, meaning in CONTRACT.items()),
    )


def misplaced_rows(component: Component, table: ParsedTable) -> list[RowError]:
    """Name the rows of a file that may not stand in this component's table as what they say.

    Rows of different setups are never mixed. A row with the component's own fingerprint is loaded
    as what it says it is, with its tangent: so an export of solves comes back as solves. A row
    with another fingerprint, or one that says it is a solve and names no setup, is refused rather
    than loaded as measured: it would be a solve of another mesh under a false name, and whoever
    knows better can write the other name into the file. A row without a fingerprint is a
    measurement or a solve from elsewhere; its tangent is taken as its displacement is.
    """
    errors = []
    for place in range(len(table)):
        fingerprint, source = table.fingerprint[place], table.source[place]
        row = int(table.row[place])
        if fingerprint != component.fingerprint and (fingerprint or source == FEA):
            errors.append(RowError(row, "fingerprint", _foreign(component, fingerprint)))
        elif source == FEA and np.isnan(table.displacement[place]).any():
            message = "a solve knows all six outputs; write them, or another source than fea"
            errors.append(RowError(row, "source", message))
    return errors


def _foreign(component: Component, fingerprint: str) -> str:
    other = f"the setup {fingerprint}" if fingerprint else "a setup that the row does not name"
    return (
        f"is a solve of {other}, this component's setup is {component.fingerprint}; rows "
        "of different setups are never mixed. Leave the row out, or load it as measured: "
        "an empty fingerprint and another source"
    )


def insert(
    ledger: Ledger, component: Component, table: ParsedTable, *, dry_run: bool
) -> tuple[int, int]:
    """Insert a file's rows in one transaction; return how many were new and how many known."""
    rows = (_new_row(table, place) for place in range(len(table)))
    return ledger.insert_rows(component.name, "", rows, dry_run=dry_run)


def _new_row(table: ParsedTable, place: int) -> NewRow:
    uncertainty, compliance = table.uncertainty[place], table.compliance[place]
    return NewRow(
        wrench=table.wrench[place].tolist(),
        displacement=table.displacement[place].tolist(),
        source=table.source[place] or MEASURED,
        compliance=compliance.tolist() if np.isfinite(compliance).all() else None,
        uncertainty=uncertainty.tolist() if np.isfinite(uncertainty).any() else None,
        origin=table.note[place],
        fingerprint=table.fingerprint[place],
    )
