"""Batches of wrenches in JSON: small ones are parsed here, large ones in a sandboxed process.

The parser holds Python's lock for seconds, and what it makes of a body may be forty times as large.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any, Final

import numpy as np
import orjson

from wrenchbook.service.answering.queries import BatchQuery
from wrenchbook.service.http.bodies import MAX_BATCH, BatchBody
from wrenchbook.service.http.body import Spooled, busy
from wrenchbook.service.http.parsing import (
    checked,
    known_method,
    parsed_json,
    plain_rows,
    plain_wrenches,
)
from wrenchbook.service.http.problems import ProblemError, bad_body
from wrenchbook.service.sandbox import MIB, Limits, Part, run
from wrenchbook.surrogate.table.rows import Tolerance

# A million wrenches as Python's lists and numbers are 400 MB, beside the text of 250 MB.
LIMITS: Final = Limits(memory=1200 * MIB, seconds=60.0, output=256 * MIB)

PIECE: Final = 1 << 20  # bytes that the parser sees at once
_WRENCHES: Final = b'"wrenches"'
LARGE: Final = 50_000  # wrenches: beyond it, an answer is tens of MB in several forms at once
WAIT_S: Final = 60.0
_places = asyncio.Semaphore(2)


def read_batch_body(body: Spooled) -> BatchQuery:
    """Return the batch that a JSON body is, whatever its size.

    Raises
    ------
    ProblemError
        422, with mistakes' places.
    SandboxError, SandboxBusyError
        If it takes too much to be read, or too many others are being read.
    """
    if body.path is None:
        return batch_of(*batch_parts(body.content))
    (told,) = run("wrenchbook.service.http.batch:parsed", body.path, None, LIMITS)
    if refused := told.fields["refused"]:
        raise refusal(refused)
    return batch_of(told.fields["batch"], np.array(told.arrays["wrenches"]))


def batch_parts(body: bytes) -> tuple[dict[str, Any], np.ndarray]:
    """Read the batch call's JSON body: its fields as checked, and its wrenches, N and N·m (n, 6).

    Raises
    ------
    ProblemError
        422, with mistakes' places.
    """
    _few_lists(body)
    fields = parsed_json(body)
    return checked_batch(fields, plain_wrenches(fields))


def checked_batch(fields: Any, wrenches: np.ndarray | None) -> tuple[dict[str, Any], np.ndarray]:
    """Check a batch's fields, as `batch_parts` does.

    Parameters
    ----------
    fields : object
        As parsed from JSON.
    wrenches : array or None
        Those in it, shape (n, 6), N and N·m, if they have been found to be in order.
    """
    if wrenches is not None:
        if len(wrenches) > MAX_BATCH:
            raise _too_many()
        fields = {**fields, "wrenches": []}
    full = checked(BatchBody, fields)
    if wrenches is None:
        wrenches = np.array(full.wrenches, dtype=float).reshape(-1, 6)
    known_method(full.method)
    return full.model_dump(exclude={"wrenches"}), wrenches + 0.0


def batch_of(fields: dict[str, Any], wrenches: np.ndarray) -> BatchQuery:
    """Return the query that a batch's parts are, see `batch_parts`; wrenches (n, 6), N and N·m."""
    limit = fields["tolerance"]
    told = {name: value for name, value in fields.items() if name != "tolerance"}
    return BatchQuery(wrenches, tolerance=Tolerance(**limit) if limit else None, **told)


def _few_lists(body: bytes) -> None:
    """Refuse a batch of more lists than it may have, before a parser makes 64 bytes of each."""
    if body.count(b"[") > MAX_BATCH + 64 or body.count(b"{") > 1024:
        raise _too_many()


def _too_many() -> ProblemError:
    return bad_body([{"loc": "wrenches", "msg": f"at most {MAX_BATCH} wrenches a call"}])


def parsed(path: Path) -> Iterator[Part]:
    """Read a JSON batch in the child: its fields and its wrenches, or its refusal."""
    body = path.read_bytes()
    try:
        fields, wrenches = in_pieces(body) or batch_parts(body)
    except ProblemError as error:
        yield Part({"refused": {"status": error.status, "body": error.body}})
    else:
        yield Part({"refused": None, "batch": fields}, {"wrenches": np.asarray(wrenches)})


def in_pieces(body: bytes) -> tuple[dict[str, Any], np.ndarray] | None:
    """Return what `batch_parts` does, from a body of which the parser sees a megabyte at a time.

    The wrenches are of shape (n, 6), N and N·m.

    It takes nine times the text's memory at once. None if the body is not plain; `batch_parts` then
    finds what it is.

    Raises
    ------
    ProblemError
        422, if its other fields have mistakes.
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
        block = _rows(body[place:cut], first=not blocks)
        if block is None:
            return None
        blocks.append(block)
        place = cut
    return checked_batch(parsed_json(rest), np.concatenate(blocks))


def _rows(text: bytes, *, first: bool) -> np.ndarray | None:
    """Return some wrenches of a list as an array, (n, 6), N and N·m; None if they are not plain."""
    text = text.strip()
    if not first:
        if not text.startswith(b","):
            return None
        text = text[1:]
    try:
        return plain_rows(orjson.loads(b"[" + text + b"]"))
    except orjson.JSONDecodeError:
        return None


def refusal(told: dict[str, Any]) -> ProblemError:
    """Return the problem that a child came to."""
    found = ProblemError(int(told["status"]), "", "", str(told["body"].get("detail", "")))
    found.body = dict(told["body"])
    return found


@asynccontextmanager
async def few_large(wrenches: int) -> AsyncIterator[None]:
    """Wait, before a large batch is answered, until at most one other is being answered.

    Raises
    ------
    ProblemError
        503, after WAIT_S.
    """
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
