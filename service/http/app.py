"""The web application of one workspace."""

from __future__ import annotations

import asyncio
import logging
import re
import secrets
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from functools import cache, partial
from importlib.metadata import version
from time import perf_counter
from typing import Final

from fastapi import APIRouter, Depends, FastAPI
from starlette.concurrency import run_in_threadpool
from starlette.routing import BaseRoute
from starlette.types import Message, Receive, Scope, Send

from wrenchbook.service.actors import CALLER, Caller
from wrenchbook.service.contract import CONTRACT_MARKDOWN
from wrenchbook.service.events import Events
from wrenchbook.service.http import openapi, problems
from wrenchbook.service.http.access import AccessControl, SecuritySettings
from wrenchbook.service.http.batch import AT_ONCE
from wrenchbook.service.http.headers import MAIN_CALL, QUERY, with_security_headers
from wrenchbook.service.http.problems import CLIENT_GONE, HttpProblemError
from wrenchbook.service.http.protocol import HEADER, FastPath, id_of
from wrenchbook.service.http.routes import (
    audit,
    check_query,
    components,
    coverage,
    deformed,
    displacement,
    events,
    health,
    jobs,
    keys,
    library,
    page,
    recording,
    report,
    rigs,
    rows,
    scenes,
    table,
    umbridge,
)
from wrenchbook.service.keys import PREFIX, Keyring
from wrenchbook.service.ledger import ReadOnlyError
from wrenchbook.service.ops.counts import Counts
from wrenchbook.service.ops.logs import REQUEST_ID
from wrenchbook.service.ops.metrics import Metrics
from wrenchbook.service.recording.store import RecordingStore
from wrenchbook.service.tables.coordinator_state import FOLDER as SHARED
from wrenchbook.service.workspace import Settings, Workspace

_SUMMARY = (
    "POST the wrench that acts on a component, get its displacement from a table of "
    "finite-element results, with an error bar. Where the table is too thin, a solve is queued."
)

# The order of the OpenAPI document.
_PARTS = (
    *(displacement, components, coverage, deformed, table, rows, rigs, library),
    *(report, recording, scenes, jobs, events, keys, audit),
)


access_log = logging.getLogger("wrenchbook.access")
# Route name of a request that is no call of the API, or was refused before the router.
NO_ROUTE: Final = "none"
_METHODS: Final = frozenset({*problems.METHODS, "OPTIONS"})
_SECRET: Final = re.compile(PREFIX + r"[\w-]{40,}")  # of a caller who puts the key into the URL
# The caller until the access control has identified it.
_UNKNOWN: Final = Caller("-", (), admin=False)
_STOPPING: Final = HttpProblemError(
    503,
    "stopping",
    "The server stops",
    "The request was not finished before the server stopped. Send it again in a few seconds; an "
    "import is loaded completely or not at all, and never twice.",
    headers={"Retry-After": "5"},  # s: a start takes three
)


class Application(FastAPI):
    """FastAPI behind the access control; it gives each request an id, and counts and logs it.

    The id is the header X-Request-ID of the request (1 to 128 visible ASCII characters), else a
    random one. The reply has it, but for a displacement with status 200 to a request without the
    header: the fast path sends the same reply. HEAD is answered as GET, without the body.
    `fast_path` answers queries of the main call from their bytes; it is None if requests are
    `logged`, each in a line of the access log, or traced.
    """

    fast_path: FastPath | None = None
    logged = False
    read_only = False  # whether it answers from a replica

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request, or run the lifespan."""
        if scope["type"] != "http":
            await super().__call__(scope, receive, send)
            return

        started = perf_counter()
        status = CLIENT_GONE
        method = scope["method"]
        scope, send = _as_get(scope, send)
        sent_id = id_of(scope["headers"])
        request_id = sent_id or secrets.token_hex(8).encode()
        REQUEST_ID.set(request_id.decode())  # each request runs in a context of its own
        CALLER.set(_UNKNOWN)

        async def send_with_id(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
                is_displacement = status == 200 and MAIN_CALL.fullmatch(scope["path"])
                if not (is_displacement and sent_id == b""):  # else as on the fast path
                    fields = [*message.get("headers", ()), (HEADER, request_id)]
                    message = {**message, "headers": fields}
            await send(message)

        try:
            permitted = await self.state.access.pass_on(scope, receive, send_with_id)
            if permitted is not None and self.read_only and not _reads(scope):
                refused = ReadOnlyError(self.state.workspace.refusal(scope["path"]))
                await problems.problem_of(refused).response()(scope, receive, send_with_id)
            elif permitted is not None:
                await super().__call__(scope, *permitted)
        except asyncio.CancelledError:  # see `Server.shutdown`
            if status == CLIENT_GONE:
                answer = with_security_headers(send_with_id, scope["path"], None)
                await _STOPPING.response()(scope, receive, answer)
        finally:
            self._count(scope, method, status, perf_counter() - started)

    def _count(self, scope: Scope, method: str, status: int, seconds: float) -> None:
        """Count an answered request, and write its line of the access log."""
        # The template of the route, such as ``/v1/jobs/{job_id}``, without the caller's words.
        route = getattr(scope.get("route"), "path", NO_ROUTE)
        label = method if method in _METHODS else "other"
        self.state.counts.add_request(route, label, status, seconds)
        if self.logged:
            host = (scope.get("client") or ("-",))[0]
            query = scope["query_string"].decode("latin-1")
            # The path as sent: a decoded path may contain a line end.
            target = scope["raw_path"].decode("latin-1").partition("?")[0]
            target = _SECRET.sub(f"{PREFIX}...", target + "?" * bool(query) + query)
            actor = CALLER.get().actor
            record = host, actor, method, target, status, 1e3 * seconds
            access_log.info('%s %s "%s %s" %d %.1f ms', *record, extra={"actor": actor})


def _as_get(scope: Scope, send: Send) -> tuple[Scope, Send]:
    """Return the scope of GET for a HEAD, and a `send` without the reply's body."""
    if scope["method"] != "HEAD":
        return scope, send

    async def send_head(message: Message) -> None:
        if message["type"] == "http.response.start":
            await send(message)
            await send({"type": "http.response.body"})  # the end: a stream of events ends with it

    return {**scope, "method": "GET"}, send_head


def _reads(scope: Scope) -> bool:
    """Return whether a request writes nothing by itself; queries refuse to add jobs."""
    method, path = scope["method"], scope["path"]
    if method != "POST":
        return method in ("GET", "OPTIONS")
    return (
        QUERY.fullmatch(path) is not None
        or path == "/v1/scenes/plan"
        or path.startswith("/umbridge/")
    )


@asynccontextmanager
async def _lifespan(app: FastAPI) -> AsyncIterator[None]:
    """Open the workspace of an application while its server runs."""
    state = app.state
    settings: Settings = state.settings
    access: AccessControl = state.access
    workspace = state.workspace = await run_in_threadpool(Workspace, settings)
    events = state.events = Events(workspace)
    metrics = state.metrics = Metrics(workspace, state.counts, lambda: events.feed.listeners)
    state.recording_store = RecordingStore(workspace)
    access.rates.share(settings.data / SHARED / "rates")
    loop = asyncio.get_running_loop()
    try:
        for wake, stamp in (
            (workspace.polls.notify, None),
            (events.wake, None),
            (access.refresh, access.keyring.refresh),
        ):
            listener = partial(loop.call_soon_threadsafe, wake)
            workspace.watcher.on_change(listener, stamp)
        await run_in_threadpool(workspace.start)
        yield
    finally:
        await events.stop()
        await run_in_threadpool(metrics.stop)
        await run_in_threadpool(workspace.close)


@cache
def _routes() -> list[BaseRoute]:
    """Return the routes that all applications share: FastAPI prepares each only once."""
    router = APIRouter(**openapi.ROUTER_OPTIONS)
    router.include_router(umbridge.router)  # a protocol with its own form of errors
    router.include_router(health.router, responses=openapi.refused(403, 500))
    for part in _PARTS:
        responses = openapi.refused(403, 422, 500, 503, 507)
        router.include_router(part.router, responses=responses, dependencies=[Depends(check_query)])
    router.include_router(page.router)
    return router.routes


def create_app(settings: Settings, security: SecuritySettings | None = None) -> Application:
    """Return the application; its workspace is open while the server runs.

    Without `security` there are no keys unless some are stored, and any host name is allowed.
    """
    app = Application(
        title="wrenchbook",
        version=version("wrenchbook"),
        summary=_SUMMARY,
        description=f"The wrench contract:\n\n{CONTRACT_MARKDOWN}",
        lifespan=_lifespan,
        redirect_slashes=False,
        routes=_routes(),
        **openapi.OPTIONS,
    )
    app.state.settings = settings
    app.state.counts = Counts()
    app.state.large_batches = asyncio.Semaphore(AT_ONCE)
    app.state.access = AccessControl(
        Keyring(settings.data, "--data FOLDER"), security or SecuritySettings()
    )

    problems.install(app)
    openapi.install(app)

    app.read_only = bool(settings.read_only)
    app.logged = settings.access_log
    if app.logged:
        access_log.setLevel(logging.INFO)
    else:
        app.fast_path = FastPath(app.state)
    return app
