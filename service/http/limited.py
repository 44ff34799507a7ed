"""Bodies counted while they arrive, so that none is kept that is too large."""

from __future__ import annotations

from typing import Final

from starlette.requests import ClientDisconnect
from starlette.types import Message, Receive

from service.http.problems import ProblemError

# One wrench with all its options is some 400 bytes; no reason makes it a hundred times that.
MOST_QUERY_BYTES: Final = 64 * 1024
# A million wrenches, the most of a batch, at 17 digits a number and some blanks.
MOST_BATCH_BYTES: Final = 256 * 1024 * 1024


async def read_limited(receive: Receive, most: int = MOST_QUERY_BYTES) -> bytes:
    """Return a request's body.

    Raises
    ------
    ProblemError
        413, as soon as more than `most` bytes have come.
    ClientDisconnect
        If the other side has gone.
    """
    pieces = bytearray()
    more = True
    while more:
        message = await receive()
        if message["type"] == "http.disconnect":
            raise ClientDisconnect
        pieces += message.get("body", b"")
        more = message.get("more_body", False)
        if len(pieces) > most:
            raise too_large(most)
    return bytes(pieces)


def too_large(most: int) -> ProblemError:
    """Return the refusal of a body of more than `most` bytes."""
    detail = f"Send at most {most >> 20} MiB a call; send parts. Nothing was changed."
    if most < 1 << 20:
        detail = (
            f"This call takes at most {most:,} bytes; nothing was changed. Leave out what it "
            "does not need, or send parts."
        )
    return ProblemError(413, "too-large", "The body is too large", detail)


def counted(receive: Receive, most: int) -> Receive:
    """Return a `receive` that raises 413 as soon as more than `most` bytes have come."""
    came = 0

    async def count() -> Message:
        nonlocal came
        message = await receive()
        came += len(message.get("body", b""))
        if came > most:
            raise too_large(most)
        return message

    return count
