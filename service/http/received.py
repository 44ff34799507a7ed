"""Large bodies on their way to a file: counted as they come, and never in memory."""

from __future__ import annotations

import hashlib
import shutil
import tempfile
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from fastapi import Request
from starlette.concurrency import run_in_threadpool
from starlette.datastructures import FormData, UploadFile
from starlette.exceptions import HTTPException
from starlette.formparsers import MultiPartException
from starlette.types import Message

from service.http.problems import ProblemError, bad_body

MOST_TABLE_BYTES: Final = 512 * 1024 * 1024
_AT_ONCE: Final = 1 << 20  # bytes a write
_LOGS: Final = ("loads", "displacements")
_FORM_BYTES: Final = 64 * 1024  # of a form, around its files


@dataclass(frozen=True)
class Received:
    """Files that were sent: where they are, what they are called, the digest of all of them."""

    files: tuple[Path, ...]
    filename: str
    digest: str


@asynccontextmanager
async def received(request: Request) -> AsyncIterator[Received]:
    """Keep the body of a request in files for as long as it is worked on.

    A plain body is one file; a form has the files ``loads`` and ``displacements``, or ``table``.

    Raises
    ------
    ProblemError
        413 as soon as more has come than may; 422 if a form lacks its files.
    """
    folder = Path(await run_in_threadpool(tempfile.mkdtemp, prefix="wrenchbook-"))
    try:
        kind = request.headers.get("content-type", "").partition(";")[0].strip().lower()
        if kind == "multipart/form-data":
            yield await _form(request, folder)
        else:
            path = folder / "table"
            yield Received((path,), "", await _body(request, path))
    finally:
        await run_in_threadpool(shutil.rmtree, folder, ignore_errors=True)


async def _body(request: Request, path: Path) -> str:
    digest, size, held = hashlib.sha256(), 0, bytearray()
    with await run_in_threadpool(path.open, "wb") as file:
        async for piece in request.stream():
            size += len(piece)
            if size > MOST_TABLE_BYTES:
                raise _too_large()
            held += piece
            if len(held) >= _AT_ONCE:
                digest.update(held)
                await run_in_threadpool(file.write, bytes(held))
                held.clear()
        digest.update(held)
        await run_in_threadpool(file.write, bytes(held))
    return digest.hexdigest()


async def _form(request: Request, folder: Path) -> Received:
    """Take the files of a form, which come through files of their own already."""
    counted = Request(request.scope, _Counted(request).receive)
    async with form_of(counted, most_files=2) as form:
        uploads = _uploads(form)
        names = ", ".join(upload.filename or "" for upload in uploads)
        paths = tuple(folder / f"table-{number}" for number in range(len(uploads)))
        digest = await run_in_threadpool(_copied, uploads, paths)
    return Received(paths, names.strip(", "), digest)


@asynccontextmanager
async def form_of(request: Request, most_files: int) -> AsyncIterator[FormData]:
    """Read a request's form, its files into files of their own; a broken one is 422."""
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


def _copied(uploads: list[UploadFile], paths: tuple[Path, ...]) -> str:
    digest = hashlib.sha256()
    for upload, path in zip(uploads, paths, strict=True):
        with path.open("wb") as file:
            while block := upload.file.read(_AT_ONCE):
                digest.update(block)
                file.write(block)
    return digest.hexdigest()


class _Counted:
    """What is received of a request, up to the most it may be."""

    def __init__(self, request: Request) -> None:
        self._receive = request.receive
        self._left = MOST_TABLE_BYTES + _FORM_BYTES

    async def receive(self) -> Message:
        """Return the next message."""
        message = await self._receive()
        self._left -= len(message.get("body", b""))
        if self._left < 0:
            raise _too_large()
        return message


def _too_large() -> ProblemError:
    return ProblemError(
        413,
        "too-large",
        "The table is too large",
        f"Send at most {MOST_TABLE_BYTES >> 20} MiB a call, gzipped or in parts; nothing was "
        "loaded.",
    )
