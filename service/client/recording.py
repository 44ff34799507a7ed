"""Recordings (LM_direct) and envelopes (LM_max): what a loop has met, and its solves (LM_start)."""

from __future__ import annotations

import secrets
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import messages
from ..contract import LOADS, MAX_BLOCK
from ..messages import Envelope, Recording
from .errors import Document, InvalidArgument
from .job import Job
from .request import BINARY, Call, Request, component_path, json_request, sync_and_async
from .wrenches import Tolerance, many_wrenches, options, tolerance_body

Kind = Literal["recording", "envelope"]
KINDS: tuple[Kind, ...] = ("recording", "envelope")

Vector = NDArray[np.float64]


class Started(messages.Started):
    """What a start has queued: its ``jobs``; counts of the other wrenches, and the ``reason``."""

    jobs: tuple[Job, ...]


class RecordingCalls:
    """Save wrenches for later, track extremes, and have them solved.

    A loop of 1 kHz uses a `Recorder`, which never waits for the server.
    """

    @sync_and_async
    def record(self, name: str, wrenches: ArrayLike) -> Call[Document]:
        """LM_direct: save wrenches, shape (n, inputs), N and N·m, in a component's recording.

        Returns
        -------
        dict
            ``recorded``, and how the recording stands: ``total``, ``kept``, ``merged``,
            ``thinned``, ``outside`` and ``reason``.

        Raises
        ------
        ValueError
            If a number is not finite or a shape is wrong; nothing was sent.
        ProblemError
            If there is no such component (404).
        ServerUnreachable, ServerTimeout
            See `Connection.call`; `recording` then has what was recorded.
        """
        return (yield from _send_blocks(name, "recording", wrenches))

    @sync_and_async
    def recording(self, name: str) -> Call[Recording]:
        """Return what is recorded of a component; raises ProblemError (404)."""
        return Recording.read((yield json_request("GET", component_path(name, "recording"))).json())

    @sync_and_async
    def clear_recording(self, name: str) -> Call[int]:
        """Forget a component's recording, and return how many wrenches it had taken in."""
        return (yield json_request("DELETE", component_path(name, "recording"))).json()["cleared"]

    @sync_and_async
    def start_recording(
        self, name: str, budget: int | None = None, *, beyond_range: bool = False
    ) -> Call[Started]:
        """LM_start: queue the solves of recorded wrenches that the table does not cover.

        Parameters
        ----------
        name : str
            The component.
        budget : int, optional
            New solves to queue at most, those farthest from what is known first; all otherwise.
        beyond_range : bool
            Whether wrenches outside the load range are solved as well.

        Raises
        ------
        ProblemError
            If the component is a table only and cannot be solved (409).
        """
        body = options(budget=budget, beyond_range=beyond_range or None)
        return (yield from _start(name, "recording/start", body))

    @sync_and_async
    def widen_envelope(self, name: str, wrenches: ArrayLike) -> Call[Document]:
        """LM_max: widen a component's envelope by wrenches, shape (n, inputs), N and N·m.

        Returns
        -------
        dict
            ``recorded``, ``count``, ``min`` and ``max``. Errors are those of `record`.
        """
        return (yield from _send_blocks(name, "envelope", wrenches))

    @sync_and_async
    def envelope(self, name: str, tolerance: Tolerance | None = None) -> Call[Envelope]:
        """Return a component's envelope; with `tolerance` (m, rad) in the place of its own."""
        query = None if tolerance is None else tolerance_body(tolerance)
        reply = yield json_request("GET", component_path(name, "envelope"), query=query)
        return Envelope.read(reply.json())

    @sync_and_async
    def clear_envelope(self, name: str) -> Call[int]:
        """Forget a component's envelope, and return how many wrenches it had taken in."""
        return (yield json_request("DELETE", component_path(name, "envelope"))).json()["cleared"]

    @sync_and_async
    def start_envelope(self, name: str, *, beyond_range: bool = False) -> Call[Started]:
        """Queue the solves of the wrenches at a component's extremes; as `start_recording`."""
        body = options(beyond_range=beyond_range or None)
        return (yield from _start(name, "envelope/start", body))

    @sync_and_async
    def resolve(
        self, name: str, budget: int | None = None, *, beyond_range: bool = False
    ) -> Call[Started]:
        """Queue a solve for each wrench that only rows of another setup of a component have.

        A component whose files change is another setup: its earlier rows leave the table
        (``another_setup`` of `component`). Parameters and errors are those of `start_recording`.
        """
        body = options(budget=budget, beyond_range=beyond_range or None)
        return (yield from _start(name, "table/resolve", body))

    @sync_and_async
    def send_block(
        self, name: str, kind: Kind, wrenches: bytes, client: str, sequence: int
    ) -> Call[Document]:
        """Send a block of packed wrenches, little-endian float64 (n, inputs), under its key.

        However often it is sent, it is taken in once. A refused connection is not tried again.
        """
        return (yield _block_request(name, kind, wrenches, client, sequence)).json()


def _block_request(
    name: str, kind: Kind, wrenches: bytes, client: str, sequence: int, *, retry: bool = False
) -> Request:
    query = {"client": client, "sequence": sequence}
    return Request("POST", component_path(name, kind), wrenches, BINARY, query, retry=retry)


def _send_blocks(name: str, kind: Kind, wrenches: ArrayLike) -> Call[Document]:
    """Send wrenches, shape (n, inputs), N and N·m, in as many blocks as it takes."""
    block, client, reply = checked_rows(wrenches), secrets.token_hex(16), {}
    for sequence, start in enumerate(range(0, max(len(block), 1), MAX_BLOCK)):
        part = np.ascontiguousarray(block[start : start + MAX_BLOCK], dtype="<f8").tobytes()
        reply = (yield _block_request(name, kind, part, client, sequence, retry=True)).json()
    return reply | {"recorded": len(block)}


def _start(name: str, call: str, body: Document) -> Call[Started]:
    return Started.read((yield json_request("POST", component_path(name, call), body)).json())


def checked_rows(wrenches: ArrayLike) -> Vector:
    """Return checked wrenches of six or more inputs, shape (n, inputs); see `many_wrenches`."""
    try:
        rows = np.array(wrenches, dtype=float)
    except (TypeError, ValueError):
        return many_wrenches(wrenches)
    if rows.ndim != 2 or rows.shape[1] <= len(LOADS):
        return many_wrenches(wrenches)
    if not np.isfinite(rows).all():
        raise InvalidArgument("a wrench has a number that is not finite")
    return rows
