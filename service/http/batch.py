"""Batches of wrenches: float64, small JSON, and large JSON, which a sandboxed process parses.

The parser holds Python's lock for seconds, and what it makes of a body may be forty times as large.
A mistake is a `HttpProblemError` of status 422 with the place of each mistake.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Iterator
from contextlib import AsyncExitStack, asynccontextmanager
from pathlib import Path
from typing import Annotated, Any, Final, cast

import numpy as np
import orjson
from fastapi import Request
from pydantic import Field
from starlette.responses import Response, StreamingResponse
from starlette.types import Receive, Scope, Send

from wrenchbook.fea.spec.schema import LARGEST_LOAD
from wrenchbook.service.contract import COVERAGE, MAX_BATCH, OUTPUTS, QUERY_WAIT_S
from wrenchbook.service.http.bodies import BatchBody, BinaryWidth, Body, Method, OnThin, query_of
from wrenchbook.service.http.body import (
    Spooled,
    both_tolerances,
    busy,
    checked,
    content_type,
    other_width,
    parsed_json,
    plain_rows,
    too_many_wrenches,
    with_wrenches,
)
from wrenchbook.service.http.openapi import BODIES
from wrenchbook.service.http.problems import HttpProblemError, bad_body
from wrenchbook.service.messages import Displacements, WrenchJob
from wrenchbook.service.query import BatchOutcome, Query, job_link, known_slopes
from wrenchbook.service.sandbox import MIB, Limits, Part, run
from wrenchbook.surrogate.answer import within_tolerance_many
from wrenchbook.surrogate.table.space import PER_INTERFACE, Space

# A million wrenches as Python's lists and numbers are 400 MB, next to the text of 250 MB.
LIMITS: Final = Limits(memory=1200 * MIB, seconds=60.0, output=256 * MIB)

PIECE: Final = 1 << 20  # bytes that the parser sees at once
WRITTEN: Final = 20_000  # wrenches laid out at once, in hundredths of a second
_COLUMNS: Final = {"displacements", "errors", "coverage", "within_tolerance", "derivatives"}
_WRENCHES: Final = b'"wrenches"'
LARGE: Final = 50_000  # wrenches: beyond it, an answer is tens of MB in several forms at once
WAIT_S: Final = 60.0  # of a large batch for its turn
AT_ONCE: Final = 2  # large batches: each takes a core and some 100 MB
MAX_OTHER_LISTS: Final = 64  # of a batch's JSON, beside its wrenches
MAX_OBJECTS: Final = 1024  # of a batch's JSON, which needs two: itself and its tolerance

BINARY_TYPE: Final = "application/octet-stream"
_Tolerance = Annotated[float, Field(gt=0, allow_inf_nan=False)]

_BYTES: Final = {"type": "string", "format": "binary"}
BINARY_BODY: Final = {BINARY_TYPE: {"schema": {**_BYTES, "description": BODIES["wrenches"]}}}
BINARY_REPLY: Final = {BINARY_TYPE: {"schema": {**_BYTES, "description": BODIES["displacements"]}}}


def read_batch_body(body: Spooled, inputs: int = PER_INTERFACE) -> tuple[np.ndarray, Query]:
    """Return the wrenches (n, inputs) and the options of a JSON batch, whatever its size.

    Raises HttpProblemError 422 with mistakes' places, and SandboxError or SandboxBusyError if it
    takes too much to be read, or too many others are being read.
    """
    if body.path is None:
        full, wrenches = batch_parts(body.content, inputs)
        return wrenches, full.query()
    (part,) = run("wrenchbook.service.http.batch:parsed", body.path, {"inputs": inputs}, LIMITS)
    if refused := part.fields["refused"]:
        detail = str(refused["body"].get("detail", ""))
        problem = HttpProblemError(int(refused["status"]), "", "", detail)
        problem.body = dict(refused["body"])
        raise problem
    full = BatchBody(wrenches=[], **part.fields["batch"])
    return np.array(part.arrays["wrenches"]), full.query()


def batch_parts(body: bytes, inputs: int = PER_INTERFACE) -> tuple[BatchBody, np.ndarray]:
    """Return the checked options of a JSON batch, and its wrenches, (n, inputs)."""
    # Checked before parsing: the parser takes 64 bytes for each list.
    lists, objects = body.count(b"["), body.count(b"{")
    if lists > MAX_BATCH + MAX_OTHER_LISTS:
        raise too_many_wrenches(lists - 1, MAX_BATCH)
    if objects > MAX_OBJECTS:
        message = f"has {objects} JSON objects; send one with wrenches, a list of lists of numbers"
        raise bad_body([{"loc": "body", "msg": message}])
    wrenches, full = with_wrenches(BatchBody, parsed_json(body), inputs, LARGEST_LOAD, MAX_BATCH)
    return full, wrenches


def parsed(path: Path, inputs: int) -> Iterator[Part]:
    """Read a JSON batch in the child: its options and its wrenches, or its refusal."""
    body = path.read_bytes()
    try:
        full, wrenches = in_pieces(body, inputs) or batch_parts(body, inputs)
    except HttpProblemError as error:
        yield Part({"refused": {"status": error.status, "body": error.body}})
    else:
        options = full.model_dump(exclude={"wrenches"})
        yield Part({"refused": None, "batch": options}, {"wrenches": np.asarray(wrenches)})


def in_pieces(body: bytes, inputs: int = PER_INTERFACE) -> tuple[BatchBody, np.ndarray] | None:
    """Return the parts of a plain body, which the parser sees by the megabyte; None for any other.

    Parsed at once, a text takes nine times its memory.
    """
    # The list of wrenches is body[start : end + 1], the options are all around it.
    key = body.find(_WRENCHES)
    end = body.rfind(b"]]") + 1
    start = body.find(b"[", key)
    if key < 0 or end <= start or body[key + len(_WRENCHES) : start].strip() != b":":
        return None
    options = body[:start] + b"[]" + body[end + 1 :]
    if len(options) > PIECE or options.count(_WRENCHES) != 1:
        return None

    blocks = []
    place = start + 1
    while place < end:
        cut = body.find(b"]", min(place + PIECE, end - 1)) + 1
        text = body[place:cut].strip()
        if blocks:
            if not text.startswith(b","):
                return None
            text = text[1:]
        try:
            block = plain_rows(orjson.loads(b"[" + text + b"]"), inputs)
        except orjson.JSONDecodeError:
            return None
        if block is None:
            return None
        blocks.append(block)
        place = cut

    wrenches = np.concatenate(blocks)
    if len(wrenches) > MAX_BATCH:
        raise too_many_wrenches(len(wrenches), MAX_BATCH)
    full, _ = batch_parts(options, inputs)
    return full, wrenches + 0.0


@asynccontextmanager
async def few_large(slots: asyncio.Semaphore, wrenches: int) -> AsyncIterator[None]:
    """Wait for one of the server's `AT_ONCE` slots if the batch is large; 503 after `WAIT_S`."""
    if wrenches < LARGE:
        yield
        return
    try:
        await asyncio.wait_for(slots.acquire(), WAIT_S)
    except TimeoutError:
        raise busy(
            f"{AT_ONCE} batches of {LARGE} wrenches or more, the limit, are being answered, and "
            f"this one waited {WAIT_S:g} s"
        ) from None
    try:
        yield
    finally:
        slots.release()


class HoldingReply(Response):
    """A reply that releases what `held` holds once it is sent, or cannot be sent.

    Only `__call__` is used; for a `DirectRoute`.
    """

    background = None

    def __init__(self, reply: Response, held: AsyncExitStack) -> None:
        self._reply = reply
        self._held = held

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send the reply."""
        async with self._held:
            await self._reply(scope, receive, send)


class BinaryOptions(Body):
    """The options of a binary batch, which are query parameters."""

    inputs: BinaryWidth = None
    on_thin: OnThin = "queue"
    wait_s: Annotated[float, Field(ge=0, le=3600, allow_inf_nan=False)] = QUERY_WAIT_S
    method: Method = None
    translation: _Tolerance | None = None
    rotation: _Tolerance | None = None
    beyond_range: bool = False
    derivatives: bool = False


def is_binary(request: Request) -> bool:
    """Whether a batch comes as float64."""
    return content_type(request) == BINARY_TYPE


def read_binary(body: Spooled, options: dict[str, str], space: Space) -> tuple[np.ndarray, Query]:
    """Return the wrenches and options of a binary batch, whose options are query parameters."""
    full: BinaryOptions = checked(BinaryOptions, options)
    wrenches = read_wrenches(body.read(), full.inputs, space)
    return wrenches, query_of(full, both_tolerances(full.translation, full.rotation))


def read_wrenches(
    body: bytes,
    width: int | None,
    space: Space,
    count: int = MAX_BATCH,
    largest: float = LARGEST_LOAD,
) -> np.ndarray:
    """Wrenches (n, inputs), SI, of little-endian float64, sent as `width` numbers each.

    Raises HttpProblemError 422 for another or an incomplete wrench, more than `count` wrenches, and
    a number that is not finite or beyond `largest`.
    """
    inputs = len(space.inputs)
    if body and width not in (None, inputs):
        raise other_width(0, width, inputs)
    if len(body) % (8 * inputs):
        message = f"{len(body)} bytes must be a multiple of {8 * inputs}, the bytes of a wrench"
        message += f"; send {inputs} little-endian float64 a wrench"
        raise bad_body([{"loc": "body", "msg": message}])
    if (sent := len(body) // (8 * inputs)) > count:
        raise too_many_wrenches(sent, count)
    wrenches = np.frombuffer(body, dtype="<f8").reshape(-1, inputs).astype(float) + 0.0
    bad = np.argwhere(~(np.isfinite(wrenches) & (np.abs(wrenches) <= largest)))
    if len(bad):
        row, load = bad[0].tolist()
        value = wrenches[row, load]
        unit = space.inputs[load].unit
        why = "not finite; give a finite number"
        if np.isfinite(value):
            why = f"beyond the limit of {largest:g} {unit}; give a smaller number"
        message = f"{space.input_names[load]} is {value:g} {unit}, {why}"
        raise bad_body([{"loc": f"wrenches.{row}.{load}", "msg": message}])
    return wrenches


def write_batch(outcome: BatchOutcome) -> Response:
    """Answer a batch as JSON: 200, or 202 while a solve has not answered.

    A large one is written in pieces: laying out millions of numbers keeps all others waiting.
    """
    replies, limit = outcome.replies, outcome.tolerance
    reply = Displacements(
        displacements=replies.outputs,
        errors=replies.errors,
        coverage=np.array(COVERAGE, dtype=object)[replies.coverage].tolist(),
        within_tolerance=None
        if limit is None
        else within_tolerance_many(replies.outputs, replies.errors, limit),
        derivatives=cast(Any, outcome.derivatives),
        component=outcome.component,
        jobs=[
            WrenchJob.of(
                {"index": place, "id": None, "status": None, "url": None, "reason": queued.reason}
                if queued.job is None
                else {"index": place, **job_link(queued.job, outcome.began)}
            )
            for place, queued in outcome.jobs.items()
        ],
        method=outcome.method,
        table_version=outcome.table.version,
        elapsed_us=outcome.elapsed_us,
    )
    status = 202 if outcome.unsolved else 200
    pieces = _pieces(reply, len(replies.coverage))
    if len(replies.coverage) <= WRITTEN:
        return Response(b"".join(pieces), status, None, "application/json")
    return StreamingResponse(pieces, status, None, "application/json")


def _pieces(reply: Displacements, count: int) -> Iterator[bytes]:
    """Lay out a reply's JSON; fields with an entry a wrench by `WRITTEN` of them."""
    option = orjson.OPT_SERIALIZE_NUMPY
    before = b"{"
    for name, value in vars(reply).items():
        yield b'%b"%b":' % (before, name.encode())
        before = b","
        if name not in _COLUMNS:
            yield orjson.dumps(value)
            continue
        for start in range(0, max(count, 1), WRITTEN):
            entries = value[start : start + WRITTEN]
            if name == "derivatives":
                entries = [known_slopes(matrix) for matrix in entries]
            yield (b"," if start else b"[") + orjson.dumps(entries, option=option)[1:-1]
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
    return Response(content, 202 if outcome.unsolved else 200, headers, BINARY_TYPE)
