"""Fast path of the main call: from the bytes of a query to the bytes of its answer.

A query is `POST /v1/components/{name}/displacement` with a small JSON body of force, moment and
on_thin. All else, and each problem, is left to the application's route, with what was found.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from time import perf_counter
from typing import Any, Final, NamedTuple

from httptools import HttpParserError, HttpParserUpgrade, HttpRequestParser
from starlette.datastructures import State

from wrenchbook.service.answering.one import answer_at_once
from wrenchbook.service.http.access import PERMISSION, PLAIN, Permission
from wrenchbook.service.http.instrumentation import HEADER, id_of
from wrenchbook.service.http.parsing import read_plain_query
from wrenchbook.service.http.replies import plain_content

QUERY: Final = "wrenchbook.query"  # key in a scope: what the fast path has read of the body
ROUTE: Final = "/v1/components/{name}/displacement"
_FIRST_LINE: Final = re.compile(rb"POST /v1/components/([\w-]+)/displacement HTTP/1\.1\r\n")
_BLANK_LINE: Final = b"\r\n\r\n"
_UNUSUAL: Final = frozenset({b"expect", b"transfer-encoding", b"upgrade"})
_LENGTH: Final = re.compile(rb"[1-9]\d{0,2}|[1-3]\d{3}")  # of a body; the longest have some 400
_MOST_HEAD: Final = 2048  # bytes: a loop's heads have some 200
_MOST_HEADS: Final = 1024  # 2 MiB: a loop's heads differ by component and content-length


class Head(NamedTuple):
    """The head of a query."""

    component: str
    permission: Permission
    request_id: bytes  # empty without one
    size: int
    body_bytes: int


class _Fields:
    """Header fields of one head, as a parser finds them."""

    def __init__(self) -> None:
        self.found: list[tuple[bytes, bytes]] = []
        self.is_whole = False

    def on_header(self, name: bytes, value: bytes) -> None:
        self.found.append((name.lower(), value))

    def on_headers_complete(self) -> None:
        self.is_whole = True

    def on_body(self, _: bytes) -> None:
        self.is_whole = False  # the parser has seen the end of the head earlier


class FastPath:
    """Answers queries without a request of the application.

    Parameters
    ----------
    state : State
        The application's, with `access`, `counts` and, while the server runs, `workspace`.
    """

    def __init__(self, state: State) -> None:
        self._state = state
        self._heads: dict[bytes, Head] = state.access.heads

    def head(self, data: bytes) -> Head | None:
        """Return the head that `data` begins with; None if it is none of a permitted query."""
        start = data[: data.find(_BLANK_LINE) + 4]
        head = self._heads.get(start)
        if head is None:
            head = self._read(start)
            # A proxy gives each request another id.
            if head is not None and not head.request_id:
                if len(self._heads) >= _MOST_HEADS:
                    self._heads.clear()
                self._heads[start] = head
        return head

    def answer(self, head: Head, body: bytes) -> bytes | dict[str, Any]:
        """Return the JSON of a 200 to a query, or what its request's scope is to have besides."""
        started, state, query = perf_counter(), self._state, None
        permission = head.permission
        if permission.key is not None and permission.wait() > 0.0:
            return {}
        try:
            query = read_plain_query(body)
            if query is not None:
                outcome = answer_at_once(state.workspace, head.component, query)
                if outcome is not None:
                    content = plain_content(outcome)
                    state.counts.add(outcome.coverage, outcome.method, outcome.elapsed_us)
                    state.counts.add_request(ROUTE, "POST", 200, perf_counter() - started)
                    return content
        except Exception:
            query = None  # the request meets the error again, and answers it
        return {PERMISSION: permission, QUERY: query}

    def _read(self, start: bytes) -> Head | None:
        """Parse a head."""
        line = _FIRST_LINE.match(start)
        if line is None or len(start) > _MOST_HEAD:
            return None
        fields = _Fields()
        parser = HttpRequestParser(fields)
        try:
            parser.feed_data(start)
        except (HttpParserError, HttpParserUpgrade):
            return None
        named = dict(fields.found)
        length, request_id = named.get(b"content-length", b""), id_of(fields.found)
        if (
            not fields.is_whole
            or not parser.should_keep_alive()
            or named.keys() & _UNUSUAL
            or [name for name, _ in fields.found].count(b"host") > 1
            or not _LENGTH.fullmatch(length)
            or request_id is None
        ):
            return None
        path = line[0].split()[1].decode()
        permission = self._state.access.admit(path, named)
        if permission is None:
            return None
        return Head(line[1].decode(), permission, request_id, len(start), int(length))


def reply_bytes(
    fields: Iterable[tuple[bytes, bytes]], head: Head, content: bytes, *, close: bool
) -> bytes:
    """Return a 200 with the server's `fields`, byte for byte as the application's route has it."""
    lines = [b"%b: %b\r\n" % field for field in fields]
    lines += [b"content-length: %d\r\n" % len(content)]
    if close:
        lines += [b"connection: close\r\n"]
    lines += [b"content-type: application/json\r\n", PLAIN]
    if head.request_id:
        lines += [b"%b: %b\r\n" % (HEADER, head.request_id)]
    return b"HTTP/1.1 200 OK\r\n%b\r\n%b" % (b"".join(lines), content)
