"""Batches of wrenches: float64, small JSON, and large JSON, which a sandboxed process parses.

The parser holds Python's lock for seconds, and what it makes of a body may be forty times as large.
A mistake is a `HttpProblemError` of status 422 with the place of each mistake.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Annotated, Any, Final

import numpy as np
import orjson
from fastapi import Request
from pydantic import Field

from wrenchbook.fea.bundle.tables import LARGEST_LOAD
from wrenchbook.service.contract import MAX_BATCH
from wrenchbook.service.http.bodies import (
    BatchBody,
    Body,
    Derivatives,
    Flag,
    OnThin,
    Seconds,
)
from wrenchbook.service.http.body import Spooled, busy
from wrenchbook.service.http.parsing import (
    both_tolerances,
    checked,
    even_rows,
    known_method,
    parsed_json,
    plain_rows,
    plain_wrenches,
    query_of,
)
from wrenchbook.service.http.problems import HttpProblemError, bad_body
from wrenchbook.service.query import Query
from wrenchbook.service.sandbox import MIB, Limits, Part, run
from wrenchbook.surrogate.table.space import DEFAULT, PER_INTERFACE, Space

# A million wrenches as Python's lists and numbers are 400 MB, next to the text of 250 MB.
LIMITS: Final = Limits(memory=1200 * MIB, seconds=60.0, output=256 * MIB)

PIECE: Final = 1 << 20  # bytes that the parser sees at once
_WRENCHES: Final = b'"wrenches"'
LARGE: Final = 50_000  # wrenches: beyond it, an answer is tens of MB in several forms at once
WAIT_S: Final = 60.0
_places = asyncio.Semaphore(2)

BINARY_TYPE: Final = "application/octet-stream"
_Bar = Annotated[float, Field(gt=0, allow_inf_nan=False)]

BINARY_BODY: Final = {
    BINARY_TYPE: {
        "schema": {
            "type": "string",
            "format": "binary",
            "description": "little-endian float64 (n, 6): force and moment, N and N·m; of several "
            "interfaces and further inputs their number, in the order of the component's inputs",
        }
    }
}
BINARY_REPLY: Final = {
    BINARY_TYPE: {
        "schema": {
            "type": "string",
            "format": "binary",
            "description": "little-endian float64 (n, 13): displacement and error bar, m and rad; "
            "coverage 0 covered, 1 thin, 2 outside; NaN where nothing is known. With "
            "derivatives=true then (n, 36): du/dw of each wrench, 6 x 6, an output a line (of n "
            "inputs and m outputs 2m + 1 and m n numbers a wrench). The header "
            "Wrenchbook-Tolerance has the tolerance for whole bars, m and rad",
        }
    }
}
_JSONS = Field(description="binary form: as in JSON")


def read_batch_body(body: Spooled, inputs: int = PER_INTERFACE) -> tuple[np.ndarray, Query]:
    """Return the wrenches (n, inputs) and the options of a JSON batch, whatever its size.

    Raises HttpProblemError 422 with mistakes' places, and SandboxError or SandboxBusyError if it
    takes too much to be read, or too many others are being read.
    """
    if body.path is None:
        full, wrenches = batch_parts(body.content, inputs)
        return wrenches, query_of(full)
    arguments = {"inputs": inputs}
    (part,) = run("wrenchbook.service.http.batch:parsed", body.path, arguments, LIMITS)
    if refused := part.fields["refused"]:
        detail = str(refused["body"].get("detail", ""))
        problem = HttpProblemError(int(refused["status"]), "", "", detail)
        problem.body = dict(refused["body"])
        raise problem
    full = BatchBody(wrenches=[], **part.fields["batch"])
    return np.array(part.arrays["wrenches"]), query_of(full)


def batch_parts(body: bytes, inputs: int = PER_INTERFACE) -> tuple[BatchBody, np.ndarray]:
    """Return the checked options of a JSON batch, and its wrenches, (n, inputs)."""
    # Before a parser makes 64 bytes of each list.
    if body.count(b"[") > MAX_BATCH + 64 or body.count(b"{") > 1024:
        raise _too_many()
    fields = parsed_json(body)
    return _checked_batch(fields, plain_wrenches(fields, inputs=inputs), inputs)


def _checked_batch(
    fields: Any, wrenches: np.ndarray | None, inputs: int
) -> tuple[BatchBody, np.ndarray]:
    """As `batch_parts`; `wrenches` are those in the fields if they have been found in order."""
    if wrenches is not None:
        if len(wrenches) > MAX_BATCH:
            raise _too_many()
        fields = {**fields, "wrenches": []}
    full: BatchBody = checked(BatchBody, fields)
    if wrenches is None:
        wrenches = even_rows(full.wrenches, inputs)
    known_method(full.method)
    return full, wrenches + 0.0


def _too_many() -> HttpProblemError:
    return bad_body([{"loc": "wrenches", "msg": f"at most {MAX_BATCH} wrenches a call"}])


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
    """As `batch_parts`, from a body of which the parser sees a megabyte at a time.

    It takes nine times the text's memory at once. None if the body is not plain; `batch_parts` then
    finds what it is.
    """
    at, end = body.find(_WRENCHES), body.rfind(b"]]") + 1
    start = body.find(b"[", at)
    if at < 0 or end <= start or body[at + len(_WRENCHES) : start].strip() != b":":
        return None
    rest = body[:start] + b"[]" + body[end + 1 :]
    if len(rest) > PIECE or rest.count(_WRENCHES) != 1:
        return None
    blocks, place = [], start + 1
    while place < end:
        cut = body.find(b"]", min(place + PIECE, end - 1)) + 1
        text = body[place:cut].strip()
        if blocks:
            if not text.startswith(b","):
                return None
            text = text[1:]
        try:
            block = plain_rows(orjson.loads(b"[" + text + b"]"), inputs=inputs)
        except orjson.JSONDecodeError:
            return None
        if block is None:
            return None
        blocks.append(block)
        place = cut
    return _checked_batch(parsed_json(rest), np.concatenate(blocks), inputs)


@asynccontextmanager
async def few_large(wrenches: int) -> AsyncIterator[None]:
    """Wait until at most one other large batch is being answered; 503 after WAIT_S."""
    if wrenches < LARGE:
        yield
        return
    try:
        await asyncio.wait_for(_places.acquire(), WAIT_S)
    except TimeoutError:
        raise busy() from None
    try:
        yield
    finally:
        _places.release()


class BinaryOptions(Body):
    """The options of a binary batch, which are query parameters."""

    on_thin: Annotated[OnThin, _JSONS] = "queue"
    wait_s: Annotated[Seconds, Field(description="binary form: s, with on_thin=wait")] = 30.0
    method: Annotated[str | None, _JSONS] = None
    translation: Annotated[_Bar | None, Field(description="binary form: tolerance, m")] = None
    rotation: Annotated[_Bar | None, Field(description="binary form: tolerance, rad")] = None
    beyond_range: Annotated[Flag, _JSONS] = False
    derivatives: Annotated[
        Derivatives, Field(description="binary form: add (n, 36) behind the (n, 13)")
    ] = False


def is_binary(request: Request) -> bool:
    """Whether a batch comes as float64."""
    kind = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    return kind == BINARY_TYPE


def read_binary(
    body: Spooled, options: dict[str, str], space: Space = DEFAULT
) -> tuple[np.ndarray, Query]:
    """Return the wrenches and options of a binary batch, whose options are query parameters."""
    full: BinaryOptions = checked(BinaryOptions, options)
    wrenches = read_wrenches(body.read(), space=space)
    limit = both_tolerances(full.translation, full.rotation)
    method, flags = known_method(full.method), (False, full.beyond_range, full.derivatives)
    return wrenches, Query((), full.on_thin, full.wait_s, limit, method, *flags)


def read_wrenches(
    body: bytes,
    count: int = MAX_BATCH,
    largest: float = LARGEST_LOAD,
    space: Space = DEFAULT,
) -> np.ndarray:
    """Wrenches (n, inputs), SI, of little-endian float64.

    Raises HttpProblemError 422 if they are no whole wrenches, more than `count`, or if a number is
    not finite or beyond `largest`.
    """
    inputs = len(space.inputs)
    if len(body) % (8 * inputs):
        message = f"{len(body)} bytes are no whole number of wrenches, {8 * inputs} bytes each"
        raise bad_body([{"loc": "body", "msg": message}])
    if len(body) > count * 8 * inputs:
        raise bad_body([{"loc": "body", "msg": f"at most {count} wrenches a call"}])
    wrenches = np.frombuffer(body, dtype="<f8").reshape(-1, inputs).astype(float) + 0.0
    bad = np.argwhere(~(np.isfinite(wrenches) & (np.abs(wrenches) <= largest)))
    if len(bad):
        row, load = bad[0].tolist()
        value = wrenches[row, load]
        why = f"beyond {largest:g}" if np.isfinite(value) else "not finite"
        message = f"{space.input_names[load]} is {value}, {why}"
        raise bad_body([{"loc": f"wrenches.{row}.{load}", "msg": message}])
    return wrenches
