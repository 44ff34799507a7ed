"""Rows into the ledger: of table files, read in the sandbox, and of another component."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from wrenchbook.service.formats import Options, ParsedTable, ReadResult, read_untrusted
from wrenchbook.service.formats.rig import Rig
from wrenchbook.service.ledger import About, Ledger, row_keys
from wrenchbook.service.library.component import Component
from wrenchbook.service.tables.mapped import ServedTable
from wrenchbook.service.tables.rows import noted_rows
from wrenchbook.surrogate.findings.find import MOST
from wrenchbook.surrogate.table.compliance import fit_compliance


@dataclass(frozen=True)
class ImportRequest:
    """What is to become of a file's rows.

    Attributes
    ----------
    dry_run : bool
        Only count: nothing is changed.
    partial : bool
        Load the good rows though others have mistakes.
    preview : int
        Number of the first good rows in the reply.
    """

    dry_run: bool = False
    partial: bool = False
    preview: int = 0


def import_files(
    ledger: Ledger,
    component: Component,
    files: Sequence[Path],
    options: Options,
    request: ImportRequest,
    about: About,
) -> dict[str, Any]:
    """Read one table, or the logs of the loads and the displacements, and load its rows.

    Load range and fingerprint are the component's, not those of `options`.

    Returns the members of a reply: ``inserted``, ``existing``, ``errors``, ``rows`` and so on;
    ``loaded`` is whether rows were loaded.

    Raises
    ------
    SandboxBusyError, ImportRunningError, LedgerUnavailableError, OSError
        If it could not be read or written now; nothing was loaded.
    """
    own = replace(options, load_range=component.load_range, fingerprint=component.fingerprint)
    read = read_untrusted(files, own, request.preview)
    report = dict(read.report)
    refused = report.pop("whole") or bool(report["errors"] and not request.partial)
    inserted, existing, number = 0, 0, None
    if not refused and request.dry_run:
        inserted, existing = _counted(ledger, component, read)
    elif not refused:
        rows_of_file = (noted_rows(component, piece) for piece in read.pieces())
        about = replace(about, format=report["format"], rig=options.rig)
        about = replace(about, findings=_with_keys(component, read))
        inserted, existing, number = ledger.import_rows(component.name, rows_of_file, about)
    rows = report.pop("rows")
    good = rows.pop("good")
    return {
        "inserted": inserted,
        "existing": existing,
        "dry_run": request.dry_run,
        "partial": request.partial,
        "import": number,
        "rig": Rig.read(options.rig).as_json() if options.rig else None,
        "loaded": not refused and not request.dry_run,
        **report,
        "rows": {**rows, "loaded": 0 if refused or request.dry_run else good},
    }


def solved_compliance(component: Component, table: ServedTable) -> list[list[float]] | None:
    """Return the compliance (outputs, inputs), SI, of a component's solves; None if it has none.

    Columns of loads that they do not tell are zero.
    """
    if not component.has_fea or not table.sources.get("fea"):
        return None
    rows = table.rows
    solved = rows.take(np.flatnonzero(rows.source == "fea")[:MOST])
    fit = fit_compliance(solved, component.load_range, linear=component.linear)
    return np.where(fit.known, fit.matrix, 0.0).tolist()


def _with_keys(component: Component, read: ReadResult) -> str:
    """Return the findings of a file as JSON, with the keys of their rows instead of places."""
    findings = read.report["findings"]
    named = [row for one in findings for row in one["rows"]]
    keys: dict[int, str] = {}
    for piece in read.pieces() if named else ():
        some = piece.take(np.isin(piece.row, named))
        for number, key in zip(some.row.tolist(), _keys(component, some), strict=True):
            keys[number] = key.hex()
    return json.dumps(
        [{**one, "rows": [], "keys": [keys[k] for k in one["rows"]]} for one in findings]
    )


def _counted(ledger: Ledger, component: Component, read: ReadResult) -> tuple[int, int]:
    """Return how many rows would be new and how many are there already."""
    keys = [key for piece in read.pieces() for key in _keys(component, piece)]
    known = ledger.known_rows(keys)
    return len(keys) - known, known


def _keys(component: Component, piece: ParsedTable) -> list[bytes]:
    return row_keys(component.name, noted_rows(component, piece))


def copy_rows(ledger: Ledger, source: Component, target: Component, about: About) -> int:
    """Copy the rows of a component's present setup; return their number.

    Raises
    ------
    ImportRunningError, LedgerUnavailableError
        If they cannot be written now; none is copied then.
    """
    setup = {"space": source.space, "fingerprint": source.fingerprint}
    with ledger.table_at(source.name, **setup) as table:
        return ledger.import_rows(target.name, table.lots, about)[0]
