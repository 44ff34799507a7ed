"""The client for asyncio: the calls of `Client` in threads, many at once."""

from __future__ import annotations

import asyncio
import copy
import functools
from collections.abc import AsyncGenerator, Callable, Coroutine, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Concatenate, ParamSpec, Self, TypeVar

from .client import Client

P = ParamSpec("P")
T = TypeVar("T")

AT_ONCE = 100  # threads, and so connections: further requests wait for a free thread


def _awaited(
    call: Callable[Concatenate[Client, P], T],
) -> Callable[Concatenate[AsyncClient, P], Coroutine[Any, Any, T]]:
    """Return a blocking call as a coroutine function."""

    @functools.wraps(call)
    async def method(self: AsyncClient, /, *args: P.args, **options: P.kwargs) -> T:
        return await self.run(lambda client: call(client, *args, **options))

    return method


def _iterated(
    call: Callable[Concatenate[Client, P], Iterator[T]],
) -> Callable[Concatenate[AsyncClient, P], AsyncGenerator[T, None]]:
    """Return a blocking iterator call as an asynchronous iterator."""

    @functools.wraps(call)
    async def method(
        self: AsyncClient, /, *args: P.args, **options: P.kwargs
    ) -> AsyncGenerator[T, None]:
        connection = copy.copy(self._client)  # the iterator's own connection, which its end closes
        items = call(connection, *args, **options)
        end = object()
        try:
            while (item := await self.run(lambda _: next(items, end))) is not end:
                yield item  # type: ignore[misc]
        finally:
            connection.abandon()

    return method


def _attribute(name: str) -> Any:
    return property(
        lambda self: getattr(self._client, name),
        lambda self, value: setattr(self._client, name, value),
    )


class AsyncClient:
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

    url: str = _attribute("url")
    timeout: float = _attribute("timeout")
    retry_s: float = _attribute("retry_s")

    def __init__(
        self, url: str = "http://127.0.0.1:8000", timeout: float = 30.0, key: str | None = None
    ) -> None:
        self._client = Client(url, timeout, key)
        self._threads = ThreadPoolExecutor(AT_ONCE, "wrenchbook")

    def __repr__(self) -> str:
        return f"Async{self._client!r}"

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    async def close(self) -> None:
        """Close the idle connections; a later call opens a new one."""
        self._threads.shutdown(wait=False)
        self._threads = ThreadPoolExecutor(AT_ONCE, "wrenchbook")
        self._client.close()

    async def run(self, call: Callable[[Client], T]) -> T:
        """Call a function with the blocking client, in a thread."""
        return await asyncio.get_running_loop().run_in_executor(self._threads, call, self._client)

    call = _awaited(Client.call)
    call_json = _awaited(Client.call_json)
    displacement = _awaited(Client.displacement)
    displacements = _awaited(Client.displacements)
    solve = _awaited(Client.solve)
    deformed = _awaited(Client.deformed)
    deformed_file = _awaited(Client.deformed_file)
    job = _awaited(Client.job)
    wait = _awaited(Client.wait)
    jobs = _awaited(Client.jobs)
    cancel = _awaited(Client.cancel)
    cancel_jobs = _awaited(Client.cancel_jobs)
    retry = _awaited(Client.retry)
    fill = _awaited(Client.fill)
    fill_until = _iterated(Client.fill_until)
    components = _awaited(Client.components)
    component = _awaited(Client.component)
    compliance = _awaited(Client.compliance)
    add_component = _awaited(Client.add_component)
    import_table = _awaited(Client.import_table)
    append = _awaited(Client.append)
    comparison = _awaited(Client.comparison)
    export_table = _awaited(Client.export_table)
    invalidate_row = _awaited(Client.invalidate_row)
    restore_row = _awaited(Client.restore_row)
    withdraw_import = _awaited(Client.withdraw_import)
    stiffness = _awaited(Client.stiffness)
    make_report = _awaited(Client.make_report)
    report_state = _awaited(Client.report_state)
    report = _awaited(Client.report)
    health = _awaited(Client.health)
    is_ready = _awaited(Client.is_ready)
    download = _awaited(Client.download)
    record = _awaited(Client.record)
    recording = _awaited(Client.recording)
    clear_recording = _awaited(Client.clear_recording)
    start_recording = _awaited(Client.start_recording)
    widen_envelope = _awaited(Client.widen_envelope)
    envelope = _awaited(Client.envelope)
    clear_envelope = _awaited(Client.clear_envelope)
    start_envelope = _awaited(Client.start_envelope)
    resolve = _awaited(Client.resolve)
    send_block = _awaited(Client.send_block)
    events = _iterated(Client.events)
