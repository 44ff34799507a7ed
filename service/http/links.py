"""How replies point to other resources."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any
from urllib.parse import urlencode

from starlette.responses import Response

from wrenchbook.service.ledger import Job


def job_link(job: Job) -> dict[str, Any]:
    """Return the short form of a job, as displacement answers carry it."""
    return {"id": job.id, "status": job.status, "url": f"/v1/jobs/{job.id}"}


def next_page(response: Response, path: str, query: Mapping[str, Any]) -> str:
    """Return the URL of a list's next page, and put it into the header Link (RFC 8288)."""
    given = {name: "true" if value is True else value for name, value in query.items() if value}
    url = f"{path}?{urlencode(given)}"
    response.headers["Link"] = f'<{url}>; rel="next"'
    return url
