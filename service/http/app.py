"""The web application of one workspace."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from importlib.metadata import version

from fastapi import FastAPI
from starlette.concurrency import run_in_threadpool

from service.contract import CONTRACT_TEXT
from service.http import openapi, problems
from service.http.application import Application
from service.http.routes import (
    components,
    coverage,
    displacement,
    health,
    jobs,
    report,
    rows,
    table,
)
from service.workspace import Settings, Workspace

_SUMMARY = (
    "POST the wrench that acts on a component, get its displacement from a table of "
    "finite-element results, with an error bar. Where the table is too thin, a solve is queued."
)


def create_app(settings: Settings) -> Application:
    """Return the application; its workspace is open while the server runs."""

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        workspace = await run_in_threadpool(Workspace, settings)
        app.state.workspace = workspace
        loop = asyncio.get_running_loop()
        try:
            await run_in_threadpool(workspace.start, loop)
            yield
        finally:
            await run_in_threadpool(workspace.close)

    app = Application(
        title="wrenchbook",
        version=version("wrenchbook"),
        summary=_SUMMARY,
        description=f"{_SUMMARY}\n\nThe wrench contract:\n\n{CONTRACT_TEXT}",
        lifespan=lifespan,
        redirect_slashes=False,
    )
    problems.install(app)
    for part in (displacement, components, coverage, table, rows, report, jobs, health):
        app.include_router(part.router)
    openapi.install(app)
    return app
