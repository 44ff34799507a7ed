"""Bodies of requests: counted while they arrive, and refused as soon as they are too large."""

from __future__ import annotations

import hashlib
import shutil
import tempfile
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Final, NamedTuple

from fastapi import Request
from starlette.concurrency import run_in_threadpool
from starlette.datastructures import FormData, UploadFile
from starlette.exceptions import HTTPException
from starlette.formparsers import MultiPartException
from starlette.requests import ClientDisconnect
from starlette.types import Message, Receive

from wrenchbook.service.http.problems import HttpProblemError, bad_body

# One wrench with all its options is some 400 bytes; no reason makes it a hundred times that.
MOST_QUERY_BYTES: Final = 64 * 1024
# A million wrenches, the most of a batch, at 17 digits a number and some blanks.
MOST_BATCH_BYTES: Final = 256 * 1024 * 1024
MOST_TABLE_BYTES: Final = 512 * 1024 * 1024
MOST_KEPT: Final = 4 << 30  # bytes of bodies in files at once
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
    """Return a `receive` that raises 413 as soon as more than `most` bytes have arrived."""
    total = 0

    async def count() -> Message:
        nonlocal total
        message = await receive()
        total += len(message.get("body", b""))
        if total > most:
            raise refusal(most)
        return message

    return count


async def pieces(receive: Receive, most: int, refusal: Refusal = too_large) -> AsyncIterator[bytes]:
    """Yield a request's body as it arrives.

    Raises
    ------
    HttpProblemError
        413, as soon as more than `most` bytes have arrived.
    ClientDisconnect
        If the caller has closed the connection.
    """
    receive, more = counted(receive, most, refusal), True
    while more:
        message = await receive()
        if message["type"] == "http.disconnect":
            raise ClientDisconnect
        more = message.get("more_body", False)
        yield message.get("body", b"")


async def read_limited(receive: Receive, most: int = MOST_QUERY_BYTES) -> bytes:
    """Return a request's body, of at most `most` bytes; it raises as `pieces` does."""
    return b"".join([piece async for piece in pieces(receive, most)])


class Spooled:
    """A body that has arrived: a small one in memory, a larger one in a file.

    Attributes
    ----------
    content : bytes
        Of a body without a file.
    path : Path or None
        Of the file.
    """

    kept = 0  # bytes of all bodies that are in files now

    def __init__(self, path: Path | None = None) -> None:
        self.path = path
        self.content = b""
        self.size = 0  # bytes in the file

    def read(self) -> bytes:
        """Return all of it."""
        return self.content if self.path is None else self.path.read_bytes()

    def to_file(self) -> Path:
        """Return the path of a file that holds all of it."""
        return self.append(self.content) if self.path is None else self.path

    def append(self, piece: bytes) -> Path:
        """Write a piece to the end of the file, and return its path."""
        if self.path is None:
            self.path = Path(tempfile.mkdtemp(prefix="wrenchbook-")) / "body"
        with self.path.open("ab") as file:
            file.write(piece)
        return self.path

    async def put(self, piece: bytes) -> None:
        """Append a piece in a thread; 503 if the bodies in files are too large together."""
        Spooled.kept += len(piece)
        self.size += len(piece)
        if Spooled.kept > MOST_KEPT:
            raise busy()
        await run_in_threadpool(self.append, piece)


@asynccontextmanager
async def spooled(
    receive: Receive, most: int, refusal: Refusal = too_large
) -> AsyncIterator[Spooled]:
    """Give a request's body, and delete its file at the end.

    Raises
    ------
    HttpProblemError
        413, as soon as more than `most` bytes have arrived; 503 while other bodies fill the limit.
    ClientDisconnect
        If the caller has closed the connection.
    """
    body, buffer = Spooled(), bytearray()
    try:
        async for piece in pieces(receive, most, refusal):
            buffer += piece
            if len(buffer) > PIECE:
                await body.put(bytes(buffer))
                buffer.clear()
        if body.path is None:
            body.content = bytes(buffer)
        else:
            await body.put(bytes(buffer))
        yield body
    finally:
        Spooled.kept -= body.size
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

    A plain body is one file; a form has the files ``loads`` and ``displacements``, or ``table``.

    Raises
    ------
    HttpProblemError
        413 as soon as the body is too large; 422 if a form lacks its files.
    """
    kind = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    if kind != "multipart/form-data":
        async with spooled(request.receive, MOST_TABLE_BYTES, _table_too_large) as body:
            files = (await run_in_threadpool(body.to_file),)
            yield Received(files, "", await run_in_threadpool(_digest, files))
        return
    folder = Path(await run_in_threadpool(tempfile.mkdtemp, prefix="wrenchbook-"))
    try:
        most = MOST_TABLE_BYTES + _FORM_BYTES
        async with form_of(request, most, 2, _table_too_large) as form:
            uploads = _uploads(form)
            names = ", ".join(upload.filename or "" for upload in uploads)
            files = await run_in_threadpool(_copied, uploads, folder)
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
        async with request.form(max_files=most_files, max_fields=8) as form:
            yield form
    except (HTTPException, MultiPartException) as error:
        why = str(getattr(error, "detail", error))
        raise bad_body([{"loc": "body", "msg": f"not a form that can be read: {why}"}]) from None


def _uploads(form: FormData) -> list[UploadFile]:
    found = [form.get(name) for name in (_LOGS if _LOGS[0] in form else ("table",))]
    uploads = [one for one in found if isinstance(one, UploadFile)]
    if len(uploads) != len(found):
        message = "send the file 'table', or both logs as 'loads' and 'displacements'"
        raise bad_body([{"loc": "form", "msg": message}])
    return uploads


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
