"""Keep-alive HTTP on the standard library: a small pool of connections, used by any thread."""

from __future__ import annotations

import http.client
import os
import time
from collections.abc import Iterator
from typing import Any, Self, TypeVar

from .errors import ProblemError, ServerUnreachable
from .request import Call, Item, Items, Listen, NextLine, Pause, Request, Step
from .response import Response, receive
from .transport import CLOSED, Transport, problem

T = TypeVar("T")

_pause = time.sleep
_ONE_WRITE = 65_536  # bytes that are worth copying to be sent at once: any request but a batch


class Connection(Transport):
    """Blocking connections to one server.

    Each request takes an idle connection or opens one, and puts it back: threads never share one,
    and a loop of calls stays on one socket. A forked child opens its own. Parameters are those of
    `Transport`.
    """

    def __init__(
        self, url: str = "http://127.0.0.1:8000", timeout: float = 30.0, key: str | None = None
    ) -> None:
        super().__init__(url, timeout, key)
        self._kind = http.client.HTTPSConnection if self._https else http.client.HTTPConnection
        self._idle: list[http.client.HTTPConnection] = []
        self._process_id = os.getpid()

    def __getstate__(self) -> dict[str, Any]:
        """Return what is pickled: connections stay behind."""
        return vars(self) | {"_idle": []}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the idle connections; a later call opens a new one."""
        while self._idle:
            self._idle.pop().close()

    def blocking(self) -> Connection:
        """Return this connection."""
        return self

    def run(self, call: Call[T]) -> T:
        """Perform the steps of a call, and return its result."""
        try:
            step = next(call)
            while True:
                step = self._resume(call, step)
        except StopIteration as end:
            return end.value

    def iterate(self, call: Items[T]) -> Iterator[T]:
        """Perform the steps of a call that is an iterator, and yield its items."""
        try:
            step = next(call)
            while True:
                if isinstance(step, Item):
                    yield step.value
                    step = next(call)
                else:
                    step = self._resume(call, step)
        except StopIteration:
            return
        finally:
            call.close()

    def _resume(self, call: Any, step: Step) -> Any:
        """Perform a step, and return the next one."""
        try:
            result = self._perform(step)
        except Exception as error:
            return call.throw(error)
        return call.send(result)

    def _perform(self, step: Step) -> Any:
        if isinstance(step, Request):
            return self._send(step)
        if isinstance(step, NextLine):
            return step.stream.readline()
        if isinstance(step, Pause):
            return _pause(step.seconds)
        return self._listen(step)

    def _send(self, request: Request) -> Response:
        """Send a request, again while the server certainly has not taken it."""
        began, attempt = time.monotonic(), 0
        while True:
            try:
                return self._send_once(request)
            except (ServerUnreachable, ProblemError) as error:
                _pause(self._pause_s(error, request, began, attempt))
                attempt += 1

    def _send_once(self, request: Request) -> Response:
        """Send a request on a kept connection, or on a new one if there is none or it is dead."""
        kept = self._take() if request.repeatable else None
        if kept is not None:
            try:
                return self._exchange(kept, request)
            except CLOSED:
                self.close()  # the server has closed what was kept: once more on a new connection
        connection = self._kind(self._host, self._port)
        try:
            return self._exchange(connection, request)
        except (http.client.HTTPException, ConnectionError, OSError) as error:
            if isinstance(error, TimeoutError):
                raise
            raise self._unreachable(error) from error

    def _take(self) -> http.client.HTTPConnection | None:
        if self._process_id != os.getpid():
            # Forked: the sockets belong to the parent. Drop them without a byte on the wire.
            self._idle, self._process_id = [], os.getpid()
        try:
            return self._idle.pop()
        except IndexError:
            return None

    def _exchange(self, connection: http.client.HTTPConnection, request: Request) -> Response:
        """Send and receive on one connection, then keep it, or close it when anything failed."""
        head, content = self._written(request)
        timeout = self._timeout(request)
        try:
            connection.timeout = timeout
            if connection.sock is None:
                connection.connect()
            sock = connection.sock
            assert sock is not None
            sock.settimeout(timeout)
            if len(content) <= _ONE_WRITE:  # one packet, one waking of the server
                sock.sendall(head + content)
            else:
                sock.sendall(head)
                sock.sendall(content)
            response = receive(sock, request.method)
        except TimeoutError as error:
            connection.close()
            raise self._late(timeout) from error
        except BaseException:
            connection.close()
            raise
        if response.will_close:
            connection.close()
        else:
            self._idle.append(connection)
        if response.status >= 400:
            raise problem(response)
        return response

    def _listen(self, listen: Listen) -> http.client.HTTPResponse:
        """Return the answer to a GET that is read line by line, on a connection of its own."""
        connection = self._kind(self._host, self._port, timeout=listen.timeout)
        try:
            connection.connect()
            assert connection.sock is not None
            connection.sock.sendall(self._written_listen(listen))
            response = http.client.HTTPResponse(connection.sock, method="GET")
            response.begin()
        except ConnectionError as error:
            raise self._unreachable(error) from error
        finally:
            connection.close()  # the response keeps the socket open
        if response.status >= 400:
            with response:
                refused = Response(response.status, response.read(), reason=response.reason)
            refused.headers = response.headers
            raise problem(refused)
        return response
