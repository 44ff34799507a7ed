"""The web application of a server that follows another: covered questions here, all else there."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from typing import Any, cast

import orjson
from anyio import CapacityLimiter, to_thread
from starlette.requests import ClientDisconnect, Request
from starlette.responses import Response
from starlette.types import Receive, Scope, Send

from service.answering.many import answer_or_submit_many
from service.answering.one import answer_at_once, answer_or_submit
from service.answering.queries import BatchQuery
from service.following.copies import Copies, NotHereError
from service.following.forward import AwayError, Forwarder
from service.http import asked_version
from service.http.binary import is_binary, read_binary
from service.http.door import Door
from service.http.limited import MOST_BATCH_BYTES, MOST_QUERY_BYTES, read_limited
from service.http.parsing import batch_of, batch_parts, read_plain_query, read_query
from service.http.problems import ProblemError, crash_of, problem_of
from service.http.replies import plain_content, write_batch, write_binary, write_outcome
from service.workspace import Workspace

log = logging.getLogger(__name__)

_BEFORE = "/v1/components/"
MOST_FORWARDED = 64  # at once: each waits on a thread, up to as long as its solve takes
AGE = "copy_age_s"
_EVENTS = (
    "this server follows {url}, which tells events to its own listeners only: connect to "
    "{url}/v1/events"
)


class FollowingApp:
    """Answers from copies what they cover, and hands on all else.

    Parameters
    ----------
    copies : Copies
    forwarder : Forwarder
    url : str
        Of the server that is followed, for people.
    door : Door
        Who is let in, to its own answers and to what it hands on alike.
    """

    def __init__(self, copies: Copies, forwarder: Forwarder, url: str, door: Door) -> None:
        self._copies, self._forwarder, self._url = copies, forwarder, url
        self._door = door
        # It has what `service.answering` asks for a table's own answer, and refuses the rest.
        self._answers = cast(Workspace, copies)
        self._limit: CapacityLimiter | None = None
        self._own, self._handed_on = 0, 0

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request, or run the lifespan."""
        if scope["type"] == "lifespan":
            await self._live(receive, send)
            return
        if scope["type"] != "http":
            return
        passed = await self._door.pass_on(scope, receive, send)
        if passed is not None:
            await self._inside(scope, *passed)

    async def _inside(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request that was let in."""
        try:
            response = await self._answered(scope, receive)
        except ClientDisconnect:
            return
        except Exception as error:
            try:
                response = problem_of(error).response()
            except Exception:
                log.exception("%s %s failed", scope["method"], scope["path"])
                response = crash_of(scope["method"], scope["path"]).response()
        await response(scope, receive, send)

    def answer_at_once(
        self, name: str, headers: Sequence[tuple[bytes, bytes]], body: bytes
    ) -> bytes | None:
        """Return the JSON of a 200 to the main call, or None: see `Application`."""
        try:
            if not self._door.admits(headers):
                return None
            query = read_plain_query(body)
            outcome = query and answer_at_once(self._answers, name, query)
            if not outcome:
                return None
            self._own += 1
            return b"%b,%b}" % (plain_content(outcome)[:-1], self._aged(name)[1:-1])
        except Exception:
            return None

    async def _answered(self, scope: Scope, receive: Receive) -> Response:
        method, path = scope["method"], scope["path"]
        if path.startswith("/health/") and method == "GET":
            return self._health(path)
        if path == "/metrics" and method == "GET":
            return Response(self._metrics(), media_type="text/plain; version=0.0.4")
        if path == "/v1/events":
            raise ProblemError(501, "not-here", "Not told here", _EVENTS.format(url=self._url))
        one = method == "POST" and path.startswith(_BEFORE) and path.endswith("/displacement")
        body = await read_limited(receive, MOST_QUERY_BYTES if one else MOST_BATCH_BYTES)
        if method == "POST" and path.startswith(_BEFORE) and _is_of_the_newest(scope):
            name, _, call = path[len(_BEFORE) :].partition("/")
            try:
                if call == "displacement":
                    return await self._one(name, body)
                if call == "displacements":
                    return await self._many(name, scope, body)
            except NotHereError:
                pass
        return await self._forward(scope, body)

    async def _one(self, name: str, body: bytes) -> Response:
        query = read_query(body)
        outcome = await answer_or_submit(self._answers, name, query)
        self._own += 1
        return self._marked(write_outcome(outcome, derivatives=query.derivatives), name)

    async def _many(self, name: str, scope: Scope, body: bytes) -> Response:
        request = Request(scope)
        binary = is_binary(request)
        # On a thread: a million wrenches as text take seconds, for which nobody else should wait.
        batch = await to_thread.run_sync(_batch_in, body, binary, dict(request.query_params))
        outcome = await answer_or_submit_many(self._answers, name, batch)
        self._own += len(batch.wrenches)
        return self._marked(write_binary(outcome) if binary else write_batch(outcome), name)

    def _marked(self, response: Response, name: str) -> Response:
        """Say with an answer how old its copy is: in its JSON, or in its head."""
        age = self._aged(name)
        fields = dict(response.headers)
        fields.pop("content-length")
        content = bytes(response.body)
        if response.media_type == "application/json":
            content = b"%b,%b}" % (content[:-1], age[1:-1])
        else:
            fields["Wrenchbook-Copy-Age-S"] = str(orjson.loads(age)[AGE])
        return Response(content, response.status_code, fields)

    def _aged(self, name: str) -> bytes:
        age = self._copies.age(name)
        return orjson.dumps({AGE: None if age is None else round(age, 3)})

    async def _forward(self, scope: Scope, body: bytes) -> Response:
        """Hand a request on, and its reply back.

        Raises
        ------
        ProblemError
            503 if nothing was sent, 504 if nobody knows what has become of it.
        """
        if self._limit is None:
            self._limit = CapacityLimiter(MOST_FORWARDED)
        raw = scope.get("raw_path") or scope["path"].encode()
        question = scope["query_string"]
        target = (raw + b"?" + question if question else raw).decode("latin-1")
        send, asked = self._forwarder.send, (scope["method"], target, scope["headers"], body)
        self._handed_on += 1
        try:
            reply = await to_thread.run_sync(send, *asked, limiter=self._limit)
        except AwayError as error:
            raise self._problem_of(error) from error
        response = Response(reply.content, reply.status)
        response.raw_headers = [
            *reply.headers,
            (b"content-length", str(len(reply.content)).encode()),
        ]
        return response

    def _problem_of(self, error: AwayError) -> ProblemError:
        if error.sent and error.args:
            detail = (
                f"{self._url} was asked and has not replied ({error}): it may have acted. What is "
                "queued or imported there is so once however often it is sent: ask again"
            )
            return ProblemError(504, "followed-silent", "The followed server is silent", detail)
        detail = (
            f"this needs {self._url}, which does not answer ({error}); nothing was changed. What "
            "the tables cover goes on being answered here: ask with on_thin 'estimate' for the "
            "best guess, or again once it is back"
        )
        return ProblemError(503, "followed-away", "The followed server is away", detail)

    def _health(self, path: str) -> Response:
        if path == "/health/live":
            return Response(b'{"status":"live"}', media_type="application/json")
        away, copies = self._copies.away(), self._copies.told()
        body: dict[str, Any] = {
            "status": "ready" if copies else "not ready",
            "follows": self._url,
            "faults": [f"{self._url} is away: {away}"] if away else [],
            "copies": copies,
        }
        status = 200 if copies else 503
        return Response(orjson.dumps(body), status, media_type="application/json")

    def _metrics(self) -> bytes:
        """Return Prometheus' text form of what is told of a server that follows."""
        lines = [
            "# TYPE wrenchbook_copy_answers_total counter",
            f"wrenchbook_copy_answers_total {self._own}",
            "# TYPE wrenchbook_handed_on_total counter",
            f"wrenchbook_handed_on_total {self._handed_on}",
            "# TYPE wrenchbook_followed_away gauge",
            f"wrenchbook_followed_away {int(self._copies.away() is not None)}",
        ]
        copies = self._copies.told()
        for key, name in (("age_s", "copy_age_seconds"), ("table_version", "table_version")):
            lines.append(f"# TYPE wrenchbook_{name} gauge")
            lines += [
                f'wrenchbook_{name}{{component="{component}"}} {told[key]}'
                for component, told in copies.items()
                if told[key] is not None
            ]
        return ("\n".join(lines) + "\n").encode()

    async def _live(self, receive: Receive, send: Send) -> None:
        """Take copies from the start to the end of the server."""
        await receive()
        try:
            await to_thread.run_sync(self._copies.start)
        except OSError as error:
            log.error("the copies cannot be kept: %s", error)
            await send({"type": "lifespan.startup.failed", "message": str(error)})
            return
        await send({"type": "lifespan.startup.complete"})
        await receive()
        await to_thread.run_sync(self._copies.stop)
        self._forwarder.close()
        await send({"type": "lifespan.shutdown.complete"})


def _batch_in(body: bytes, binary: bool, said: dict[str, str]) -> BatchQuery:
    return read_binary(body, said) if binary else batch_of(*batch_parts(body))


def _is_of_the_newest(scope: Scope) -> bool:
    """Tell whether a question may be to a copy, which is of the newest version."""
    query = scope["query_string"]
    return not query or (asked_version.NAME.encode() not in query and is_binary(Request(scope)))
