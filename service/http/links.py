"""How replies point to other resources."""

from __future__ import annotations

from typing import Any

from wrenchbook.service.ledger import Job


def job_link(job: Job) -> dict[str, Any]:
    """Return the short form of a job, as displacement answers carry it."""
    return {"id": job.id, "status": job.status, "url": f"/v1/jobs/{job.id}"}
