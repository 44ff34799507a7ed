"""Settings of a workspace, the same in all processes of a server."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from wrenchbook.service.files.program import usable_cores
from wrenchbook.service.ops.retention import KEEP, Keep
from wrenchbook.service.submission import QUEUE_LIMIT
from wrenchbook.service.tables.store import TABLE_MEMORY


@dataclass(frozen=True)
class Settings:
    """Where a workspace lies and how many solves may run at once on this machine.

    Parameters
    ----------
    folder:
        The data directory; everything the server must not lose is in it.
    solvers:
        Solves at once, as many as there are cores by default; 0 leaves all solving to other
        processes (``wrenchbook work``).
    engine:
        Where they run, by name.
    scheduler:
        Address of the Dask scheduler, if they run on a Dask cluster.
    allow_decks:
        Whether an uploaded bundle may have a deck: it names a command, which solvers then run.
    queue_limit:
        Open jobs of a component that queries may have; those of fills and solves do not count.
    table_memory:
        MB of rows and numpy tables that a process keeps; packed tables are mapped.
    method:
        What answers where a request names no method; a table's own default if None.
    keep:
        Which folders of ended attempts are kept.
    access_log:
        Whether each request is a line of the log.
    opentelemetry:
        Whether requests are traced; without it, OTEL_* variables of the environment decide.
    processes:
        How many web workers the server has.
    """

    folder: Path
    solvers: int = field(default_factory=usable_cores)
    engine: str = "local"
    allow_decks: bool = False
    queue_limit: int = QUEUE_LIMIT
    scheduler: str | None = None
    table_memory: int = TABLE_MEMORY
    keep: Keep = KEEP
    method: str | None = None
    access_log: bool = False
    processes: int = 1


def settings_of_options(options: Mapping[str, Any]) -> Settings:
    """Return the settings of a process of the server by the options of `serve`.

    Parameters
    ----------
    options : mapping
        By name; those that are no settings of a workspace are ignored.
    """
    keep = Keep(
        *(options[f"keep_{one}"] for one in ("days", "count", "failed_days", "failed_count"))
    )
    return Settings(
        folder=Path(options["data"]),
        solvers=options["solvers"],
        engine=options["engine"],
        allow_decks=options["allow_decks"],
        queue_limit=options["queue_limit"],
        table_memory=options["table_memory"],
        scheduler=options["scheduler"],
        keep=keep,
        method=options["method"],
        access_log=options["access_log"],
        processes=options["processes"],
    )
