"""Outcomes as JSON or float64: the last step of the main call, the batch and DirectFEA."""

from __future__ import annotations

from typing import Any

import numpy as np
import orjson
from numpy.typing import NDArray
from starlette.responses import Response

from service.answering.queries import BatchOutcome, Outcome, WrenchJob
from service.http.binary import MEDIA_TYPE
from service.http.links import job_link

Floats = NDArray[np.float64]

COVERAGE = ("covered", "thin", "outside")


def json_reply(
    fields: dict[str, Any], status: int = 200, headers: dict[str, str] | None = None
) -> Response:
    """Write a body; what is not finite is null, never a number."""
    content = orjson.dumps(fields, option=orjson.OPT_SERIALIZE_NUMPY)
    return Response(content, status, headers, "application/json")


def write_outcome(outcome: Outcome, *, derivatives: bool = False) -> Response:
    """Answer one query, with du/dw if asked for: 200, or 202 while its solve has not answered."""
    value, error = outcome.displacement, outcome.error
    fields: dict[str, Any] = {
        "component": outcome.component,
        "translation": value[:3] if value else None,
        "rotation": value[3:] if value else None,
        "error": {"translation": error[:3], "rotation": error[3:]} if error else None,
        "coverage": outcome.coverage,
        "source": outcome.source,
        "method": outcome.method,
        "table_version": outcome.table_version,
        "elapsed_us": outcome.elapsed_us,
    }
    if outcome.reason:
        fields["reason"] = outcome.reason
    if outcome.missing:
        fields["missing"] = outcome.missing
    if outcome.row is not None:
        fields["row"] = outcome.row
    if outcome.notes:
        fields["notes"] = outcome.notes
    if derivatives:
        fields["derivative"] = _known(outcome.derivative)
    if outcome.axes is not None:
        fields["axes"] = outcome.axes
    if outcome.method_detail is not None:
        fields["method_detail"] = outcome.method_detail
    if outcome.job is not None:
        fields["job"] = job_link(outcome.job)
    if not outcome.unsolved:
        return json_reply(fields)
    job = fields.setdefault("job", None)
    return json_reply(fields, 202, {"Location": job["url"]} if job else None)


def write_batch(outcome: BatchOutcome) -> Response:
    """Answer a batch as JSON: 200, or 202 while a solve has not answered."""
    fields = {
        "component": outcome.component,
        "displacements": outcome.displacements,
        "errors": outcome.errors,
        "coverage": [COVERAGE[code] for code in outcome.coverage.tolist()],
        "jobs": [_wrench_job(one) for one in outcome.jobs],
        "method": outcome.method,
        "table_version": outcome.table_version,
        "elapsed_us": outcome.elapsed_us,
    }
    if outcome.derivatives is not None:
        fields["derivatives"] = [_known(one) for one in outcome.derivatives]
    return json_reply(fields, _status(outcome))


def write_binary(outcome: BatchOutcome) -> Response:
    """Answer a batch as little-endian float64 (n, 13), and (n, 36) if derivatives are asked for."""
    block = np.empty((len(outcome.coverage), 13), dtype="<f8")
    block[:, :6], block[:, 6:12] = outcome.displacements, outcome.errors
    block[:, 12] = outcome.coverage
    headers = {
        "Wrenchbook-Table-Version": str(outcome.table_version),
        "Wrenchbook-Method": outcome.method,
        "Wrenchbook-Elapsed-Us": f"{outcome.elapsed_us:.1f}",
        "Wrenchbook-Jobs": str(len({one.job.id for one in outcome.jobs if one.job})),
    }
    content = block.tobytes()
    if outcome.derivatives is not None:
        content += outcome.derivatives.astype("<f8").tobytes()
    return Response(content, _status(outcome), headers, MEDIA_TYPE)


def _wrench_job(one: WrenchJob) -> dict[str, Any]:
    if one.job is None:
        none = {"id": None, "status": None, "url": None, "reason": one.reason}
        return {"index": one.index, **none}
    return {"index": one.index, **job_link(one.job)}


def _known(derivative: Floats | None) -> Floats | None:
    """Return du/dw (6, 6), or None where none of it is known."""
    if derivative is None or np.isnan(derivative).all():
        return None
    return np.ascontiguousarray(derivative)  # all that orjson takes


def _status(outcome: BatchOutcome) -> int:
    return 202 if outcome.unsolved else 200
