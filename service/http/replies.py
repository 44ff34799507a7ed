"""Outcomes as JSON or float64: the last step of the main call, the batch and DirectFEA."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import orjson
from numpy.typing import NDArray
from starlette.responses import Response, StreamingResponse

from wrenchbook.service.answering.queries import BatchOutcome, Outcome, QueuedWrench
from wrenchbook.service.contract import COVERAGE, OUTPUTS, by_part
from wrenchbook.service.http.batch import BINARY_TYPE
from wrenchbook.service.http.links import job_link
from wrenchbook.service.messages import Message
from wrenchbook.surrogate.answer import within_tolerance_many

Floats = NDArray[np.float64]

PIECE = 20_000  # wrenches laid out at once, in hundredths of a second


def json_reply(
    fields: dict[str, Any] | Message, status: int = 200, headers: dict[str, str] | None = None
) -> Response:
    """Write a body; what is not finite is null, never a number."""
    content = orjson.dumps(fields, option=orjson.OPT_SERIALIZE_NUMPY)
    return Response(content, status, headers, "application/json")


def write_outcome(outcome: Outcome, *, derivatives: bool = False) -> Response:
    """Answer one query, with du/dw on request: 200, or 202 while its solve has not answered."""
    fields = _fields(outcome)
    if derivatives:
        fields["derivative"] = _known(outcome.derivative)
    if outcome.axes is not None:
        fields["axes"] = outcome.axes
    if outcome.method_detail is not None:
        fields["method_detail"] = outcome.method_detail
    if outcome.error_parts is not None:
        fields["error_parts"] = outcome.error_parts
    if outcome.error_of_a_reading is not None:
        fields["error_of_a_reading"] = outcome.error_of_a_reading
    if outcome.job is not None:
        fields["job"] = job_link(outcome.job, outcome.began)
    if not outcome.unsolved:
        return json_reply(fields)
    job = fields.setdefault("job", None)
    return json_reply(fields, 202, {"Location": job.url} if job else None)


def plain_content(outcome: Outcome) -> bytes:
    """Return the body that `write_outcome` gives an outcome that is the table's alone."""
    return orjson.dumps(_fields(outcome))


def _fields(outcome: Outcome) -> dict[str, Any]:
    """Return the fields of every answer."""
    value, error = outcome.displacement, outcome.error
    if outcome.interfaces:
        moved: dict[str, Any] = {"displacements": _by_interface(outcome)}
    else:
        moved = {
            "translation": value[:3] if value else None,
            "rotation": value[3:] if value else None,
            "error": by_part(error) if error else None,
        }
    fields: dict[str, Any] = {
        "component": outcome.component,
        **moved,
        "coverage": outcome.coverage,
        "within_tolerance": outcome.within_tolerance,
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
    return fields


def _by_interface(outcome: Outcome) -> dict[str, Any]:
    """Return displacement and error bar of each interface."""
    names, unknown = outcome.interfaces, {"translation": None, "rotation": None}
    moved = by_part(outcome.displacement, names) if outcome.displacement else {}
    errors = by_part(outcome.error, names) if outcome.error else {}
    return {name: moved.get(name, unknown) | {"error": errors.get(name)} for name in names}


def write_batch(outcome: BatchOutcome) -> Response:
    """Answer a batch as JSON: 200, or 202 while a solve has not answered.

    A large one is written in pieces: laying out millions of numbers keeps all others waiting.
    """
    fields: dict[str, Any] = {
        "component": outcome.component,
        "jobs": [_wrench_job(one) for one in outcome.jobs],
        "method": outcome.method,
        "table_version": outcome.table_version,
        "elapsed_us": outcome.elapsed_us,
    }
    if len(outcome.coverage) <= PIECE:
        lists = {name: list_(0, PIECE) for name, list_ in _lists(outcome).items()}
        return json_reply({**lists, **fields}, _status(outcome))
    return StreamingResponse(_pieces(outcome, fields), _status(outcome), None, "application/json")


def _lists(outcome: BatchOutcome) -> dict[str, Callable[[int, int], Any]]:
    """Return the lists of a batch with an entry a wrench, as functions of start and end."""
    codes = outcome.coverage
    lists: dict[str, Callable[[int, int], Any]] = {
        "displacements": lambda start, end: outcome.displacements[start:end],
        "errors": lambda start, end: outcome.errors[start:end],
        "coverage": lambda start, end: [COVERAGE[code] for code in codes[start:end].tolist()],
    }
    if outcome.tolerance is not None:
        lists["within_tolerance"] = lambda start, end: within_tolerance_many(
            outcome.errors[start:end], outcome.tolerance
        )
    slopes = outcome.derivatives
    if slopes is not None:
        lists["derivatives"] = lambda start, end: [_known(one) for one in slopes[start:end]]
    return lists


def _pieces(outcome: BatchOutcome, fields: dict[str, Any]) -> Iterator[bytes]:
    yield orjson.dumps(fields)[:-1]
    for name, list_ in _lists(outcome).items():
        yield b',"%b":[' % name.encode()
        for start in range(0, len(outcome.coverage), PIECE):
            some = orjson.dumps(list_(start, start + PIECE), option=orjson.OPT_SERIALIZE_NUMPY)
            yield (b"," if start else b"") + some[1:-1]
        yield b"]"
    yield b"}"


def write_binary(outcome: BatchOutcome) -> Response:
    """Answer a batch as little-endian float64: displacements, errors, coverage; derivatives."""
    columns = outcome.displacements, outcome.errors, outcome.coverage[:, None]
    block = np.hstack(columns).astype("<f8")
    headers = {
        "Wrenchbook-Table-Version": str(outcome.table_version),
        "Wrenchbook-Method": outcome.method,
        "Wrenchbook-Elapsed-Us": f"{outcome.elapsed_us:.1f}",
        "Wrenchbook-Jobs": str(len({one.job.id for one in outcome.jobs if one.job})),
    }
    if outcome.displacements.shape[1] != len(OUTPUTS):
        headers["Wrenchbook-Outputs"] = str(outcome.displacements.shape[1])
    if outcome.tolerance is not None:  # the block's form has no column for it
        limit = outcome.tolerance
        headers["Wrenchbook-Tolerance"] = f"{limit.translation!r}, {limit.rotation!r}"
    content = block.tobytes()
    if outcome.derivatives is not None:
        content += outcome.derivatives.astype("<f8").tobytes()
    return Response(content, _status(outcome), headers, BINARY_TYPE)


def _wrench_job(one: QueuedWrench) -> dict[str, Any]:
    if one.job is None:
        none = {"id": None, "status": None, "url": None, "reason": one.reason}
        return {"index": one.index, **none}
    return {"index": one.index, **vars(job_link(one.job))}


def _known(derivative: Floats | None) -> Floats | None:
    """Return du/dw (6, 6), or None where none of it is known."""
    if derivative is None or np.isnan(derivative).all():
        return None
    return np.ascontiguousarray(derivative)  # all that orjson takes


def _status(outcome: BatchOutcome) -> int:
    return 202 if outcome.unsolved else 200
