"""Large batches in JSON: read in the sandbox, for as long as it takes, while others are answered.

The parser holds Python's lock for seconds, and what it makes of a body may be forty times as large.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np
import orjson

from service.answering.queries import BatchQuery
from service.http.parsing import batch_of, batch_parts, checked_batch, parsed_json, plain_rows
from service.http.problems import ProblemError
from service.http.spooled import Spooled
from service.sandbox import MIB, Limits, Part, run

# A million wrenches as Python's lists and numbers are 400 MB, beside the text of 250 MB.
LIMITS: Final = Limits(memory=1200 * MIB, seconds=60.0, output=256 * MIB)

PIECE: Final = 1 << 20  # bytes that the parser sees at once
_WRENCHES: Final = b'"wrenches"'


def read_batch_body(body: Spooled) -> BatchQuery:
    """Return the batch that a JSON body is, whatever its size.

    Raises
    ------
    ProblemError
        422, with mistakes' places.
    SandboxError, SandboxBusyError
        If it takes too much to be read, or too many others are being read.
    """
    if body.content is not None:
        return batch_of(*batch_parts(body.content))
    (told,) = run("service.http.large:parsed", body.path, None, LIMITS)
    if refused := told.fields["refused"]:
        raise refusal(refused)
    return batch_of(told.fields["batch"], np.array(told.arrays["wrenches"]))


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
