"""Bodies of requests: counted while they arrive, parsed, and checked by the models of `bodies`.

A mistake is a `HttpProblemError` with the place of each mistake and what to send.
"""

from __future__ import annotations

import difflib
import json
import shutil
import tempfile
from collections import Counter
from collections.abc import AsyncIterator, Callable, Collection, Coroutine, Iterator
from contextlib import asynccontextmanager
from itertools import chain, compress
from pathlib import Path
from typing import Any, Final

import numpy as np
import orjson
from fastapi import Request
from fastapi.routing import APIRoute
from pydantic import ValidationError
from starlette.concurrency import run_in_threadpool
from starlette.datastructures import FormData, QueryParams
from starlette.exceptions import HTTPException
from starlette.formparsers import MultiPartException
from starlette.responses import Response
from starlette.types import Message, Receive

from wrenchbook.fea.spec.schema import LARGEST_LOAD
from wrenchbook.service.http.bodies import BatchBody, BlockBody, Body, DisplacementBody, LoadsBody
from wrenchbook.service.http.problems import (
    MAX_PLACE,
    REPEATED,
    HttpProblemError,
    bad_body,
    plain_errors,
)
from wrenchbook.service.query import Query, plain_query
from wrenchbook.surrogate.table.rows import Tolerance
from wrenchbook.surrogate.table.space import Space, SpaceError

# One wrench with all its options is some 400 bytes; no reason makes it a hundred times that.
MAX_QUERY_BYTES: Final = 64 * 1024
# A million wrenches, the most of a batch, at 17 digits a number and some blanks.
MAX_BATCH_BYTES: Final = 256 * 1024 * 1024
MAX_SPOOLED: Final = 4 << 30  # bytes of bodies in files at once
MIB: Final = 1 << 20
_NO_PARAMETERS: Final = "This call has no parameters; send its options, if any, in the body"
PIECE: Final = MIB  # bytes in memory: parsed in a hundredth of a second; more go to a file


def too_large(
    max_bytes: int, limit: str = "the limit of this call", remedy: str = ""
) -> HttpProblemError:
    """Return the refusal of a body of more than `max_bytes`, which are a `limit`."""
    size = f"{max_bytes:,} bytes"
    usual = "Leave out what the call does not need, or send parts."
    if max_bytes >= MIB:
        size = f"{max_bytes >> 20} MiB"
        usual = "Send it in parts."
    detail = f"The body has more than {size}, {limit}; nothing was changed. {remedy or usual}"
    return HttpProblemError(413, "too-large", "The body is too large", detail)


def busy(why: str) -> HttpProblemError:
    """Return the refusal of a body while too many others are worked on."""
    detail = f"{why}; nothing was changed. Send it again in a minute."
    return HttpProblemError(503, "busy", "Too many large bodies at once", detail)


def content_type(request: Request) -> str:
    """Return the type of a request's body without its parameters; empty if it has none."""
    kind = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    return kind[:100]  # registered types are shorter, and a refusal quotes it


def counted(receive: Receive, max_bytes: int, refusal: HttpProblemError | None = None) -> Receive:
    """Return a `receive` that raises `refusal`, 413, once more than `max_bytes` have arrived.

    Starlette's own limit refuses a call that reads no body only after it has acted.
    """
    total = 0

    async def count() -> Message:
        nonlocal total
        message = await receive()
        total += len(message.get("body", b""))
        if total > max_bytes:
            raise refusal or too_large(max_bytes)
        return message

    return count


async def read_limited(receive: Receive, max_bytes: int = MAX_QUERY_BYTES) -> bytes:
    """Return a request's body; 413 beyond `max_bytes`, ClientDisconnect if the caller has left."""
    return await Request({"type": "http"}, counted(receive, max_bytes)).body()


class JsonRequest(Request):
    """A request whose JSON body FastAPI reads within limits; an empty body counts as ``{}``."""

    async def body(self) -> bytes:
        """Return the body, of at most `MAX_QUERY_BYTES`."""
        self._body = await read_limited(self.receive) or b"{}"
        return self._body

    async def json(self) -> Any:
        """Return the body's JSON."""
        return parsed_json(self._body)


class JsonRoute(APIRoute):
    """A route with a JSON body as a parameter; its mistakes are problems with a place each."""

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        """Return FastAPI's handler on a `JsonRequest`."""
        handler = super().get_route_handler()

        async def handle(request: Request) -> Response:
            return await handler(JsonRequest(request.scope, request.receive))

        return handle


class Spooled:
    """A body that has arrived: `content` in memory, or a larger one in the file `path`."""

    stored = 0  # bytes of all bodies that are in files now

    def __init__(self) -> None:
        self.content = b""
        self.path: Path | None = None

    def read(self) -> bytes:
        """Return all of it."""
        return self.content if self.path is None else self.path.read_bytes()

    def append(self, piece: bytes) -> Path:
        """Write a piece to the end of the file, and return its path."""
        if self.path is None:
            self.path = Path(tempfile.mkdtemp(prefix="wrenchbook-")) / "body"
        with self.path.open("ab") as file:
            file.write(piece)
        return self.path


@asynccontextmanager
async def spooled(receive: Receive, max_bytes: int) -> AsyncIterator[Spooled]:
    """Give a request's body, and delete its file at the end.

    It raises 413 as soon as more than `max_bytes` have arrived, 503 while bodies in files are too
    large together, and ClientDisconnect if the caller has left.
    """
    body = Spooled()
    buffer = bytearray()
    size = 0
    try:
        async for piece in Request({"type": "http"}, counted(receive, max_bytes)).stream():
            buffer += piece
            if len(buffer) > PIECE or (body.path is not None and not piece):
                Spooled.stored += len(buffer)
                size += len(buffer)
                if Spooled.stored > MAX_SPOOLED:
                    raise busy(f"Bodies of {MAX_SPOOLED >> 30} GiB, the limit, are being read")
                await run_in_threadpool(body.append, bytes(buffer))
                buffer.clear()
        body.content = bytes(buffer)
        yield body
    finally:
        Spooled.stored -= size
        if body.path is not None:
            await run_in_threadpool(shutil.rmtree, body.path.parent, ignore_errors=True)


@asynccontextmanager
async def form_of(
    request: Request, max_bytes: int, max_files: int, remedy: str = ""
) -> AsyncIterator[FormData]:
    """Read a form of at most `max_bytes`, its files into files; else 413 with `remedy`, or 422."""
    request = Request(
        request.scope, counted(request.receive, max_bytes, too_large(max_bytes, remedy=remedy))
    )
    try:
        form = await request.form(max_files=max_files, max_fields=8)
    except (HTTPException, MultiPartException) as error:
        if isinstance(error, HttpProblemError):
            raise
        why = f"cannot be read as a form ({getattr(error, 'detail', error)})"
        remedy = f"send multipart/form-data with at most {max_files} file(s) (curl: -F)"
        raise bad_body([{"loc": "body", "msg": f"{why}; {remedy}"}]) from None
    try:
        yield form
    finally:
        await form.close()


def read_query(body: bytes, space: Space) -> Query:
    """Return the query of the main call's body, of a component with the inputs of `space`.

    A body of only force, moment and on_thin, which is what a simulator sends in its loop, is
    checked without pydantic; anything else, and every mistake, goes through it.
    """
    fields = parsed_json(body)
    plain = plain_query(fields) if space.is_default else None
    if plain is not None:
        return plain
    full: DisplacementBody = checked(DisplacementBody, fields)
    return full.query()._replace(wrench=loads_of(full, space))


def loads_of(body: LoadsBody, space: Space) -> tuple[float, ...]:
    """Return the inputs of a component, (n,), SI: loads that a body does not have are zero.

    Raises HttpProblemError 422 with each interface or input that is unknown, and each further input
    that is missing.
    """
    loads = {name: wrench.wrench() for name, wrench in body.loads.items()}
    if body.force is not None or body.moment is not None:
        given = "moment" if body.force is None else "force"
        if space.several:
            message = "give force and moment of each interface in loads "
            message += f"(--load {space.several[0]}=FX,FY,FZ): {' or '.join(space.several)}"
            raise bad_body([{"loc": given, "msg": message}])
        if loads:
            message = "is given beside loads, which has the same wrench; leave one of the two out"
            raise bad_body([{"loc": given, "msg": message}])
        loads = {space.interfaces[0]: body.wrench()}
    try:
        return space.vector(loads, {name: value + 0.0 for name, value in body.inputs.items()})
    except SpaceError as error:
        raise bad_body([{"loc": place, "msg": text} for place, text in error.mistakes]) from None


def too_many_wrenches(count: int, max_count: int) -> HttpProblemError:
    """Return the refusal of a body of more than `max_count` wrenches."""
    message = f"has {count} wrenches, but a request may have at most {max_count}; send parts"
    return bad_body([{"loc": "wrenches", "msg": message}])


def with_wrenches(
    kind: type[BlockBody | BatchBody], fields: Any, inputs: int, largest: float, max_count: int
) -> tuple[np.ndarray, Any]:
    """Return the wrenches of a JSON body, (n, inputs), SI, and the body, checked without them."""
    wrenches = fields.get("wrenches") if isinstance(fields, dict) else None
    plain = plain_rows(wrenches, inputs, largest)
    if plain is not None:
        if len(plain) > max_count:
            raise too_many_wrenches(len(plain), max_count)
        return plain + 0.0, checked(kind, {**fields, "wrenches": []})
    body = checked(kind, fields)
    uneven = [place for place, wrench in enumerate(body.wrenches) if len(wrench) != inputs]
    if uneven:
        length = len(body.wrenches[uneven[0]])
        raise other_width(uneven[0], length, inputs)
    return np.array(body.wrenches, dtype=float).reshape(-1, inputs) + 0.0, body


def other_width(place: int, length: int, inputs: int) -> HttpProblemError:
    """Return the problem of a wrench with another number of numbers than the component's inputs."""
    message = f"has {length} numbers, but the component has {inputs} inputs; give one for each"
    return bad_body([{"loc": f"wrenches.{place}", "msg": message}])


def read_body(kind: type[Body], body: bytes, parameter: str = "") -> Any:
    """Read any other body with pydantic; an empty one counts as ``{}``.

    `parameter`: that of the query which holds the JSON in place of the body, for messages.
    """
    try:
        return checked(kind, parsed_json(body or b"{}"))
    except HttpProblemError as error:
        if not parameter:
            raise
        places = (mistake["loc"] for mistake in error.body["errors"])
        locs = [parameter if place == "body" else f"{parameter}.{place}" for place in places]
        pairs = zip(error.body["errors"], locs, strict=True)
        raise bad_body([{**mistake, "loc": loc} for mistake, loc in pairs]) from None


def parsed_json(body: bytes) -> Any:
    """Return the values of JSON.

    Raises HttpProblemError (422) if it is invalid or an object repeats a key, and MemoryError if it
    is too large for the parser.
    """
    try:
        fields = orjson.loads(body)
        repeated: list[str] = []
        if body.count(b":") > _key_count(fields):  # each key has a colon: equal counts repeat none
            # An integer of thousands of digits is an error of int().
            pairs = json.loads(body, object_pairs_hook=tuple, parse_int=float)
            repeated = [*_repeated_keys(pairs)]
    except (orjson.JSONDecodeError, RecursionError) as error:
        if "memory" in str(error).lower():
            raise MemoryError from None
        if not body.strip():
            message = "is empty; send a JSON object"
        elif "infinity" in str(error):
            place = str(error).split(": ")[-1]
            message = f"has a number that is too large ({place}); the largest is 1.8e308"
        elif b"NaN" in body or b"Infinity" in body:
            message = "has NaN or Infinity, which JSON does not have; give a finite number"
        else:
            message = f"is not valid JSON ({error}); correct it"
        raise bad_body([{"loc": "body", "msg": message}]) from None
    if repeated:
        raise bad_body([{"loc": place[:MAX_PLACE], "msg": REPEATED} for place in repeated])
    return fields


def _key_count(value: Any) -> int:
    """Return the number of keys of an object and of the objects in it, without those in lists."""
    return len(value) + sum(map(_key_count, value.values())) if isinstance(value, dict) else 0


def _repeated_keys(value: Any, front: str = "") -> Iterator[str]:
    """Yield the dotted places of repeated keys in JSON values whose objects are tuples of pairs."""
    if not isinstance(value, list | tuple):
        return
    keys: set[Any] = set()
    for key, entry in enumerate(value) if isinstance(value, list) else value:
        place = f"{front}{key}"
        if key in keys:
            yield place
        keys.add(key)
        yield from _repeated_keys(entry, f"{place}.")


def checked(kind: type[Body], fields: Any) -> Any:
    """Return the body of parsed JSON; 422 with every mistake's place."""
    try:
        return kind.model_validate(fields)
    except ValidationError as error:
        raise bad_body(plain_errors(error)) from None


def both_tolerances(translation: float | None, rotation: float | None) -> Tolerance | None:
    """Return a tolerance, m and rad; 422 if one of its two numbers is missing."""
    if translation is not None and rotation is not None:
        return Tolerance(translation, rotation)
    if translation is rotation:
        return None
    missing = "rotation" if rotation is None else "translation"
    message = "is missing; a tolerance needs both translation (m) and rotation (rad)"
    raise bad_body([{"loc": missing, "msg": message}])


def plain_rows(rows: Any, inputs: int, largest: float = LARGEST_LOAD) -> np.ndarray | None:
    """Wrenches as an array (n, inputs); None if anything is unusual in them."""
    if not isinstance(rows, list) or not rows:
        return None
    try:
        wrenches = np.array(rows)
    except ValueError:
        return None
    if wrenches.dtype.kind not in "fi" or wrenches.ndim != 2 or wrenches.shape[1] != inputs:
        return None
    # numpy takes true for 1 and false for 0.
    suspects = compress(rows, ((wrenches == 0) | (wrenches == 1)).any(axis=1))
    if bool in set(map(type, chain.from_iterable(suspects))):
        return None
    wrenches = wrenches.astype(float)
    fine = np.isfinite(wrenches) & (np.abs(wrenches) <= largest)
    return wrenches if fine.all() else None


def query_options(
    query: QueryParams, known: Collection[str], lists: Collection[str] = ()
) -> dict[str, str]:
    """Return the query parameters of a call by name; those in `lists` may be repeated.

    Raises HttpProblemError 422 with each unknown and each repeated one: a misspelt filter would
    select everything.
    """
    errors = []
    for name, count in Counter(name for name, _ in query.multi_items()).items():
        place = name[:MAX_PLACE]
        if name not in known:
            # Of the first one: each comparison with all known names takes 0.3 ms.
            near = [] if errors else difflib.get_close_matches(place, known, n=1)
            meant = f"; did you mean {near[0]}?" if near else "."
            all_known = f"Known: {', '.join(known)}" if known else _NO_PARAMETERS
            errors.append({"loc": place, "msg": f"is unknown{meant} {all_known}"})
        elif count > 1 and name not in lists:
            errors.append({"loc": place, "msg": REPEATED})
    if errors:
        raise bad_body(errors)
    return dict(query)
