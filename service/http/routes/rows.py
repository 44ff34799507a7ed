"""Routes of one row of a table: show it with its provenance, withdraw it, restore it."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import Path
from starlette.responses import Response

from wrenchbook.fea.bundle.read import BundleError, read_bundle
from wrenchbook.service.contract import NUMBER_LIMIT
from wrenchbook.service.http.openapi import component_router, refused
from wrenchbook.service.http.routes import Opened, json_reply
from wrenchbook.service.ledger import ImportRecord, LedgerRow, UnknownRowError
from wrenchbook.service.library.component import Component
from wrenchbook.service.tables.rows import iso_time
from wrenchbook.service.workspace import CATCH_UP_S, Workspace

router = component_router("table", "/table/{row}")

RowId = Annotated[int, Path(ge=1, lt=NUMBER_LIMIT)]
_CONFLICTS = refused(s409="the row is already withdrawn, or already in the table")


@router.get("", response_model=dict[str, Any])
def get_row(name: str, row: RowId, workspace: Opened) -> Response:
    """Show a row and its provenance."""
    component = workspace.library[name]
    stored = workspace.ledger.row(row)
    if stored.component != component.name:
        raise UnknownRowError(
            f"the table of {component.name!r} has no row {row}; GET /v1/components/"
            f"{component.name}/table lists its rows"
        )
    loaded = workspace.ledger.import_of(row)
    job = None if stored.job is None else workspace.ledger.job(stored.job)
    fields = {
        "row": stored.seq,
        "wrench": list(stored.wrench),
        "displacement": stored.displacement,
        "uncertainty": stored.uncertainty or None,
        "compliance": stored.compliance,
        "curvature": stored.curvature,
        "source": stored.source,
        "withdrawn": workspace.ledger.is_withdrawn(row),
        "provenance": {
            "when": iso_time(stored.created),
            "note": stored.origin,
            "import": file_fields(loaded) if loaded else None,
            "job": None
            if job is None
            else {
                "id": job.id,
                "url": f"/v1/jobs/{job.id}",
                "log": f"/v1/jobs/{job.id}/files",
                "asked_by": job.asked_by,
                "engine": job.engine,
                "attempts": job.attempt,
                "started": iso_time(job.started) if job.started else None,
                "finished": iso_time(job.finished) if job.finished else None,
            },
            "setup": _setup(component, stored) if stored.fingerprint else None,
        },
    }
    return json_reply(fields)


@router.delete("", responses=_CONFLICTS)
def withdraw_row(name: str, row: RowId, workspace: Opened) -> dict[str, Any]:
    """Withdraw a row."""
    return _edit_row(workspace, name, row, withdrawn=True)


@router.post("/restore", responses=_CONFLICTS)
def restore_row(name: str, row: RowId, workspace: Opened) -> dict[str, Any]:
    """Restore a withdrawn row."""
    return _edit_row(workspace, name, row, withdrawn=False)


def _edit_row(workspace: Workspace, name: str, row: int, *, withdrawn: bool) -> dict[str, Any]:
    """Write a row's new state, wait for the table, and return the reply."""
    workspace.ledger.withdraw(workspace.library[name].name, row, withdrawn=withdrawn)
    is_current = workspace.tables.catch_up(name, CATCH_UP_S)
    return {
        "component": name,
        "row": row,
        "status": "withdrawn" if withdrawn else "restored",
        "table_version": workspace.tables.surrogate(name).version,
        "current": is_current,
    }


def file_fields(record: ImportRecord) -> dict[str, Any]:
    """Return the fields of an import's file and sender, as `FileImport` in library.py."""
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
    """Return the setup of a solved row; the fingerprint alone if it is not the present one."""
    is_present = row.fingerprint == component.fingerprint
    body: dict[str, Any] = {"fingerprint": row.fingerprint, "present": is_present}
    if not is_present:
        return body
    try:
        bundle = read_bundle(component.folder)
    except (BundleError, OSError):  # the files have been changed or removed since they were read
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
