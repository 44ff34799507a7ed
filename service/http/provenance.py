"""Where a row comes from: who sent it and when, or which solve of which setup it is."""

from __future__ import annotations

import math
from typing import Any

from fea.bundle.read import BundleError, read_bundle
from service.ledger import LedgerRow, UnknownRowError
from service.library.component import Component
from service.tables.rows import told_time
from service.workspace import Workspace


def row_told(workspace: Workspace, component: Component, seq: int) -> dict[str, Any]:
    """Return a row of a component, with its provenance.

    Raises
    ------
    UnknownRowError
        If the component has no such row.
    """
    row = workspace.ledger.row(seq)
    if row.component != component.name:
        raise UnknownRowError(f"the table of {component.name!r} has no row {seq}")
    return {
        "row": row.seq,
        "wrench": list(row.wrench),
        "displacement": _nulls(row.displacement),
        "uncertainty": _nulls(row.uncertainty) if row.uncertainty else None,
        "compliance": row.compliance,
        "source": row.source,
        "withdrawn": workspace.ledger.is_withdrawn(seq),
        "provenance": {
            "when": told_time(row.created),
            "note": row.origin,
            "import": _import(workspace, seq),
            "job": _job(workspace, row),
            "setup": _setup(component, row) if row.fingerprint else None,
        },
    }


def _nulls(values: tuple[float, ...]) -> list[float | None]:
    return [None if math.isnan(value) else value for value in values]


def _import(workspace: Workspace, seq: int) -> dict[str, Any] | None:
    found = workspace.ledger.import_of(seq)
    if found is None:
        return None
    return {
        "id": found.id,
        "who": found.who,
        "filename": found.filename,
        "format": found.format,
        "sha256": found.digest,
        "note": found.note,
    }


def _job(workspace: Workspace, row: LedgerRow) -> dict[str, Any] | None:
    if row.job is None:
        return None
    job = workspace.ledger.job(row.job)
    return {
        "id": job.id,
        "url": f"/v1/jobs/{job.id}",
        "log": f"/v1/jobs/{job.id}/files",
        "asked_by": job.asked_by,
        "engine": job.engine,
        "attempts": job.attempt,
        "started": told_time(job.started) if job.started else None,
        "finished": told_time(job.finished) if job.finished else None,
    }


def _setup(component: Component, row: LedgerRow) -> dict[str, Any]:
    """Return the setup that was solved; of an earlier one only its fingerprint is known."""
    told: dict[str, Any] = {
        "fingerprint": row.fingerprint,
        "present": row.fingerprint == component.fingerprint,
    }
    if not told["present"]:
        return told
    try:
        bundle = read_bundle(component.folder)
    except (BundleError, OSError):
        return told
    mesh = bundle.mesh
    return told | {
        "solver": "deck" if bundle.deck is not None else "embedded",
        "nonlinear": bundle.analysis.nonlinear,
        "mesh": {
            "file": mesh.file.name if mesh is not None and mesh.file is not None else None,
            "generator": mesh.generator if mesh is not None else None,
        },
        "materials": [
            {
                "region": one.region,
                "youngs_modulus": one.youngs_modulus,
                "poisson_ratio": one.poisson_ratio,
            }
            for one in bundle.materials
        ],
    }
