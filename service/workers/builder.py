"""The process that builds tables and dispatches jobs; web workers answer the requests."""

from __future__ import annotations

import logging
import os
import shutil
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import asdict
from pathlib import Path

from threadpoolctl import threadpool_limits
from uvicorn.config import STARTUP_FAILURE

from wrenchbook.service.fields.store import FieldStore
from wrenchbook.service.jobs.dispatcher import Dispatcher
from wrenchbook.service.jobs.solver_pool import LocalEngine
from wrenchbook.service.keys import OWN_KEY
from wrenchbook.service.ledger import FINAL, Ledger, LedgerError, noted
from wrenchbook.service.library.library import Library
from wrenchbook.service.ops.replica import shown
from wrenchbook.service.settings import Settings
from wrenchbook.service.tables.build import TableBuilder
from wrenchbook.service.tables.coordinator_state import FOLDER, CoordinatorState
from wrenchbook.service.tables.solver_errors import SolverErrors
from wrenchbook.service.tables.store import TableStore
from wrenchbook.service.workers.supervisor import IN_USE

log = logging.getLogger(__name__)

Parts = tuple[Ledger, Library, SolverErrors]

DAY = 86_400.0  # s
CHECK_S = 30.0  # interval of checks of the ledger's log, so that it stays below 16 MB
PRUNE_S = 600.0  # interval of removals of old folders, whose age is in days
MAX_LOG_BYTES = 4 * 1024 * 1024  # SQLite begins to move it into the ledger at this size
FOLDERS_AT_ONCE = 2000  # folders of one query of the ledger, which then takes milliseconds


@contextmanager
def open_data(settings: Settings) -> Iterator[Parts]:
    """Open ledger, library and solver errors of a data directory.

    On a full disk or with a damaged ledger the existing tables still answer.
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
    """Run the jobs of a ledger, if the settings have solvers.

    At the end running solves are stopped; their jobs wait for the next start.
    """
    if not settings.solvers:
        yield None
        return
    (ledger, library, errors), jobs = parts, settings.data / "jobs"
    if settings.engine == "local":
        engine = LocalEngine(settings.solvers)
    else:
        from wrenchbook.service.jobs.dask import DaskEngine  # only a server with a cluster has Dask

        engine = DaskEngine(settings.scheduler or "")
    fields = FieldStore(settings.data / "fields")
    dispatcher = Dispatcher(
        ledger, engine, lambda name: library[name].folder, jobs, fields, errors,
        setups=lambda name: library[name].fingerprint,
    )  # fmt: skip
    stop = threading.Event()
    arguments = ledger, jobs, settings, stop
    retention = threading.Thread(target=retain, args=arguments, name="retention", daemon=True)
    dispatcher.start()
    retention.start()
    try:
        yield dispatcher
    finally:
        stop.set()
        retention.join()
        dispatcher.stop()
        engine.close()
        log.info("solvers have ended; their unfinished jobs wait for the next start")


def retain(ledger: Ledger, jobs: Path, settings: Settings, stop: threading.Event) -> None:
    """Limit the size of a data directory: remove old attempts' folders, empty the ledger's log."""
    next_prune = time.monotonic()
    while not stop.wait(CHECK_S):
        try:
            shorten_log(ledger)
            if time.monotonic() >= next_prune:
                prune(ledger, jobs, settings, stop)
                next_prune = time.monotonic() + PRUNE_S
        except LedgerError:
            continue  # the ledger logs it
        except Exception:
            log.exception("retention failed; it is tried again")


def shorten_log(ledger: Ledger, longest: int = MAX_LOG_BYTES) -> bool:
    """Empty the ledger's log if it is longer than `longest` bytes; return whether it is empty."""
    return ledger.sizes()["log"] > longest and ledger.checkpoint()


def prune(ledger: Ledger, jobs: Path, settings: Settings, stop: threading.Event) -> int:
    """Remove the folders of ended attempts beyond the age or number of the settings.

    Rows and jobs stay, and so do folders of open jobs and of unknown jobs. A job that ended in the
    future, by a clock that was set back since, counts as new. Return the number of jobs whose
    folders were removed.
    """
    limits = {  # by whether the job is done
        True: (settings.keep_days, settings.keep_count),
        False: (settings.keep_failed_days, settings.keep_failed_count),  # they have the cause
    }
    # SQLite's numbers have 63 bits: a folder with a larger number is no job's.
    numbers = [int(name) for name in _names(jobs) if name.isdecimal()]
    numbers = sorted((number for number in numbers if number < 1 << 63), reverse=True)
    remaining = {True: 0, False: 0}
    removed = 0
    now = time.time()
    for start in range(0, len(numbers), FOLDERS_AT_ONCE):
        part = numbers[start : start + FOLDERS_AT_ONCE]
        known = ledger.attempts(part)
        for number in part:
            if stop.is_set():
                return removed
            status, last, ended = known.get(number, ("unknown", 0, None))
            if status not in FINAL or ended is None:
                continue
            is_done = status == "done"
            folder = jobs / str(number)
            days, max_count = limits[is_done]
            if remaining[is_done] < max_count and now - ended < days * DAY:
                remaining[is_done] += 1
                continue
            for name in _names(folder):  # later attempts, of a reopened job, stay
                attempt = name.partition(".")[0]  # "2.old-..." is of an earlier ledger
                if attempt.isdecimal() and int(attempt) <= last:
                    shutil.rmtree(folder / name, ignore_errors=True)
            try:
                folder.rmdir()
                removed += 1
            except OSError:
                continue  # the job has a later attempt
    if removed:
        log.info("the folders of %d ended jobs were removed", removed)
    return removed


def _names(folder: Path) -> list[str]:
    try:
        return os.listdir(folder)  # noqa: PTH208 (a list of 10**5 names, no 10**5 paths)
    except OSError:
        return []


@contextmanager
def building(settings: Settings, parts: Parts, state: CoordinatorState) -> Iterator[TableBuilder]:
    """Build tables; run jobs once the small tables are built."""
    # Several threads make small matrix products slower, above all on busy cores.
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
    """Build tables and dispatch jobs until SIGTERM; `started` is set once both are running.

    Ends the process with `STARTUP_FAILURE` if the data directory has another builder.
    """
    stop = threading.Event()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C: the parent ends this process
    signal.signal(signal.SIGTERM, lambda *_: stop.set())
    state = CoordinatorState(settings.data / FOLDER)
    if not state.take():
        log.error(IN_USE.format(settings.data, "another server"))
        sys.exit(STARTUP_FAILURE)
    try:
        with open_data(settings) as parts, building(settings, parts, state):
            if OWN_KEY not in os.environ:  # not for a private server of a command
                note_settings(parts[0], settings)
            started.set()
            stop.wait()
    finally:
        state.release()


def note_settings(ledger: Ledger, settings: Settings) -> None:
    """Add to the audit the settings that differ from those of the last start."""
    with suppress(LedgerError):  # tables answer without this entry
        known = ledger.audit(action="settings", limit=1)
        before = known[0].after if known else None
        after = asdict(settings)
        after |= {k: shown(str(v)) for k, v in after.items() if isinstance(v, str | Path)}
        if before != after:
            with noted(ledger, "settings", "serve", before=before, after=after):
                pass
