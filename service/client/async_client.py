"""The client for asyncio: the calls of `Client` in threads, many at once."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from concurrent.futures import ThreadPoolExecutor
from typing import Self, TypeVar

from . import Calls
from .request import Call, Item, Items
from .transport import Transport

T = TypeVar("T")

AT_ONCE = 100  # threads, and so connections: further requests wait for one


class AsyncClient(Calls, Transport):
    """A client of one server for asyncio: the calls of `Client`, each of them awaited.

    Calls of several tasks are on the wire at the same time, 100 at most; further ones wait. Each
    runs in a thread of the client's own. A cancelled call goes on in its thread: the server may
    have taken the request, and its socket is free again, or closes, when the answer arrives or the
    time is up. `events` and `fill_until` are asynchronous iterators. A downloaded `Table` answers
    without waiting; its `refresh` blocks. One object may be used in one event loop after another.

    Parameters
    ----------
    url, timeout, key
        As of `Client`.

    Examples
    --------
    >>> async with AsyncClient() as client:                     # doctest: +SKIP
    ...     calls = [client.displacement("plate", wrench) for wrench in wrenches]
    ...     answers = await asyncio.gather(*calls)
    """

    def __init__(
        self, url: str = "http://127.0.0.1:8000", timeout: float = 30.0, key: str | None = None
    ) -> None:
        super().__init__(url, timeout, key)
        self._threads = ThreadPoolExecutor(AT_ONCE, "wrenchbook")

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    async def close(self) -> None:
        """Close the idle connections; a later call opens a new one."""
        self._threads.shutdown(wait=False)
        self._threads = ThreadPoolExecutor(AT_ONCE, "wrenchbook")
        self._close_idle()

    async def run(self, call: Call[T]) -> T:
        """Perform the steps of a call in a thread, and return its result."""
        return await asyncio.get_running_loop().run_in_executor(self._threads, self.finish, call)

    async def iterate(self, call: Items[T]) -> AsyncGenerator[T, None]:
        """Perform the steps of a call that is an iterator, each in a thread; yield its items."""
        loop = asyncio.get_running_loop()
        try:
            step = next(call)
            while True:
                if isinstance(step, Item):
                    yield step.value
                    step = next(call)
                    continue
                try:
                    result = await loop.run_in_executor(self._threads, self.perform, step)
                except Exception as error:
                    step = call.throw(error)
                else:
                    step = call.send(result)
        except StopIteration:
            return
        finally:
            call.close()
