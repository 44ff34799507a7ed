"""The web application of one book."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from importlib.metadata import version

from fastapi import FastAPI
from starlette.concurrency import run_in_threadpool

from service.contract import CONTRACT_TEXT
from service.http import problems
from service.http.routes import components, coverage, displacement, health, jobs, report, table
from service.workspace import Book, Settings

_SUMMARY = (
    "POST the wrench that acts on a component, get its displacement from a table of "
    "finite-element results, with an error bar. Where the table is too thin, a solve is queued."
)


def create_app(settings: Settings) -> FastAPI:
    """Return the application; its book opens when the server starts and closes when it stops."""

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        book = await run_in_threadpool(Book, settings)
        app.state.book = book
        loop = asyncio.get_running_loop()
        try:
            await run_in_threadpool(book.start, loop)
            yield
        finally:
            await run_in_threadpool(book.close)

    app = FastAPI(
        title="wrenchbook",
        version=version("wrenchbook"),
        summary=_SUMMARY,
        description=f"{_SUMMARY}\n\nThe wrench contract:\n\n{CONTRACT_TEXT}",
        lifespan=lifespan,
        redirect_slashes=False,
    )
    problems.install(app)
    for part in (displacement, components, coverage, table, report, jobs, health):
        app.include_router(part.router)
    return app
