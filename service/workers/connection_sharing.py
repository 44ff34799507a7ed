"""Connections shared evenly by processes that listen on one socket.

The kernel wakes all who wait for a connection and gives it to the first, and whoever is first takes
what else has come as well: of eight connections of a loop's, one process of two took all eight. So
each takes one at a time, and leaves it for a moment to one that has fewer.
"""

from __future__ import annotations

import asyncio
import mmap
import os
import socket
from collections.abc import Callable, Sized
from pathlib import Path
from typing import Any

# How long one that has more leaves a connection to the others: longer than most answers, so that
# who has fewer and is at one comes to take it; no longer, since it may be stopped or dead.
LEAVE_S = 0.01
_NUMBER = 4  # bytes: of a count, written and read in one go


class ConnectionCounts:
    """How many connections each process has, in memory that all of them share.

    Parameters
    ----------
    path : path
        Made if there is none.
    number, processes : int
        Which process this is, from 1, and how many there are.
    """

    def __init__(self, path: Path, number: int, processes: int) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        try:
            os.ftruncate(descriptor, _NUMBER * processes)
            self._counts = memoryview(mmap.mmap(descriptor, _NUMBER * processes)).cast("I")
        finally:
            os.close(descriptor)
        self._own = number - 1
        self.tell(0)

    def tell(self, count: int) -> None:
        """Say how many this process has."""
        self._counts[self._own] = count

    def others_have_fewer(self) -> bool:
        """Return whether another process has fewer than this one."""
        return min(self._counts) < self._counts[self._own]


class Acceptor:
    """Takes the connections of a socket that other processes listen on too; for the loop.

    Parameters
    ----------
    listening : socket
    counts : ConnectionCounts
    open_ones : sized
        The connections of this process.
    protocol : callable
        Makes the protocol of one.
    """

    def __init__(
        self,
        listening: socket.socket,
        counts: ConnectionCounts,
        open_ones: Sized,
        protocol: Callable[[], asyncio.Protocol],
    ) -> None:
        self._listening, self._counts = listening, counts
        self._open, self._protocol = open_ones, protocol
        self._loop = asyncio.get_running_loop()
        self._left: asyncio.TimerHandle | None = None
        self._begun: set[asyncio.Task[Any]] = set()
        listening.setblocking(False)

    def start(self) -> None:
        """Take connections from now on."""
        self._loop.add_reader(self._listening, self._look)

    def stop(self) -> None:
        """Take no more, and let go of the socket."""
        self._loop.remove_reader(self._listening)
        if self._left is not None:
            self._left.cancel()
        self._listening.close()

    def _look(self) -> None:
        self._counts.tell(len(self._open) + len(self._begun))
        if self._counts.others_have_fewer():
            self._loop.remove_reader(self._listening)
            self._left = self._loop.call_later(LEAVE_S, self._look_again)
        else:
            self._take()

    def _look_again(self) -> None:
        """Take what nobody else has taken, and look on."""
        self._left = None
        self._take()
        self.start()

    def _take(self) -> None:
        try:
            taken, _ = self._listening.accept()
        except OSError:
            return  # another has taken it, or it is gone
        taken.setblocking(False)
        taken.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        task = self._loop.create_task(self._begin(taken))
        self._begun.add(task)
        task.add_done_callback(self._begun.discard)
        self._counts.tell(len(self._open) + len(self._begun))

    async def _begin(self, taken: socket.socket) -> None:
        try:
            await self._loop.connect_accepted_socket(self._protocol, taken)
        except OSError:
            taken.close()
