"""One row of a component's table: its provenance; withdraw it, restore it."""

from __future__ import annotations

import math
from typing import Annotated, Any

from fastapi import Path

from wrenchbook.fea.bundle.read import BundleError, read_bundle
from wrenchbook.service.http.openapi import component_router, refused
from wrenchbook.service.http.routes import Opened
from wrenchbook.service.ledger import ImportRecord, LedgerRow, UnknownRowError
from wrenchbook.service.library.component import Component
from wrenchbook.service.tables.rows import iso_time
from wrenchbook.service.workspace import CATCH_UP_S, Workspace

router = component_router("table", "/table/{row}")

# The ledger's numbers are SQLite's: 64 bits with a sign.
RowId = Annotated[int, Path(ge=1, lt=2**63)]
_EDITS = refused(s409="the row is already withdrawn, or already in the table")


@router.get("")
def get_row(name: str, row: RowId, workspace: Opened) -> dict[str, Any]:
    """Show a row and its provenance."""
    return row_body(workspace, workspace.library[name], row)


@router.delete("", responses=_EDITS)
def withdraw_row(name: str, row: RowId, workspace: Opened) -> dict[str, Any]:
    """Withdraw a row."""
    return _edited(workspace, name, row, withdrawn=True)


@router.post("/restore", responses=_EDITS)
def restore_row(name: str, row: RowId, workspace: Opened) -> dict[str, Any]:
    """Restore a withdrawn row."""
    return _edited(workspace, name, row, withdrawn=False)


def _edited(workspace: Workspace, name: str, row: int, *, withdrawn: bool) -> dict[str, Any]:
    workspace.ledger.withdraw(workspace.library[name].name, row, withdrawn=withdrawn)
    current = workspace.tables.catch_up(name, CATCH_UP_S)
    return {
        "component": name,
        "row": row,
        "status": "withdrawn" if withdrawn else "restored",
        "table_version": workspace.tables.surrogate(name).version,
        "current": current,
    }


def row_body(workspace: Workspace, component: Component, seq: int) -> dict[str, Any]:
    """Return a component's row with its provenance; raises UnknownRowError if it has none."""
    row = workspace.ledger.row(seq)
    if row.component != component.name:
        raise UnknownRowError(
            f"the table of {component.name!r} has no row {seq}; GET /v1/components/"
            f"{component.name}/table lists its rows"
        )
    loaded = workspace.ledger.import_of(seq)
    job = None if row.job is None else workspace.ledger.job(row.job)
    return {
        "row": row.seq,
        "wrench": list(row.wrench),
        "displacement": _nulls(row.displacement),
        "uncertainty": _nulls(row.uncertainty) if row.uncertainty else None,
        "compliance": row.compliance,
        "curvature": row.curvature,
        "source": row.source,
        "withdrawn": workspace.ledger.is_withdrawn(seq),
        "provenance": {
            "when": iso_time(row.created),
            "note": row.origin,
            "import": file_fields(loaded) if loaded else None,
            "job": job
            and {
                "id": job.id,
                "url": f"/v1/jobs/{job.id}",
                "log": f"/v1/jobs/{job.id}/files",
                "asked_by": job.asked_by,
                "engine": job.engine,
                "attempts": job.attempt,
                "started": iso_time(job.started) if job.started else None,
                "finished": iso_time(job.finished) if job.finished else None,
            },
            "setup": _setup(component, row) if row.fingerprint else None,
        },
    }


def _nulls(values: tuple[float, ...]) -> list[float | None]:
    return [None if math.isnan(value) else value for value in values]


def file_fields(record: ImportRecord) -> dict[str, Any]:
    """Return the fields of `FileImport` in library.py: sender and file of imported rows."""
    return {
        "id": record.id,
        "who": record.who,
        "filename": record.filename,
        "format": record.format,
        "sha256": record.digest,
        "note": record.note,
        "rig": record.rig,
    }


def _setup(component: Component, row: LedgerRow) -> dict[str, Any]:
    """Return the setup of a solved row; of an earlier setup only the fingerprint is known."""
    is_present = row.fingerprint == component.fingerprint
    body: dict[str, Any] = {"fingerprint": row.fingerprint, "present": is_present}
    if not is_present:
        return body
    try:
        bundle = read_bundle(component.folder)
    except (BundleError, OSError):
        return body
    mesh = bundle.mesh
    return body | {
        "solver": "deck" if bundle.deck is not None else "embedded",
        "nonlinear": bundle.analysis.nonlinear,
        "mesh": {
            "file": mesh.file.name if mesh and mesh.file else None,
            "generator": mesh.generator if mesh else None,
        },
        "materials": [
            {
                "region": material.region,
                "youngs_modulus": material.youngs_modulus,
                "poisson_ratio": material.poisson_ratio,
            }
            for material in bundle.materials
        ],
    }
