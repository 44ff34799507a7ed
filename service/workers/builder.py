"""The process that builds tables and dispatches jobs; it answers no request."""

from __future__ import annotations

import logging
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

from threadpoolctl import threadpool_limits
from uvicorn.config import STARTUP_FAILURE

from wrenchbook.service.fields.store import FieldStore
from wrenchbook.service.jobs.dispatcher import Dispatcher
from wrenchbook.service.jobs.engines import open_engine
from wrenchbook.service.ledger import Ledger
from wrenchbook.service.library.library import Library
from wrenchbook.service.ops.retention import Retention, kept_by
from wrenchbook.service.settings import Settings
from wrenchbook.service.tables.build import TableBuilder
from wrenchbook.service.tables.coordinator_state import FOLDER, CoordinatorState
from wrenchbook.service.tables.solver_errors import SolverErrors
from wrenchbook.service.tables.store import TableStore

log = logging.getLogger(__name__)

Parts = tuple[Ledger, Library, SolverErrors]


@contextmanager
def opened(settings: Settings) -> Iterator[Parts]:
    """Open ledger, library and solver errors of a data directory.

    A full disk or a damaged ledger does not keep the existing tables from answering.
    """
    folder = settings.data
    ledger = Ledger(folder / "ledger.sqlite", patient=True)
    try:
        if trouble := ledger.trouble():
            log.error("nothing is accepted until this is repaired: %s", trouble)
        library = Library(folder / "components", allow_decks=settings.allow_decks)
        yield ledger, library, SolverErrors(ledger)
    finally:
        ledger.close()


@contextmanager
def solving(settings: Settings, parts: Parts) -> Iterator[Dispatcher | None]:
    """Run the jobs of a ledger, if the settings have solvers: all that `wrenchbook work` needs.

    Solves that run at the end are ended, and wait for the next start.
    """
    if not settings.solvers:
        yield None
        return
    (ledger, library, errors), jobs = parts, settings.data / "jobs"
    engine = open_engine(settings.engine, settings.solvers, scheduler=settings.scheduler)
    fields = FieldStore(settings.data / "fields")
    dispatcher = Dispatcher(ledger, engine, lambda name: library[name].folder, jobs, fields, errors)
    retention = Retention(ledger, jobs, kept_by(settings))
    dispatcher.start()
    retention.start()
    try:
        yield dispatcher
    finally:
        retention.stop()
        dispatcher.stop()
        engine.close()
        log.info("solvers have ended; the jobs they were at wait for the next start")


@contextmanager
def building(settings: Settings, parts: Parts, state: CoordinatorState) -> Iterator[TableBuilder]:
    """Build tables and run jobs, once the small tables are there."""
    # Threads of small matrix products only wait for each other, the more the busier the cores.
    threadpool_limits(limits=1)
    ledger, library, errors = parts
    dispatcher: Dispatcher | None = None
    tables = TableBuilder(
        TableStore(settings.data / "tables", ledger, errors),
        library,
        state,
        settings.table_memory,
        trouble=lambda: dispatcher and dispatcher.trouble,
    )
    with ExitStack() as stack:
        stack.callback(tables.stop)
        tables.start()
        dispatcher = stack.enter_context(solving(settings, parts))
        yield tables


def run(settings: Settings, started: threading.Event) -> None:
    """Build tables and dispatch jobs until SIGTERM; `started` is set once both are at work.

    A data directory with another builder ends the process.
    """
    stop = threading.Event()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C: the parent ends this process
    signal.signal(signal.SIGTERM, lambda *_: stop.set())
    state = CoordinatorState(settings.data / FOLDER)
    if not state.take():
        log.error(
            "another server uses %s; stop it first, or serve another directory with --data",
            settings.data,
        )
        sys.exit(STARTUP_FAILURE)
    try:
        with opened(settings) as parts, building(settings, parts, state):
            started.set()
            stop.wait()
    finally:
        state.release()
