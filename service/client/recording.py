"""Recordings (LM_direct) and envelopes (LM_max): what a loop has met, and its solves (LM_start)."""

from __future__ import annotations

import secrets
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..contract import LOADS, MAX_BLOCK
from .errors import InvalidArgument
from .job import Job
from .request import BINARY, Call, Request, component_path, json_request, sync_and_async
from .wrenches import many_wrenches, options, tolerance_body

Kind = Literal["recording", "envelope"]
KINDS: tuple[Kind, ...] = ("recording", "envelope")

Vector = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Recording:
    """What the server has recorded of a component.

    Parameters
    ----------
    wrenches : numpy.ndarray
        Shape (n, inputs), N and N·m: those kept, in the order they came.
    total, merged, thinned, outside : int
        Wrenches taken in since it was cleared; of them those within 1e-6 of the load range of one
        kept, those thinned out beyond 10,000, and those outside the load range.
    within : float
        Every wrench taken in differs from one kept by at most this share of the load range.
    """

    wrenches: Vector
    total: int
    merged: int
    thinned: int
    outside: int
    within: float
    raw: dict[str, Any] = field(default_factory=dict, repr=False)

    @classmethod
    def read(cls, body: Mapping[str, Any]) -> Self:
        """Make one from the server's reply."""
        return cls(
            _block(body["wrenches"]),
            body["total"],
            body["merged"],
            body["thinned"],
            body["outside"],
            body["within"],
            dict(body),
        )

    def __len__(self) -> int:
        return len(self.wrenches)


@dataclass(frozen=True, eq=False)
class Envelope:
    """The extremes of each load, and how far they can move the component.

    Parameters
    ----------
    min, max : numpy.ndarray
        Shape (inputs,), N and N·m; NaN before the first wrench.
    count : int
        Wrenches taken in since it was cleared.
    at_min, at_max : numpy.ndarray
        Shape (inputs, inputs): line i is the whole wrench at the least, the largest input i.
    displacement_bound : numpy.ndarray
        Shape (outputs,), m and rad; NaN where nothing is known.
    negligible : bool or None
        Whether that is within the tolerance; None if it is not known, see `reason`.
    bound : str
        ``bound``, ``estimate`` or ``unknown``: what `displacement_bound` is.
    reason : str
        Why it is not known, or what it rests on.
    """

    min: Vector
    max: Vector
    count: int
    at_min: Vector
    at_max: Vector
    displacement_bound: Vector
    negligible: bool | None
    bound: str
    reason: str
    raw: dict[str, Any] = field(default_factory=dict, repr=False)

    @classmethod
    def read(cls, body: Mapping[str, Any]) -> Self:
        """Make one from the server's reply."""
        return cls(
            np.array(body["min"], dtype=float),
            np.array(body["max"], dtype=float),
            body["count"],
            _block(body["at_min"]),
            _block(body["at_max"]),
            np.array(body["displacement_bound"], dtype=float),
            body["negligible"],
            body["bound"]["kind"],
            body["reason"],
            dict(body),
        )


@dataclass(frozen=True, eq=False)
class Started:
    """What a start has queued, and what of the rest.

    Parameters
    ----------
    jobs : tuple of Job
        Those that wait or run for these wrenches.
    solved, covered, failed, beyond_range, left : int
        Wrenches that a row of the table has, that the table covers, whose solve has failed before,
        that lie outside the load range, and that the budget leaves.
    reason : str
        Why not all, or why none; empty if all are queued.
    """

    jobs: tuple[Job, ...]
    solved: int
    covered: int
    failed: int
    beyond_range: int
    left: int
    reason: str

    @classmethod
    def read(cls, body: Mapping[str, Any]) -> Self:
        """Make one from the server's reply."""
        jobs = tuple(Job.read(job) for job in body["jobs"])
        names = ("solved", "covered", "failed", "beyond_range", "left", "reason")
        return cls(jobs, *(body[name] for name in names))


class RecordingCalls:
    """Save wrenches for later, track extremes, and have them solved.

    A loop of 1 kHz uses a `Recorder`, which never waits for the server.
    """

    @sync_and_async
    def record(self, name: str, wrenches: ArrayLike) -> Call[dict[str, Any]]:
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
    def widen_envelope(self, name: str, wrenches: ArrayLike) -> Call[dict[str, Any]]:
        """LM_max: widen a component's envelope by wrenches, shape (n, inputs), N and N·m.

        Returns
        -------
        dict
            ``recorded``, ``count``, ``min`` and ``max``. Errors are those of `record`.
        """
        return (yield from _send_blocks(name, "envelope", wrenches))

    @sync_and_async
    def envelope(self, name: str, tolerance: Any = None) -> Call[Envelope]:
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
    ) -> Call[dict[str, Any]]:
        """Send a block of packed wrenches, little-endian float64 (n, inputs), under its key.

        However often it is sent, it is taken in once. A refused connection is not tried again.
        """
        return (yield _block_request(name, kind, wrenches, client, sequence)).json()


def _block_request(
    name: str, kind: Kind, wrenches: bytes, client: str, sequence: int, *, retry: bool = False
) -> Request:
    query = {"client": client, "sequence": sequence}
    return Request("POST", component_path(name, kind), wrenches, BINARY, query, retry=retry)


def _send_blocks(name: str, kind: Kind, wrenches: ArrayLike) -> Call[dict[str, Any]]:
    """Send wrenches, shape (n, inputs), N and N·m, in as many blocks as it takes."""
    block, client, reply = checked_rows(wrenches), secrets.token_hex(16), {}
    for sequence, start in enumerate(range(0, max(len(block), 1), MAX_BLOCK)):
        part = np.ascontiguousarray(block[start : start + MAX_BLOCK], dtype="<f8").tobytes()
        reply = (yield _block_request(name, kind, part, client, sequence, retry=True)).json()
    return reply | {"recorded": len(block)}


def _start(name: str, call: str, body: dict[str, Any]) -> Call[Started]:
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


def _block(rows: Any) -> Vector:
    return np.array(rows, dtype=float).reshape(len(rows), -1 if rows else len(LOADS))
