"""The web application of one workspace."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from functools import partial
from importlib.metadata import version

from fastapi import FastAPI
from starlette.concurrency import run_in_threadpool
from starlette.types import ASGIApp, Receive, Scope, Send

from wrenchbook.service.contract import CONTRACT_TEXT
from wrenchbook.service.events import Events
from wrenchbook.service.http import instrumentation, openapi, problems
from wrenchbook.service.http.access import AccessControl, Rates, SecuritySettings
from wrenchbook.service.http.protocol import FastPath
from wrenchbook.service.http.routes import (
    components,
    coverage,
    deformed,
    displacement,
    drawing,
    events,
    health,
    jobs,
    keys,
    library,
    page,
    recording,
    report,
    rows,
    scenes,
    table,
    umbridge,
)
from wrenchbook.service.keys import Keyring
from wrenchbook.service.ops.counts import Counts
from wrenchbook.service.ops.metrics import Metrics
from wrenchbook.service.recording.store import RecordingStore
from wrenchbook.service.tables.coordinator_state import FOLDER as SHARED
from wrenchbook.service.workspace import Settings, Workspace

_SUMMARY = (
    "POST the wrench that acts on a component, get its displacement from a table of "
    "finite-element results, with an error bar. Where the table is too thin, a solve is queued."
)

_PARTS = (
    displacement,
    components,
    coverage,
    deformed,
    table,
    rows,
    library,
    report,
    recording,
    drawing,
    scenes,
    jobs,
    events,
    keys,
)


class Application(FastAPI):
    """FastAPI behind the observer of requests and the access control.

    Attributes
    ----------
    fast_path : FastPath or None
        Answers queries of the main call from their bytes; None if requests are logged or traced.
    """

    fast_path: FastPath | None = None
    observed: ASGIApp

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request, or run the lifespan."""
        inner = self.observed if scope["type"] == "http" else super().__call__
        await inner(scope, receive, send)

    async def permitted(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request if the access control permits it."""
        access: AccessControl = self.state.access
        passed = await access.pass_on(scope, receive, send)
        if passed is not None:
            await super().__call__(scope, *passed)


def create_app(settings: Settings, security: SecuritySettings | None = None) -> Application:
    """Return the application; its workspace is open while the server runs.

    Parameters
    ----------
    settings : Settings
        The workspace's.
    security : SecuritySettings, optional
        How its access stands: by default without keys unless there are some, and under any name.
    """
    counts = Counts()

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        workspace = await run_in_threadpool(Workspace, settings)
        app.state.workspace = workspace
        app.state.recording_store = RecordingStore(workspace)
        app.state.events = events = Events(workspace)
        app.state.metrics = metered = Metrics(workspace, counts, lambda: events.feed.listeners)
        loop = asyncio.get_running_loop()
        access: AccessControl = app.state.access
        rates.share(settings.data / SHARED / "rates")
        try:
            for wake, stamp in (
                (workspace.polls.notify, None),
                (events.wake, None),
                (access.refresh, access.keyring.look),
            ):
                listener = partial(loop.call_soon_threadsafe, wake)
                workspace.watcher.on_change(listener, stamp)
            await run_in_threadpool(workspace.start)
            yield
        finally:
            await events.stop()
            await run_in_threadpool(metered.stop)
            await run_in_threadpool(workspace.close)

    app = Application(
        title="wrenchbook",
        version=version("wrenchbook"),
        summary=_SUMMARY,
        description=f"The wrench contract:\n\n{CONTRACT_TEXT}",
        lifespan=lifespan,
        redirect_slashes=False,
        strict_content_type=False,  # programs may leave it out, see `access`
        **openapi.OPTIONS,
    )
    app.state.counts = counts
    rates = Rates()
    keyring = Keyring(settings.data)
    app.state.access = AccessControl(keyring, security or SecuritySettings(), rates)
    return _with_routes(app, settings)


def _with_routes(app: Application, settings: Settings) -> Application:
    """Add the routes, the errors, the document and the request log, and return the application."""
    problems.install(app)
    app.include_router(umbridge.router)  # a protocol with errors of its own form
    app.include_router(health.router, responses=openapi.refused(403, 500))
    for part in _PARTS:
        app.include_router(part.router, responses=openapi.refused(403, 500, 503, 507))
    app.include_router(page.router)
    openapi.install(app)
    logged = settings.access_log
    app.observed = instrumentation.RequestObserver(app.permitted, app.state.counts, logged=logged)
    if logged:
        instrumentation.access_log.setLevel(logging.INFO)
    else:
        app.fast_path = FastPath(app.state)
    return app
