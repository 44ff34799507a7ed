"""The client for asyncio: the requests of `Client` on asyncio streams, many at once."""

from __future__ import annotations

import asyncio
import contextlib
import http.client
import io
import ssl
import time
from collections.abc import AsyncGenerator
from typing import Any, Self, TypeVar

from . import Calls
from .connection import Connection
from .errors import ProblemError, ServerUnreachable, WrenchbookError
from .request import Call, Item, Items, Listen, NextLine, Pause, Request, Step
from .response import Response, glance
from .transport import CLOSED, Transport, problem

T = TypeVar("T")
_Streams = tuple[asyncio.StreamReader, asyncio.StreamWriter]

_pause = asyncio.sleep
AT_ONCE = 100  # connections: further requests wait for one
_LONGEST_LINE = 1 << 20  # bytes of a response's head, or of one event


class AsyncConnection(Transport):
    """Connections of asyncio to one server: each request has one of at most 100 for itself.

    A cancelled request closes its connection; the server may have taken the request. Parameters
    are those of `Transport`. One object may be used in one event loop after another.
    """

    def __init__(
        self, url: str = "http://127.0.0.1:8000", timeout: float = 30.0, key: str | None = None
    ) -> None:
        super().__init__(url, timeout, key)
        self._ssl = ssl.create_default_context() if self._https else None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._idle: list[_Streams] = []

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    async def close(self) -> None:
        """Close the idle connections; a later call opens a new one."""
        self._renew()
        while self._idle:
            writer = self._idle.pop()[1]
            writer.close()
            with contextlib.suppress(OSError):
                await writer.wait_closed()

    def blocking(self) -> Connection:
        """Return a blocking connection to the same server."""
        return Connection(self.url, self.timeout, self._key or "")

    async def run(self, call: Call[T]) -> T:
        """Perform the steps of a call, and return its result."""
        try:
            step = next(call)
            while True:
                step = _resume(call, *await self._outcome(step))
        except StopIteration as end:
            return end.value

    async def iterate(self, call: Items[T]) -> AsyncGenerator[T, None]:
        """Perform the steps of a call that is an iterator, and yield its items."""
        try:
            step = next(call)
            while True:
                if isinstance(step, Item):
                    yield step.value
                    step = next(call)
                else:
                    step = _resume(call, *await self._outcome(step))
        except StopIteration:
            return
        finally:
            call.close()

    async def _outcome(self, step: Step) -> tuple[Exception | None, Any]:
        """Perform a step, and return its error or its result."""
        try:
            return None, await self._perform(step)
        except Exception as error:
            return error, None

    async def _perform(self, step: Step) -> Any:
        if isinstance(step, Request):
            return await self._send(step)
        if isinstance(step, NextLine):
            return await step.stream.readline()
        if isinstance(step, Pause):
            return await _pause(step.seconds)
        return await self._listen(step)

    async def _send(self, request: Request) -> Response:
        """Send a request, again while the server certainly has not taken it."""
        self._renew()
        began, attempt = time.monotonic(), 0
        while True:
            try:
                async with self._places:
                    return await self._send_once(request)
            except (ServerUnreachable, ProblemError) as error:
                await _pause(self._pause_s(error, request, began, attempt))
                attempt += 1

    async def _send_once(self, request: Request) -> Response:
        """Send a request on a kept connection, or on a new one if there is none or it is dead."""
        timeout = self._timeout(request)
        try:
            async with asyncio.timeout(timeout):
                if request.repeatable and self._idle:
                    try:
                        return await self._exchange(self._idle.pop(), request)
                    except CLOSED:
                        await self.close()
                return await self._exchange(await self._open(), request)
        except WrenchbookError:
            raise
        except TimeoutError as error:
            raise self._late(timeout) from error
        except (http.client.HTTPException, OSError, EOFError, ValueError) as error:
            raise self._unreachable(error) from error

    async def _exchange(self, streams: _Streams, request: Request) -> Response:
        """Send and receive on one connection, then keep it, or close it when anything failed."""
        reader, writer = streams
        try:
            writer.writelines(self._written(request))
            await writer.drain()
            response = await _read(reader, request.method)
        except BaseException:
            writer.close()
            raise
        if response.will_close:
            writer.close()
        else:
            self._idle.append(streams)
        if response.status >= 400:
            raise problem(response)
        return response

    async def _listen(self, listen: Listen) -> _LineStream:
        """Return the answer to a GET that is read line by line, on a connection of its own."""
        self._renew()
        try:
            async with asyncio.timeout(listen.timeout):
                reader, writer = await self._open()
                stream = _LineStream(reader, writer, listen.timeout)
                try:
                    writer.write(self._written_listen(listen))
                    stream.head = await _read_head(reader, "GET")
                    if stream.head.status >= 400:
                        raise problem(await _read_body(reader, stream.head))
                except BaseException:
                    stream.close()
                    raise
                return stream
        except ConnectionError as error:
            raise self._unreachable(error) from error

    async def _open(self) -> _Streams:
        return await asyncio.open_connection(
            self._host, self._port, ssl=self._ssl, limit=_LONGEST_LINE
        )

    def _renew(self) -> None:
        """Forget the connections of an event loop that has ended."""
        loop = asyncio.get_running_loop()
        if self._loop is not loop:
            self._loop, self._idle = loop, []
            self._places = asyncio.Semaphore(AT_ONCE)


class AsyncClient(Calls, AsyncConnection):
    """A client of one server for asyncio: the calls of `Client`, each of them awaited.

    Calls of several tasks are on the wire at the same time, 100 at most; further ones wait. A
    cancelled call closes its connection, and the server may have taken the request. `events` and
    `fill_until` are asynchronous iterators. A downloaded `Table` answers without waiting; its
    `refresh` blocks. `add_component` and `import_table` read their files in the event loop.

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


def _resume(call: Any, error: Exception | None, result: Any) -> Any:
    """Return the next step of a call; not in a coroutine, which no StopIteration can leave."""
    return call.send(result) if error is None else call.throw(error)


class _LineStream:
    """The lines of a response that goes on, chunked or not."""

    def __init__(
        self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, timeout: float
    ) -> None:
        self._reader, self._writer, self._timeout = reader, writer, timeout
        self._came = b""
        self.head: http.client.HTTPResponse

    async def readline(self) -> bytes:
        """Return the next line, empty at the end; TimeoutError after the seconds without a byte."""
        while b"\n" not in self._came:
            async with asyncio.timeout(self._timeout):
                if self.head.chunked:
                    piece = await _read_chunk(self._reader)
                else:
                    piece = await self._reader.read(_LONGEST_LINE)
            if not piece:
                line, self._came = self._came, b""
                return line
            self._came += piece
        line, end, self._came = self._came.partition(b"\n")
        return line + end

    def close(self) -> None:
        """Close the connection."""
        self._writer.close()


class _Head:
    """The bytes of a head, in the place of http.client's socket."""

    def __init__(self, head: bytes) -> None:
        self._head = head

    def makefile(self, _mode: str) -> io.BytesIO:
        return io.BytesIO(self._head)


async def _read(reader: asyncio.StreamReader, method: str) -> Response:
    """Read one response."""
    head = await _read_head_bytes(reader)
    seen = glance(head)
    if seen is not None:
        content = await reader.readexactly(seen.length)
        return Response(seen.status, content, head[:-4])
    return await _read_body(reader, _parsed(head, method))


async def _read_head(reader: asyncio.StreamReader, method: str) -> http.client.HTTPResponse:
    return _parsed(await _read_head_bytes(reader), method)


async def _read_head_bytes(reader: asyncio.StreamReader) -> bytes:
    """Return the head of a response; an informational one, such as 100 Continue, is passed over."""
    while True:
        try:
            head = await reader.readuntil(b"\r\n\r\n")
        except asyncio.IncompleteReadError as error:
            if error.partial:
                raise
            raise http.client.RemoteDisconnected(
                "the server closed the connection without an answer"
            ) from error
        if not head.startswith((b"HTTP/1.1 1", b"HTTP/1.0 1")):
            return head


def _parsed(head: bytes, method: str) -> http.client.HTTPResponse:
    response = http.client.HTTPResponse(_Head(head), method=method)  # pyright: ignore
    response.begin()
    return response


async def _read_body(reader: asyncio.StreamReader, head: http.client.HTTPResponse) -> Response:
    """Read the rest of a response whose head is parsed."""
    if head.chunked:
        pieces = []
        while piece := await _read_chunk(reader):
            pieces.append(piece)
        content = b"".join(pieces)
    elif head.length is not None:
        content = await reader.readexactly(head.length)
    else:
        content = await reader.read()
    found = Response(head.status, content, reason=head.reason, will_close=head.will_close)
    found.headers = head.headers
    return found


async def _read_chunk(reader: asyncio.StreamReader) -> bytes:
    """Return the next chunk of a chunked body, empty at its end (RFC 9112, section 7.1)."""
    size = int((await reader.readuntil(b"\n")).partition(b";")[0], 16)
    if size:
        chunk = await reader.readexactly(size)
        await reader.readexactly(2)
        return chunk
    while (await reader.readuntil(b"\n")).strip():
        pass  # trailer fields
    return b""
