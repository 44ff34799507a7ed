"""How replies refer to jobs, next pages and versions of tables."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any
from urllib.parse import urlencode

from starlette.responses import Response

from wrenchbook.service.ledger import JobRecord
from wrenchbook.service.messages import JobLink


def job_link(job: JobRecord, since: float | None = None) -> JobLink:
    """Return the short form of a job, as displacement answers carry it.

    `since`, the start of the request that queued it, s, adds whether the job is the request's own.
    """
    link = JobLink(id=job.id, status=job.status)
    return link if since is None else replace(link, new=job.created >= since)


def next_page(response: Response, path: str, query: Mapping[str, Any]) -> str:
    """Return the URL of a list's next page, and put it into the header Link (RFC 8288)."""
    given = {name: "true" if value is True else value for name, value in query.items() if value}
    url = f"{path}?{urlencode(given)}"
    response.headers["Link"] = f'<{url}>; rel="next"'
    return url


def naming(tag: str) -> dict[str, str]:
    """Return the headers of a version: its entity tag, and that caches revalidate it."""
    return {"ETag": tag, "Cache-Control": "no-cache"}


def holds(if_none_match: str | None, tag: str) -> bool:
    """Return whether the caller has this version (RFC 9110, section 13.1.2)."""
    tags = [tag.strip().removeprefix("W/") for tag in (if_none_match or "").split(",")]
    return tag in tags or "*" in tags
