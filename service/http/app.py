"""The web application of one workspace."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from importlib.metadata import version

from fastapi import FastAPI
from starlette.concurrency import run_in_threadpool

from service.contract import CONTRACT_TEXT
from service.events.watch import Watch
from service.gathering.gathering import Gathering
from service.http import openapi, problems
from service.http.application import Application
from service.http.door import Door, Opening
from service.http.routes import (
    components,
    coverage,
    deformed,
    displacement,
    drawing,
    events,
    gathering,
    health,
    job_log,
    jobs,
    keys,
    library,
    metrics,
    page,
    report,
    rows,
    scenes,
    table,
    umbridge,
)
from service.keys import Keyring
from service.ops.counts import Counts
from service.ops.metrics import Metrics
from service.workspace import Settings, Workspace

_SUMMARY = (
    "POST the wrench that acts on a component, get its displacement from a table of "
    "finite-element results, with an error bar. Where the table is too thin, a solve is queued."
)


def create_app(settings: Settings, opening: Opening | None = None) -> Application:
    """Return the application; its workspace is open while the server runs.

    Parameters
    ----------
    settings : Settings
        The workspace's.
    opening : Opening, optional
        How its door stands: by default without keys unless there are some, and under any name.
    """
    counts = Counts()

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        workspace = await run_in_threadpool(Workspace, settings)
        app.state.workspace = workspace
        app.state.gathering = Gathering(workspace)
        app.state.watch = watch = Watch(workspace)
        app.state.metrics = metered = Metrics(workspace, counts, lambda: watch.feed.listeners)
        loop = asyncio.get_running_loop()
        at_the_door = asyncio.create_task(app.state.door.watch())
        try:
            watch.start(loop)
            await run_in_threadpool(workspace.start, loop)
            yield
        finally:
            at_the_door.cancel()
            await watch.stop()
            await run_in_threadpool(metered.stop)
            await run_in_threadpool(workspace.close)

    app = Application(
        title="wrenchbook",
        version=version("wrenchbook"),
        summary=_SUMMARY,
        description=f"{_SUMMARY}\n\nThe wrench contract:\n\n{CONTRACT_TEXT}",
        lifespan=lifespan,
        redirect_slashes=False,
        docs_url=None,  # service/http/routes/page.py has it without a host of others
        redoc_url=None,
    )
    app.state.counts = counts
    app.state.door = Door(Keyring(settings.folder), opening or Opening())
    _install(app)
    return app


def _install(app: Application) -> None:
    """Put the routes, the errors and the document into the application."""
    problems.install(app)
    of_components = (
        displacement,
        components,
        coverage,
        deformed,
        table,
        rows,
        library,
        report,
        gathering,
    )
    for part in (*of_components, scenes, jobs, events, health, metrics, umbridge, keys):
        app.include_router(part.router)
    app.include_router(gathering.blocks)
    for part in (drawing, job_log, page):
        app.include_router(part.router)
    openapi.install(app)
