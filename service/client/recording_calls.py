"""Recordings (LM_direct) and envelopes (LM_max): what a loop has met, and its solves (LM_start)."""

from __future__ import annotations

import secrets
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .connection import Connection
from .job import Job
from .questions import component_path
from .wrenches import many_wrenches, options, tolerance_body

Kind = Literal["recording", "envelope"]
KINDS: tuple[Kind, ...] = ("recording", "envelope")
MOST_BLOCK = 10_000  # wrenches the server takes in one call
_BINARY = "application/octet-stream"

Vector = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Recording:
    """What the server has recorded of a component.

    Parameters
    ----------
    wrenches : numpy.ndarray
        Shape (n, 6), N and N·m: those kept, in the order they came.
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
        Shape (6,), N and N·m; NaN before the first wrench.
    count : int
        Wrenches taken in since it was cleared.
    at_min, at_max : numpy.ndarray
        Shape (6, 6), N and N·m: line i is the whole wrench at the least, the largest load i.
    displacement_bound : numpy.ndarray
        Shape (6,), m and rad; NaN where nothing is known.
    negligible : bool or None
        Whether that is within the tolerance; None if it cannot be told, see `reason`.
    bound : str
        ``bound``, ``estimate`` or ``unknown``: what `displacement_bound` is.
    reason : str
        Why it cannot be told, or what it rests on.
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


class RecordingCalls(Connection):
    """Save wrenches for later, track extremes, and have them solved.

    A loop of 1 kHz uses a `Recorder`, which never waits for the server.
    """

    def record(self, name: str, wrenches: ArrayLike) -> dict[str, Any]:
        """LM_direct: save wrenches, shape (n, 6), N and N·m, in a component's recording.

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
            See `Connection.call`; what was recorded then is told by `recording`.
        """
        return self._gather(name, "recording", wrenches)

    def recording(self, name: str) -> Recording:
        """Return what is recorded of a component; raises ProblemError (404)."""
        return Recording.read(self.call_json("GET", component_path(name, "recording")))

    def clear_recording(self, name: str) -> int:
        """Forget a component's recording, and return how many wrenches it had taken in."""
        return self.call_json("DELETE", component_path(name, "recording"))["cleared"]

    def start_recording(
        self, name: str, budget: int | None = None, *, beyond_range: bool = False
    ) -> Started:
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
        return Started.read(self.call_json("POST", component_path(name, "recording/start"), body))

    def widen_envelope(self, name: str, wrenches: ArrayLike) -> dict[str, Any]:
        """LM_max: widen a component's envelope by wrenches, shape (n, 6), N and N·m.

        Returns
        -------
        dict
            ``recorded``, ``count``, ``min`` and ``max``. Errors are those of `record`.
        """
        return self._gather(name, "envelope", wrenches)

    def envelope(self, name: str, tolerance: Any = None) -> Envelope:
        """Return a component's envelope; with `tolerance` (m, rad) in the place of its own."""
        query = None if tolerance is None else tolerance_body(tolerance)
        return Envelope.read(self.call_json("GET", component_path(name, "envelope"), query=query))

    def clear_envelope(self, name: str) -> int:
        """Forget a component's envelope, and return how many wrenches it had taken in."""
        return self.call_json("DELETE", component_path(name, "envelope"))["cleared"]

    def start_envelope(self, name: str, *, beyond_range: bool = False) -> Started:
        """Queue the solves of the wrenches at a component's extremes; as `start_recording`."""
        body = options(beyond_range=beyond_range or None)
        return Started.read(self.call_json("POST", component_path(name, "envelope/start"), body))

    def resolve(
        self, name: str, budget: int | None = None, *, beyond_range: bool = False
    ) -> Started:
        """Queue a solve for each wrench that only rows of another setup of a component have.

        A component whose files change is another setup: its earlier rows leave the table
        (``another_setup`` of `component`). Parameters and errors are those of `start_recording`.
        """
        body = options(budget=budget, beyond_range=beyond_range or None)
        return Started.read(self.call_json("POST", component_path(name, "table/resolve"), body))

    def send_block(
        self, name: str, kind: Kind, wrenches: bytes, client: str, sequence: int
    ) -> dict[str, Any]:
        """Send a block of packed wrenches, little-endian float64 (n, 6), under its key.

        However often it is sent, it is taken in once.
        """
        query = {"client": client, "sequence": sequence}
        path = component_path(name, kind)
        return self.call("POST", path, wrenches, kind=_BINARY, query=query).json()

    def _gather(self, name: str, kind: Kind, wrenches: ArrayLike) -> dict[str, Any]:
        """Send wrenches, shape (n, 6), N and N·m, in as many blocks as it takes."""
        block, client, reply = many_wrenches(wrenches), secrets.token_hex(16), {}
        for start in range(0, max(len(block), 1), MOST_BLOCK):
            part = np.ascontiguousarray(block[start : start + MOST_BLOCK], dtype="<f8")
            reply = self.send_block(name, kind, part.tobytes(), client, start // MOST_BLOCK)
        return reply | {"recorded": len(block)}


def _block(rows: Any) -> Vector:
    return np.array(rows, dtype=float).reshape(-1, 6)
