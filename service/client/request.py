"""The calls of a client, apart from the connection that sends them.

A call is a generator: it yields a request, gets the response, and returns its result. `Client` runs
it on a blocking socket and `AsyncClient` does so in a thread, so each call is written once.
"""

from __future__ import annotations

import functools
import inspect
import json
from collections.abc import AsyncGenerator, Callable, Coroutine, Generator, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Concatenate, Generic, ParamSpec, Protocol, TypeVar, cast, overload
from urllib.parse import quote

P = ParamSpec("P")
T = TypeVar("T")
B = TypeVar("B")
A = TypeVar("A")

JSON = "application/json"
BINARY = "application/octet-stream"


@dataclass(slots=True)
class Request:
    """One request; the answer to it is a `Response`."""

    method: str
    path: str  # below the server's address, quoted
    content: bytes | None = None  # JSON unless `kind` names another content type
    kind: str | None = None
    query: Mapping[str, object] | None = None  # those that are None are left out
    headers: Mapping[str, str] | None = None
    wait_s: float | None = None  # that the server may wait before it answers; adds to the timeout
    # Whether sending the request twice does no more than once. Others are sent once, on a new
    # connection: the server may have closed a kept one.
    repeatable: bool = True
    # Whether a server that refuses the connection is tried again, and one that is busy (503 with
    # Retry-After) if `repeatable`.
    retry: bool = True


class Lines(Protocol):
    """A response that is read line by line."""

    def readline(self) -> bytes:
        """Return the next line; empty at the end."""
        ...

    def close(self) -> None:
        """Close the connection."""
        ...


@dataclass(slots=True)
class Listen:
    """A GET whose answer is `Lines`; TimeoutError after `timeout` seconds without a byte."""

    path: str
    query: Mapping[str, object]
    headers: Mapping[str, str] = field(default_factory=dict)
    timeout: float = 30.0


@dataclass(slots=True)
class NextLine:
    """The next line of a stream; empty at its end."""

    stream: Lines


@dataclass(slots=True)
class Pause:
    """Nothing for some seconds."""

    seconds: float


@dataclass(slots=True)
class Item(Generic[T]):
    """One result of a call that is an iterator."""

    value: T


Step = Request | Listen | NextLine | Pause
Call = Generator[Step, Any, T]
Items = Generator[Step | Item[T], Any, None]
Awaited = Coroutine[Any, Any, T]


def json_request(method: str, path: str, body: object = None, **options: Any) -> Request:
    """Return a request with `body` as JSON; options as in `Request`."""
    content = None if body is None else json.dumps(body, allow_nan=False).encode()
    return Request(method, path, content, **options)


def component_path(name: str, call: str = "") -> str:
    """Return the path of a component's call, or of the component itself."""
    return f"/v1/components/{quote(name, safe='')}" + (f"/{call}" if call else "")


class BlockingRunner(Protocol):
    """A connection that blocks until a call has its result."""

    def run(self, call: Call[T], /) -> T:
        """Return the result of a call."""
        ...

    def iterate(self, call: Items[T], /) -> Iterator[T]:
        """Return the items of a call that is an iterator."""
        ...


class AsyncRunner(Protocol):
    """A connection whose calls are awaited."""

    def run(self, call: Call[T], /) -> Awaited[T]:
        """Return the result of a call."""
        ...

    def iterate(self, call: Items[T], /) -> AsyncGenerator[T, None]:
        """Return the items of a call that is an iterator."""
        ...


class _Method(Generic[P, B, A]):
    """The types of a call: its result of a `Client`, that of an `AsyncClient`."""

    @overload
    def __get__(self, client: BlockingRunner, owner: object = None) -> Callable[P, B]: ...
    @overload
    def __get__(self, client: AsyncRunner, owner: object = None) -> Callable[P, A]: ...
    @overload
    def __get__(self, client: None, owner: object = None) -> Callable[..., object]: ...
    def __get__(self, client: object, owner: object = None) -> object:
        raise NotImplementedError


def sync_and_async(
    call: Callable[Concatenate[Any, P], Call[T]],
) -> _Method[P, T, Awaited[T]]:
    """Make a generator of requests a method that returns its result."""

    @functools.wraps(call)
    def method(self: BlockingRunner, /, *args: P.args, **options: P.kwargs) -> T:
        return self.run(call(self, *args, **options))

    # A signature shows ``Call[Job]`` as ``Job``,
    return cast("_Method[P, T, Awaited[T]]", _with_result(method, "Call", "{}"))


def sync_and_async_iterator(
    call: Callable[Concatenate[Any, P], Items[T]],
) -> _Method[P, Iterator[T], AsyncGenerator[T, None]]:
    """Make a generator of requests and items a method that returns an iterator of its items."""

    @functools.wraps(call)
    def method(self: BlockingRunner, /, *args: P.args, **options: P.kwargs) -> Iterator[T]:
        return self.iterate(call(self, *args, **options))

    # and ``Items[Job]`` as ``Iterator[Job]``.
    shown = _with_result(method, "Items", "Iterator[{}]")
    return cast("_Method[P, Iterator[T], AsyncGenerator[T, None]]", shown)


def _with_result(method: Callable[..., object], wrapper: str, shown: str) -> object:
    signature = inspect.signature(method)
    result = str(signature.return_annotation).removeprefix(f"{wrapper}[").removesuffix("]")
    signature = signature.replace(return_annotation=shown.format(result))
    setattr(method, "__signature__", signature)  # noqa: B010 (not an attribute that types know)
    return method
