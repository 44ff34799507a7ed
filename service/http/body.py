"""Bodies of requests: counted while they arrive, and refused as soon as they are too large."""

from __future__ import annotations

import hashlib
import shutil
import tempfile
from collections.abc import AsyncIterator, Callable, Coroutine, Sequence
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any, Final, NamedTuple, cast

from fastapi import Request
from fastapi.routing import APIRoute
from starlette.concurrency import run_in_threadpool
from starlette.datastructures import FormData, UploadFile
from starlette.exceptions import HTTPException
from starlette.formparsers import MultiPartException
from starlette.responses import Response
from starlette.types import Message, Receive

from wrenchbook.service.http.parsing import parsed_json
from wrenchbook.service.http.problems import HttpProblemError, bad_body

# One wrench with all its options is some 400 bytes; no reason makes it a hundred times that.
MAX_QUERY_BYTES: Final = 64 * 1024
# A million wrenches, the most of a batch, at 17 digits a number and some blanks.
MAX_BATCH_BYTES: Final = 256 * 1024 * 1024
MAX_TABLE_BYTES: Final = 512 * 1024 * 1024
MAX_KEPT: Final = 4 << 30  # bytes of bodies in files at once
PIECE: Final = 1 << 20  # bytes in memory: parsed in a hundredth of a second; more go to a file
_FORM_BYTES: Final = 64 * 1024  # of a form, around its files
_LOGS: Final = ("loads", "displacements")

Refusal = Callable[[int], HttpProblemError]


def too_large(most: int) -> HttpProblemError:
    """Return the refusal of a body of more than `most` bytes."""
    detail = f"Send at most {most >> 20} MiB a call; send parts. Nothing was changed."
    if most < 1 << 20:
        detail = (
            f"This call takes at most {most:,} bytes; nothing was changed. Leave out what it "
            "does not need, or send parts."
        )
    return HttpProblemError(413, "too-large", "The body is too large", detail)


def _table_too_large(most: int) -> HttpProblemError:
    detail = f"Send at most {most >> 20} MiB a call, gzipped or in parts; nothing was loaded."
    return HttpProblemError(413, "too-large", "The table is too large", detail)


def busy() -> HttpProblemError:
    """Return the refusal of a body while too many others are worked on."""
    detail = "Nothing was changed; send it again in a minute."
    return HttpProblemError(503, "busy", "Too many large bodies at once", detail)


def counted(receive: Receive, most: int, refusal: Refusal = too_large) -> Receive:
    """Return a `receive` that raises 413 as soon as more than `most` bytes have arrived.

    Starlette's own limit refuses a call that reads no body only after it has acted.
    """
    total = 0

    async def count() -> Message:
        nonlocal total
        message = await receive()
        total += len(message.get("body", b""))
        if total > most:
            raise refusal(most)
        return message

    return count


async def read_limited(receive: Receive, most: int = MAX_QUERY_BYTES) -> bytes:
    """Return a request's body; 413 beyond `most` bytes, ClientDisconnect if the caller has left."""
    return await Request({"type": "http"}, counted(receive, most)).body()


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

    kept = 0  # bytes of all bodies that are in files now

    def __init__(self, path: Path | None = None) -> None:
        self.content = b""
        self.path = path

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
async def spooled(
    receive: Receive, most: int, refusal: Refusal = too_large
) -> AsyncIterator[Spooled]:
    """Give a request's body, and delete its file at the end.

    It raises 413 as soon as more than `most` bytes have arrived, 503 while bodies in files are too
    large together, and ClientDisconnect if the caller has left.
    """
    body, buffer, size = Spooled(), bytearray(), 0
    try:
        async for piece in Request({"type": "http"}, counted(receive, most, refusal)).stream():
            buffer += piece
            if len(buffer) > PIECE or (body.path is not None and not piece):
                Spooled.kept += len(buffer)
                size += len(buffer)
                if Spooled.kept > MAX_KEPT:
                    raise busy()
                await run_in_threadpool(body.append, bytes(buffer))
                buffer.clear()
        body.content = bytes(buffer)
        yield body
    finally:
        Spooled.kept -= size
        if body.path is not None:
            await run_in_threadpool(shutil.rmtree, body.path.parent, ignore_errors=True)


class Received(NamedTuple):
    """Files of a table: their paths, their names at the caller, the SHA-256 of all of them."""

    files: tuple[Path, ...]
    filename: str
    digest: str


@asynccontextmanager
async def received(request: Request) -> AsyncIterator[Received]:
    """Give a table's body as files, and delete them at the end.

    A plain body is one file; a form has the files ``loads`` and ``displacements``, or ``table``. It
    raises 413 as soon as the body is too large, and 422 if a form lacks its files.
    """
    kind = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    if kind != "multipart/form-data":
        async with spooled(request.receive, MAX_TABLE_BYTES, _table_too_large) as body:
            path = body.path or await run_in_threadpool(body.append, body.content)
            yield Received((path,), "", await run_in_threadpool(_digest, (path,)))
        return
    most = MAX_TABLE_BYTES + _FORM_BYTES
    async with form_of(request, most, 2, _table_too_large) as form:
        uploads = [form.get(name) for name in (_LOGS if _LOGS[0] in form else ("table",))]
        if not all(isinstance(upload, UploadFile) for upload in uploads):
            message = "send the file 'table', or both logs as 'loads' and 'displacements'"
            raise bad_body([{"loc": "form", "msg": message}])
        folder = Path(await run_in_threadpool(tempfile.mkdtemp, prefix="wrenchbook-"))
        try:
            files = await run_in_threadpool(_copied, cast(list[UploadFile], uploads), folder)
            names = ", ".join(cast(UploadFile, upload).filename or "" for upload in uploads)
            yield Received(files, names.strip(", "), await run_in_threadpool(_digest, files))
        finally:
            await run_in_threadpool(shutil.rmtree, folder, ignore_errors=True)


@asynccontextmanager
async def form_of(
    request: Request, most: int, most_files: int, refusal: Refusal = too_large
) -> AsyncIterator[FormData]:
    """Read a form of at most `most` bytes, its files into files of their own; else 413 or 422."""
    request = Request(request.scope, counted(request.receive, most, refusal))
    try:
        form = await request.form(max_files=most_files, max_fields=8)
    except (HTTPException, MultiPartException) as error:
        if isinstance(error, HttpProblemError):
            raise
        why = str(getattr(error, "detail", error))
        raise bad_body([{"loc": "body", "msg": f"not a form that can be read: {why}"}]) from None
    try:
        yield form
    finally:
        await form.close()


def _copied(uploads: Sequence[UploadFile], folder: Path) -> tuple[Path, ...]:
    paths = tuple(folder / f"table-{number}" for number in range(len(uploads)))
    for upload, path in zip(uploads, paths, strict=True):
        with path.open("wb") as file:
            shutil.copyfileobj(upload.file, file, PIECE)
    return paths


def _digest(files: Sequence[Path]) -> str:
    digest = hashlib.sha256()
    for path in files:
        with path.open("rb") as file:
            while block := file.read(PIECE):
                digest.update(block)
    return digest.hexdigest()
