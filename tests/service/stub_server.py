"""A server of a few lines that records what a client sends and answers what a test tells it."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any


@dataclass
class Seen:
    """One request as it came in."""

    method: str
    path: str
    headers: dict[str, str]
    content: bytes
    socket: tuple[str, int]  # the client's end: one a connection

    @property
    def body(self) -> Any:
        return json.loads(self.content)


@dataclass
class Answer:
    """One reply; `close` ends the connection after it without saying so before."""

    body: Any = None
    status: int = 200
    kind: str = "application/json"
    close: bool = False
    held: bool = False  # does not come while the stub runs
    drop: bool = False  # close the connection instead of answering
    headers: dict[str, str] = field(default_factory=dict)


@dataclass
class Stub:
    """The address of a running stub, what it saw, and what it shall answer."""

    url: str = ""
    seen: list[Seen] = field(default_factory=list)
    respond: Callable[[Seen], Answer] = lambda _: Answer({})

    def answers(self, *answers: Answer) -> None:
        """Give these answers in turn, the last one for good."""
        left = list(answers)
        self.respond = lambda _: left.pop(0) if len(left) > 1 else left[0]

    @property
    def sockets(self) -> list[tuple[str, int]]:
        return [item.socket for item in self.seen]


@contextmanager
def running_stub() -> Iterator[Stub]:
    """Run a stub on a free port of 127.0.0.1."""
    stub, ended = Stub(), threading.Event()

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"
        wbufsize = -1  # one packet a reply, or delayed acknowledgements cost 40 ms each

        def handle_any(self) -> None:
            length = int(self.headers.get("Content-Length") or 0)
            seen = Seen(
                self.command,
                self.path,
                dict(self.headers.items()),
                self.rfile.read(length),
                self.client_address[:2],
            )
            stub.seen.append(seen)
            answer = stub.respond(seen)
            if answer.held:
                ended.wait()
            elif not answer.drop:
                self._send(answer)
            self.close_connection = answer.close or answer.drop or answer.held

        do_GET = do_POST = do_DELETE = handle_any  # noqa: N815 (http.server names them)

        def _send(self, answer: Answer) -> None:
            body = answer.body
            content = body if isinstance(body, bytes) else json.dumps(body).encode()
            self.send_response(answer.status)
            self.send_header("Content-Type", answer.kind)
            self.send_header("Content-Length", str(len(content)))
            for name, value in answer.headers.items():
                self.send_header(name, value)
            self.end_headers()
            self.wfile.write(content)

        def log_message(self, format: str, *args: Any) -> None:  # noqa: A002
            pass

    class Server(ThreadingHTTPServer):
        daemon_threads = True
        request_queue_size = 64  # with the default of 5, SYN packets of a burst wait for a retry

        def handle_error(self, request: Any, client_address: Any) -> None:
            pass  # a client that gave up waiting is part of the tests

    with Server(("127.0.0.1", 0), Handler) as server:
        stub.url = f"http://127.0.0.1:{server.server_address[1]}"
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        try:
            yield stub
        finally:
            ended.set()
            server.shutdown()
            thread.join()
