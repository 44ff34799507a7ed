"""Outcomes as JSON or float64: the last step of the main call, the batch and DirectFEA."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any
from urllib.parse import urlencode

import numpy as np
import orjson
from starlette.responses import Response, StreamingResponse

from wrenchbook.service.contract import COVERAGE, OUTPUTS
from wrenchbook.service.http.batch import BINARY_TYPE
from wrenchbook.service.messages import Message
from wrenchbook.service.query import BatchOutcome, Outcome, fields_of, job_link, known_slopes
from wrenchbook.surrogate.answer import within_tolerance_many

PIECE = 20_000  # wrenches laid out at once, in hundredths of a second


def json_reply(
    fields: dict[str, Any] | Message, status: int = 200, headers: dict[str, str] | None = None
) -> Response:
    """Write a body; what is not finite is null, never a number."""
    content = orjson.dumps(fields, option=orjson.OPT_SERIALIZE_NUMPY)
    return Response(content, status, headers, "application/json")


def next_page(response: Response, path: str, query: Mapping[str, Any]) -> str:
    """Return the URL of a list's next page, and put it into the header Link (RFC 8288)."""
    parameters = {
        name: "true" if value is True else value for name, value in query.items() if value
    }
    url = f"{path}?{urlencode(parameters)}"
    response.headers["Link"] = f'<{url}>; rel="next"'
    return url


def naming(tag: str) -> dict[str, str]:
    """Return the headers of a version: its entity tag, and that caches revalidate it."""
    return {"ETag": tag, "Cache-Control": "no-cache"}


def holds(if_none_match: str | None, tag: str) -> bool:
    """Return whether the caller has this version (RFC 9110, section 13.1.2)."""
    tags = [tag.strip().removeprefix("W/") for tag in (if_none_match or "").split(",")]
    return tag in tags or "*" in tags


def write_outcome(outcome: Outcome) -> Response:
    """Answer one query: 200, or 202 while its solve has not answered."""
    fields = fields_of(outcome)
    if not outcome.unsolved:
        return json_reply(fields)
    return json_reply(fields, 202, {"Location": fields["job"]["url"]} if fields["job"] else None)


def write_batch(outcome: BatchOutcome) -> Response:
    """Answer a batch as JSON: 200, or 202 while a solve has not answered.

    A large one is written in pieces: laying out millions of numbers keeps all others waiting.
    """
    fields: dict[str, Any] = {
        "component": outcome.component,
        "jobs": [
            {"index": place, "id": None, "status": None, "url": None, "reason": placed.reason}
            if placed.job is None
            else {"index": place, **job_link(placed.job)}
            for place, placed in outcome.jobs.items()
        ],
        "method": outcome.method,
        "table_version": outcome.table.version,
        "elapsed_us": outcome.elapsed_us,
    }
    if len(outcome.replies.coverage) <= PIECE:
        columns = {name: column(slice(None)) for name, column in _columns(outcome).items()}
        return json_reply({**columns, **fields}, _status(outcome))
    return StreamingResponse(_pieces(outcome, fields), _status(outcome), None, "application/json")


def _columns(outcome: BatchOutcome) -> dict[str, Callable[[slice], Any]]:
    """Return the lists of a batch with an entry a wrench, as functions of the wrenches' places."""
    replies, limit, slopes = outcome.replies, outcome.tolerance, outcome.derivatives
    columns: dict[str, Callable[[slice], Any]] = {
        "displacements": lambda some: replies.outputs[some],
        "errors": lambda some: replies.errors[some],
        "coverage": lambda some: [COVERAGE[code] for code in replies.coverage[some].tolist()],
    }
    if limit is not None:
        columns["within_tolerance"] = lambda some: within_tolerance_many(
            replies.errors[some], limit
        )
    if slopes is not None:
        columns["derivatives"] = lambda some: [known_slopes(matrix) for matrix in slopes[some]]
    return columns


def _pieces(outcome: BatchOutcome, fields: dict[str, Any]) -> Iterator[bytes]:
    yield orjson.dumps(fields)[:-1]
    for name, column in _columns(outcome).items():
        yield b',"%b":[' % name.encode()
        for start in range(0, len(outcome.replies.coverage), PIECE):
            some = column(slice(start, start + PIECE))
            content = orjson.dumps(some, option=orjson.OPT_SERIALIZE_NUMPY)
            yield (b"," if start else b"") + content[1:-1]
        yield b"]"
    yield b"}"


def write_binary(outcome: BatchOutcome) -> Response:
    """Answer a batch as little-endian float64: displacements, errors, coverage; derivatives."""
    displacements, errors, coverage = outcome.replies
    content = np.hstack((displacements, errors, coverage[:, None])).astype("<f8").tobytes()
    headers = {
        "Wrenchbook-Table-Version": str(outcome.table.version),
        "Wrenchbook-Method": outcome.method,
        "Wrenchbook-Elapsed-Us": f"{outcome.elapsed_us:.1f}",
        "Wrenchbook-Jobs": str(len({job.job.id for job in outcome.jobs.values() if job.job})),
    }
    if displacements.shape[1] != len(OUTPUTS):
        headers["Wrenchbook-Outputs"] = str(displacements.shape[1])
    if outcome.tolerance is not None:  # the block's form has no column for it
        limit = outcome.tolerance
        headers["Wrenchbook-Tolerance"] = f"{limit.translation!r}, {limit.rotation!r}"
    if outcome.derivatives is not None:
        content += outcome.derivatives.astype("<f8").tobytes()
    return Response(content, _status(outcome), headers, BINARY_TYPE)


def _status(outcome: BatchOutcome) -> int:
    return 202 if outcome.unsolved else 200
