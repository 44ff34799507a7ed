"""Records the wrenches of a loop without blocking the loop."""

from __future__ import annotations

import atexit
import http.client
import secrets
import sys
import threading
import time
from collections import deque
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..contract import LOADS, MAX_BLOCK, counted
from .errors import Document, InvalidArgument, ProblemError, ServerTimeout, WrenchbookError
from .recording import KINDS, Kind, Started
from .wrenches import many_wrenches, require_one_of, single_wrench

if TYPE_CHECKING:
    from . import Client

BLOCK = 256  # default number of wrenches in a block: four requests a second at 1 kHz
MAX_PENDING = 100_000  # wrenches in memory, 4.8 MB: 100 s at 1 kHz
FLUSH_S = 1.0  # s after which an incomplete block is sent: a slow loop is recorded too
# Pause between attempts while the server is away, s: doubled from the first to the second.
BACKOFF_S = (0.1, 5.0)
FLOAT_BYTES = 8  # size of a number in a block, float64
AT_EXIT_S = 5.0  # s that the end of the program waits for unsent wrenches
_PASSING = (408, 425, 429)  # statuses besides 5xx after which the same block may be accepted


class RecorderError(WrenchbookError, RuntimeError):
    """Wrenches could not be recorded; the message has the cause, and where they are."""


def _is_passing(error: Exception) -> bool:
    """Return whether the server may accept the same block later; it stores a block only once."""
    if isinstance(error, ProblemError):
        return error.status >= 500 or error.status in _PASSING
    passing = OSError | http.client.HTTPException | ValueError
    return isinstance(error, passing) and not isinstance(error, InvalidArgument)


class Recorder:
    """Send the wrenches of a loop to the server in blocks, each once.

    `add` only appends; a thread of the recorder sends. While the server is away up to 100,000
    wrenches (4.8 MB) wait in memory; beyond that `add` raises. A block is sent under the same key
    until the server acknowledges that it is on disk, so it is recorded once.

    Parameters
    ----------
    client : Client
        A client of the server that records.
    component : str
        Name of the component.
    kind : {"recording", "envelope"}
        LM_direct: every wrench is saved; LM_max: the extremes are.
    block : int
        Wrenches of a block, 1 to 10,000.
    inputs : int
        Numbers of a wrench: of several interfaces six each, then further inputs such as the
        temperature, in the component's order.

    Attributes
    ----------
    recorded : int
        Wrenches that the server has acknowledged.
    reply : dict
        The server's last reply to a block: how the recording stands.

    Raises
    ------
    InvalidArgument
        If `kind` or `block` is none of these; a ValueError.

    Examples
    --------
    >>> with Recorder(client, "plate") as recorder:            # doctest: +SKIP
    ...     for _ in range(60_000):
    ...         recorder.add(wrench)
    ...     recorder.start()
    """

    def __init__(
        self,
        client: Client,
        component: str,
        kind: Kind = "recording",
        block: int = BLOCK,
        inputs: int = len(LOADS),
    ) -> None:
        require_one_of("kind", kind, KINDS)
        if not 1 <= block <= MAX_BLOCK:
            raise InvalidArgument(f"block must be 1 to {MAX_BLOCK} wrenches, not {block}")
        self.component = component
        self.recorded = 0
        self.kind: Kind = kind
        self.reply: Document = {}
        self._client = client
        self._inputs = inputs
        self._width = FLOAT_BYTES * inputs  # bytes of a wrench
        self._size = block * self._width  # bytes of a full block
        self._key = secrets.token_hex(16)
        self._sequence = 0
        self._changed = threading.Condition()
        self._blocks: deque[bytes] = deque()  # full blocks, oldest first
        self._open = bytearray()  # the current block
        self._opened_at = 0.0  # s of the monotonic clock
        self._count = self._sealed = 0  # pending wrenches; full blocks so far
        self._trouble: Exception | None = None
        self._failed = False
        self._closing = False
        self._hurry = False  # whether `flush` waits, which ends the pause between attempts
        self._thread = threading.Thread(target=self._send_all, name="recorder", daemon=True)
        self._thread.start()
        atexit.register(self._at_exit)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:
            self.close()
            return
        try:
            self.close()
        except RecorderError as error:  # the loop's own error must be raised
            print(f"wrenchbook: {error}", file=sys.stderr)

    @property
    def pending(self) -> int:
        """Wrenches that the server has not acknowledged."""
        return self._count

    @property
    def trouble(self) -> str | None:
        """The reason for which nothing can be sent at present; None if it can."""
        return None if self._trouble is None else str(self._trouble)

    def add(self, wrench: ArrayLike) -> None:
        """Add one wrench, shape (inputs,), N and N·m, without waiting for the server.

        Raises
        ------
        ValueError
            If it is not so many finite numbers; it was not taken.
        RecorderError
            If the server refuses what is recorded, if 100,000 wrenches wait, or after `close`.
        """
        shape = np.shape(wrench)
        is_default = self._inputs == len(LOADS)
        if shape != (self._inputs,):
            form = "six numbers, force then moment" if is_default else f"{self._inputs} numbers"
            raise InvalidArgument(
                f"a wrench must be {form}, but this one has the shape {shape}; for a component "
                "with another number of inputs create the Recorder with inputs=NUMBER"
            )
        checked = single_wrench(wrench) if is_default else many_wrenches(np.stack([wrench]), None)
        packed = checked.astype("<f8").tobytes()

        with self._changed:
            if self._closing:
                raise RecorderError("the Recorder is closed; create a new Recorder")
            self._check_failed()
            if self._count >= MAX_PENDING:
                raise RecorderError(
                    f"the wrench was not recorded, because {self._count} wrenches wait for the "
                    f"server ({self._trouble or 'it is slow'}). Slow the loop, or call flush(); "
                    "`unsent` returns the wrenches not sent"
                )
            if not self._open:
                self._opened_at = time.monotonic()
            self._open += packed
            self._count += 1
            if len(self._open) >= self._size:
                self._seal()
                self._changed.notify_all()

    def unsent(self) -> NDArray[np.float64]:
        """Return the wrenches not acknowledged, shape (n, inputs), N and N·m, to keep elsewhere."""
        with self._changed:
            packed = b"".join([*self._blocks, self._open])
        return np.frombuffer(packed, dtype="<f8").reshape(-1, self._inputs).astype(float)

    def flush(self, timeout_s: float = 30.0) -> None:
        """Wait until all that was added is on the server's disk.

        Raises
        ------
        ServerTimeout
            If it is not after `timeout_s`; it stays here, and is sent as soon as it can be.
        RecorderError
            If the server refuses it.
        """
        with self._changed:
            self._seal()
            sealed = self._sealed
            self._hurry = self._sequence < sealed
            self._changed.notify_all()
            self._changed.wait_for(lambda: self._failed or self._sequence >= sealed, timeout_s)
            if self._sequence >= sealed:
                return
            self._check_failed()
            raise ServerTimeout(
                f"{_wrenches_are(self._count)} not recorded after {timeout_s:g} s: "
                f"{self._trouble or 'the server is slow'}. The Recorder keeps them and sends them "
                "when the server answers; check that it runs"
            )

    def start(
        self, timeout_s: float = 30.0, *, budget: int | None = None, beyond_range: bool = False
    ) -> Started:
        """LM_start: `flush`, then queue the solves of the recorded wrenches.

        Raises
        ------
        ServerTimeout, RecorderError
            As `flush`; then nothing was queued.
        ProblemError
            If the component cannot be solved (409).
        """
        self.flush(timeout_s)
        if self.kind == "envelope":
            return self._client.start_envelope(self.component, beyond_range=beyond_range)
        return self._client.start_recording(self.component, budget, beyond_range=beyond_range)

    def close(self, timeout_s: float = 10.0) -> None:
        """Send the pending wrenches and end.

        Raises
        ------
        RecorderError
            If not all were sent in time; `unsent` returns the others.
        """
        cause: Exception | None = None
        if not self._closing:
            try:
                self.flush(timeout_s)
            except (ServerTimeout, RecorderError) as error:
                cause = error
            with self._changed:
                self._closing = True
                self._changed.notify_all()
        self._thread.join(timeout_s)
        atexit.unregister(self._at_exit)
        if self.pending:
            why = self.trouble or f"the server has not acknowledged them in {timeout_s:g} s"
            raise RecorderError(
                f"{_wrenches_are(self.pending)} not recorded for {self.component!r}: {why}. "
                "Correct this, then give the wrenches that `unsent` returns to a new Recorder"
            ) from cause

    def _send_all(self) -> None:
        """Send full blocks in order until the recorder closes; pause while the server is away."""
        wait, longest = BACKOFF_S
        while True:
            with self._changed:
                while not self._blocks:
                    if self._closing:
                        return
                    self._changed.wait(FLUSH_S)
                    if not self._blocks and time.monotonic() - self._opened_at >= FLUSH_S:
                        self._seal()
                block = self._blocks[0]

            try:
                arguments = block, self._inputs, self._key, self._sequence
                reply = self._client.send_block(self.component, self.kind, *arguments)
            except Exception as error:
                with self._changed:
                    self._trouble = error
                    self._failed = not _is_passing(error)
                    self._changed.notify_all()
                    if self._failed:
                        return
                    self._changed.wait_for(lambda: self._closing or self._hurry, wait)
                    self._hurry = False
                    if self._closing:
                        return
                wait = min(2 * wait, longest)
            else:
                wait = BACKOFF_S[0]
                count = len(block) // self._width
                with self._changed:
                    self._blocks.popleft()
                    self._count -= count
                    self.recorded += count
                    self._sequence += 1
                    self._hurry = False
                    self.reply = reply
                    self._trouble = None
                    self._changed.notify_all()

    def _seal(self) -> None:
        """Close the current block, which is then full."""
        if self._open:
            self._blocks.append(bytes(self._open))
            self._open.clear()
            self._sealed += 1

    def _check_failed(self) -> None:
        """Raise the error that the sending thread met, if any."""
        if self._failed:
            raise RecorderError(
                f"the server refused the recording of {self.component!r}: {self._trouble}. "
                f"{_wrenches_are(self._count)} not stored. Correct this, then give the wrenches "
                "that `unsent` returns to a new Recorder"
            ) from self._trouble

    def _at_exit(self) -> None:
        """Close a recorder that the program has not closed; print the number of lost wrenches."""
        if not self.pending:
            return
        try:
            self.close(AT_EXIT_S)
        except RecorderError as error:
            print(f"wrenchbook: {error}", file=sys.stderr)


def _wrenches_are(count: int) -> str:
    """Return the begin of a statement: ``1 wrench is``, ``2 wrenches are``."""
    return f"{counted(count, 'wrench')} {'is' if count == 1 else 'are'}"
