"""Recordings (LM_direct) and envelopes (LM_max) of a loop's wrenches; their solves (LM_start)."""

from __future__ import annotations

import secrets
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from .. import messages
from ..contract import MAX_BLOCK
from ..messages import Envelope, Recording
from .errors import Document, Json
from .job import Job
from .transport import BINARY, Connection, component_path
from .wrenches import Tolerance, many_wrenches, options, tolerance_body

Kind = Literal["recording", "envelope"]
KINDS: tuple[Kind, ...] = ("recording", "envelope")


class Started(messages.Started):
    """What a start has queued: its ``jobs``; counts of the other wrenches, and the ``reason``."""

    jobs: tuple[Job, ...]


class RecordingCalls(Connection):
    """Save wrenches for later, track extremes, and have them solved.

    A loop of 1 kHz uses a `Recorder`, which never waits for the server.
    """

    def record(self, name: str, wrenches: ArrayLike) -> Document:
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
        return self._send_blocks(name, "recording", wrenches)

    def recording(self, name: str) -> Recording:
        """Return the recorded wrenches of a component, with their counts.

        Raises ProblemError (404) if there is no such component.
        """
        return Recording.read(self.call_json("GET", component_path(name, "recording")))

    def clear_recording(self, name: str) -> int:
        """Delete a component's recording; return the number of its wrenches."""
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
        return self._start(component_path(name, "recording/start"), name, body)

    def widen_envelope(self, name: str, wrenches: ArrayLike) -> Document:
        """LM_max: widen a component's envelope by wrenches, shape (n, inputs), N and N·m.

        Returns
        -------
        dict
            ``recorded``, ``count``, ``min`` and ``max``. Errors are those of `record`.
        """
        return self._send_blocks(name, "envelope", wrenches)

    def envelope(self, name: str, tolerance: Tolerance | None = None) -> Envelope:
        """Return a component's envelope; with `tolerance` (m, rad) in the place of its own."""
        query = None if tolerance is None else tolerance_body(tolerance)
        return Envelope.read(self.call_json("GET", component_path(name, "envelope"), query=query))

    def clear_envelope(self, name: str) -> int:
        """Delete a component's envelope; return the number of its wrenches."""
        return self.call_json("DELETE", component_path(name, "envelope"))["cleared"]

    def start_envelope(self, name: str, *, beyond_range: bool = False) -> Started:
        """Queue the solves of the wrenches at a component's extremes; as `start_recording`."""
        body = options(beyond_range=beyond_range or None)
        return self._start(component_path(name, "envelope/start"), name, body)

    def resolve(
        self, name: str, budget: int | None = None, *, beyond_range: bool = False
    ) -> Started:
        """Queue a solve for each wrench that only rows of another setup of a component have.

        A component whose files change is another setup: its earlier rows leave the table
        (``another_setup`` of `component`). Parameters and errors are those of `start_recording`.
        """
        body = options(budget=budget, beyond_range=beyond_range or None)
        return self._start(component_path(name, "table/resolve"), name, body)

    def _start(self, path: str, name: str, body: Json) -> Started:
        reply = self.call_json("POST", path, body)
        return Started.read(reply, jobs=Job.read_all(reply, name))

    def send_block(
        self,
        name: str,
        kind: Kind,
        wrenches: bytes,
        inputs: int,
        client: str,
        sequence: int,
        *,
        retry: bool = False,
    ) -> Document:
        """Send a block of packed wrenches, little-endian float64 (n, inputs), under its key.

        A block that is sent several times counts once. `retry` as of `Connection.call`.
        """
        query = {"client": client, "inputs": inputs, "sequence": sequence}
        path = component_path(name, kind)
        return self.call("POST", path, wrenches, kind=BINARY, query=query, retry=retry).json()

    def _send_blocks(self, name: str, kind: Kind, wrenches: ArrayLike) -> Document:
        """Send wrenches, shape (n, inputs), N and N·m, in as many blocks as needed."""
        block = many_wrenches(wrenches, None)
        key = secrets.token_hex(16)
        reply = {}
        for sequence, start in enumerate(range(0, max(len(block), 1), MAX_BLOCK)):
            part = np.ascontiguousarray(block[start : start + MAX_BLOCK], dtype="<f8").tobytes()
            width = block.shape[1]
            reply = self.send_block(name, kind, part, width, key, sequence, retry=True)
        return reply | {"recorded": len(block)}
