"""What a server is told at its start, as all its processes hold it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from wrenchbook.service.files.program import usable_cores
from wrenchbook.service.ops.retention import KEEP, Keep
from wrenchbook.service.submission import QUEUE_LIMIT
from wrenchbook.service.tables.served import TABLE_MEMORY

# What a process does of the work on a data directory: all of it; or, of several, the one that
# builds tables and has jobs run, or one of those that answer.
Part = Literal["all", "coordinator", "answering"]


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
    keep:
        Which folders of ended attempts are kept.
    part:
        What of the work is this process'.
    number:
        Which one it is of several that answer, from 1.
    """

    folder: Path
    solvers: int = field(default_factory=usable_cores)
    engine: str = "local"
    allow_decks: bool = False
    queue_limit: int = QUEUE_LIMIT
    scheduler: str | None = None
    table_memory: int = TABLE_MEMORY
    keep: Keep = KEEP
    part: Part = "all"
    number: int = 0


def settings_of_options(said: Mapping[str, Any], part: Part = "all", number: int = 0) -> Settings:
    """Return the settings of a process of the server by the options of `serve`.

    Parameters
    ----------
    said : mapping
        The options by name; what is no setting of a workspace is left alone.
    part, number
        As in `Settings`.
    """
    keep = Keep(*(said[f"keep_{one}"] for one in ("days", "count", "failed_days", "failed_count")))
    return Settings(
        folder=Path(said["data"]),
        solvers=said["solvers"],
        engine=said["engine"],
        allow_decks=said["allow_decks"],
        queue_limit=said["queue_limit"],
        table_memory=said["table_memory"],
        scheduler=said["scheduler"],
        keep=keep,
        part=part,
        number=number,
    )
