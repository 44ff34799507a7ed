"""RecordingStore wrenches in a loop, without waiting for the server."""

from __future__ import annotations

import atexit
import http.client
import secrets
import sys
import threading
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .errors import ProblemError, ServerTimeout
from .recording_calls import KINDS, MOST_BLOCK, Kind, RecordingCalls, Started
from .spill import Blocks
from .wrenches import one_wrench

BLOCK = 256
FLUSH_S = 1.0  # a block that is not full is sent after this long: a slow loop is recorded too
BACKOFF_S = (0.1, 5.0)  # between attempts while the server is away: doubled from, up to
AT_EXIT_S = 5.0  # how long the end of the program waits for what is not sent
_AGAIN = (408, 425, 429)  # statuses besides 5xx after which the same block may be taken


class RecorderError(RuntimeError):
    """Wrenches could not be recorded; the text says why, and what became of them."""


class Recorder:
    """Take a loop's wrenches and bring them to the server in blocks, each once.

    `add` only appends; a thread of the recorder's own sends. While the server is away blocks wait:
    100,000 wrenches in memory (4.8 MB), then a temporary file that grows to 20 million (1 GB) until
    it has been read; only beyond that `add` raises. A block is sent under the same key until the
    server says that it is on its disk, so it is there once, whatever was killed in between.

    Parameters
    ----------
    client : Client
        Of the server that records.
    component : str
    kind : {"recording", "envelope"}
        LM_direct: every wrench is saved; LM_max: the extremes are.
    block : int
        Wrenches of a block, 1 to 10,000.

    Attributes
    ----------
    recorded : int
        Wrenches that the server has acknowledged.
    reply : dict
        The server's last reply to a block: how the recording stands.

    Raises
    ------
    ValueError
        If `kind` or `block` is none of these.

    Examples
    --------
    >>> with Recorder(client, "plate") as recorder:            # doctest: +SKIP
    ...     for _ in range(60_000):
    ...         recorder.add(wrench)
    ...     recorder.start()
    """

    def __init__(
        self, client: RecordingCalls, component: str, kind: Kind = "recording", block: int = BLOCK
    ) -> None:
        if kind not in KINDS:
            raise ValueError(f"kind must be one of {', '.join(KINDS)}, not {kind!r}")
        if not 1 <= block <= MOST_BLOCK:
            raise ValueError(f"block must be 1 to {MOST_BLOCK} wrenches, not {block}")
        self.component, self.recorded = component, 0
        self.kind: Kind = kind
        self.reply: dict[str, Any] = {}
        self._client, self._size = client, block
        self._key, self._sequence = secrets.token_hex(16), 0
        self._changed = threading.Condition()
        self._blocks = Blocks(block)
        self._trouble: Exception | None = None
        self._failed, self._closing = False, False
        self._hurry = False  # somebody waits in `flush`: the pause between attempts ends
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
        except RecorderError as error:  # the loop's own error is the one to be seen
            print(f"wrenchbook: {error}", file=sys.stderr)

    @property
    def pending(self) -> int:
        """Wrenches that the server has not acknowledged."""
        with self._changed:
            return self._blocks.count

    @property
    def spilled(self) -> int:
        """Those of them that wait in the temporary file."""
        with self._changed:
            return self._blocks.spilled

    @property
    def trouble(self) -> str | None:
        """Why nothing can be sent at present; None if it can."""
        return None if self._trouble is None else str(self._trouble)

    def add(self, wrench: ArrayLike) -> None:
        """Take one wrench, shape (6,), N and N·m; the server is not waited for.

        Raises
        ------
        ValueError
            If it is not six finite numbers; it was not taken.
        RecorderError
            If the server refuses what is recorded, if there is no more room, or after `close`.
        """
        if np.shape(wrench) != (6,):
            shape = np.shape(wrench)
            raise ValueError(f"a wrench is six numbers, force then moment; this has shape {shape}")
        packed = one_wrench(wrench).astype("<f8").tobytes()
        with self._changed:
            self._check()
            try:
                whole = self._blocks.add(packed)
            except OSError as error:
                raise RecorderError(
                    f"the wrench was not taken: {error}. {self._blocks.count} wrenches wait for "
                    f"the server ({self._trouble or 'it is slow'}); see `unsent`"
                ) from error
            if whole:
                self._changed.notify_all()

    def unsent(self) -> NDArray[np.float64]:
        """Return the wrenches not acknowledged, shape (n, 6), N and N·m, to be kept elsewhere."""
        with self._changed:
            return np.frombuffer(self._blocks.all(), dtype="<f8").reshape(-1, 6).astype(float)

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
            last, self._hurry = self._blocks.last, True
            self._changed.notify_all()
            self._changed.wait_for(lambda: self._failed or self._sequence > last, timeout_s)
            if self._sequence > last:
                return
            self._check_failed()
            raise ServerTimeout(
                f"{self._blocks.count} wrenches are not recorded after {timeout_s:g} s: "
                f"{self._trouble or 'the server is slow'}. They are kept here and sent as soon as "
                "it answers"
            )

    def start(
        self, timeout_s: float = 30.0, *, budget: int | None = None, beyond_range: bool = False
    ) -> Started:
        """LM_start: `flush`, then queue the solves of what is recorded.

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
        """Send what is left and end.

        Raises
        ------
        RecorderError
            If not all could be sent in time; `unsent` has the rest.
        """
        atexit.unregister(self._at_exit)
        if self._closing:
            return
        why: Exception | None = None
        try:
            self.flush(timeout_s)
        except (ServerTimeout, RecorderError) as error:
            why = error
        with self._changed:
            self._closing = True
            self._changed.notify_all()
        self._thread.join(timeout_s)
        if self.pending:
            raise RecorderError(
                f"{self.pending} wrenches of {self.component!r} were not recorded: {why}. "
                "`unsent` returns them; record them once the server answers"
            ) from why
        with self._changed:
            self._blocks.close()

    def _send_all(self) -> None:
        wait, longest = BACKOFF_S
        while (block := self._next()) is not None:
            try:
                reply = self._client.send_block(
                    self.component, self.kind, block, self._key, self._sequence
                )
            except Exception as error:
                self._note(error)
                with self._changed:
                    if self._failed:
                        return
                    self._changed.wait_for(lambda: self._closing or self._hurry, wait)
                    self._hurry = False
                    if self._closing:
                        return
                wait = min(2 * wait, longest)
            else:
                wait = BACKOFF_S[0]
                with self._changed:
                    self._blocks.drop_first()
                    self.recorded += len(block) // 48
                    self._sequence += 1
                    self.reply, self._trouble = reply, None
                    self._changed.notify_all()

    def _next(self) -> bytes | None:
        """Wait for a block, and return it; None at the end."""
        with self._changed:
            while True:
                block = self._blocks.first()
                if block is not None:
                    return block
                if self._closing:
                    return None
                self._changed.wait(FLUSH_S)
                self._blocks.seal_older_than(FLUSH_S)

    def _note(self, error: Exception) -> None:
        """Keep what went wrong, and tell whether the block can be taken later."""
        # Sending a block once more is safe, so what may be over the next time is tried again.
        again = isinstance(error, OSError | http.client.HTTPException | ValueError)
        if isinstance(error, ProblemError):
            again = error.status >= 500 or error.status in _AGAIN
        with self._changed:
            self._trouble, self._failed = error, not again
            self._changed.notify_all()

    def _seal(self) -> None:
        try:
            self._blocks.seal()
        except OSError as error:
            raise RecorderError(f"the last wrenches still wait for room: {error}") from error

    def _check(self) -> None:
        if self._closing:
            raise RecorderError("the recorder is closed; make another one")
        self._check_failed()

    def _check_failed(self) -> None:
        if self._failed:
            raise RecorderError(
                f"the server refuses what is recorded of {self.component!r}: {self._trouble}. "
                f"{self._blocks.count} wrenches were not taken; `unsent` returns them"
            ) from self._trouble

    def _at_exit(self) -> None:
        """Send what a program leaves that has not closed its recorder, or say what is lost."""
        if not self.pending:
            return
        try:
            self.close(AT_EXIT_S)
        except RecorderError as error:
            print(f"wrenchbook: {error}", file=sys.stderr)
