"""Large bodies: counted while they arrive, and kept in a file rather than in memory."""

from __future__ import annotations

import asyncio
import tempfile
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Final

from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect
from starlette.types import Receive

from service.http.limited import too_large
from service.http.problems import ProblemError

SMALL: Final = 1 << 20  # parsed in a hundredth of a second; beyond it, in a file
MOST_KEPT: Final = 4 << 30  # bytes of bodies in files at once
LARGE: Final = 50_000  # wrenches: beyond it, an answer is tens of MB in several forms at once
WAIT_S: Final = 60.0
_places = asyncio.Semaphore(2)
_PIECE: Final = 1 << 20


class Spooled:
    """A body that has come: small ones in `content`, larger ones in the file `path`.

    Attributes
    ----------
    content : bytes or None
    path : Path
    size : int
    """

    kept = 0  # bytes of all that are in files now

    def __init__(self, path: Path) -> None:
        self.path = path
        self.content: bytes | None = None
        self.size = self.in_file = 0

    def read(self) -> bytes:
        """Return all of it."""
        return self.path.read_bytes() if self.content is None else self.content

    def to_file(self) -> Path:
        """Return the path of a file that holds all of it."""
        if self.content is not None:
            self.path.write_bytes(self.content)
        return self.path


@asynccontextmanager
async def spooled(receive: Receive, most: int) -> AsyncIterator[Spooled]:
    """Give a request's body, and forget it at the end.

    Raises
    ------
    ProblemError
        413, as soon as more than `most` bytes have come; 503, if there are too many of others.
    ClientDisconnect
        If the other side has gone.
    """
    with tempfile.TemporaryDirectory(prefix="wrenchbook-") as folder:
        body = Spooled(Path(folder) / "body")
        try:
            await _take(receive, most, body)
            yield body
        finally:
            Spooled.kept -= body.in_file


@asynccontextmanager
async def few_large(wrenches: int) -> AsyncIterator[None]:
    """Let a batch go on, a large one once no more than another is being answered.

    Raises
    ------
    ProblemError
        503, if others take too long.
    """
    if wrenches < LARGE:
        yield
        return
    try:
        await asyncio.wait_for(_places.acquire(), WAIT_S)
    except TimeoutError:
        raise _busy() from None
    try:
        yield
    finally:
        _places.release()


async def _take(receive: Receive, most: int, body: Spooled) -> None:
    piece = bytearray()
    more = True
    while more:
        message = await receive()
        if message["type"] == "http.disconnect":
            raise ClientDisconnect
        came: bytes = message.get("body", b"")
        more = message.get("more_body", False)
        piece += came
        body.size += len(came)
        if body.size > most:
            raise too_large(most)
        if len(piece) > _PIECE or (not more and body.in_file):
            await _put(body, piece)
            piece = bytearray()
    if not body.in_file:
        body.content = bytes(piece)


async def _put(body: Spooled, piece: bytearray) -> None:
    Spooled.kept += len(piece)
    body.in_file += len(piece)
    if Spooled.kept > MOST_KEPT:
        raise _busy()
    await run_in_threadpool(_append, body.path, piece)


def _busy() -> ProblemError:
    detail = "Nothing was changed; send it again in a minute."
    return ProblemError(503, "busy", "Too much is being sent", detail)


def _append(path: Path, piece: bytearray) -> None:
    with path.open("ab") as file:
        file.write(piece)
