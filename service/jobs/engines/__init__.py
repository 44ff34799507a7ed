"""Engines: where solvers run. They only execute; what counts is decided by the ledger.

Every engine runs `service.jobs.solve_attempt` FOLDER, as `child_command` puts it, somewhere that
sees the folder.
"""

from service.jobs.engines.engine import Engine, EngineError, State
from service.jobs.engines.local import LocalEngine

ENGINES = ("local",)


def open_engine(name: str = "local", slots: int | None = None) -> Engine:
    """Return the engine of that name; `slots` defaults to the number of usable cores.

    Raises
    ------
    ValueError
        If there is none of that name.
    """
    if name == "local":
        return LocalEngine(slots)
    raise ValueError(f"there is no engine {name!r}; there are: {', '.join(ENGINES)}")


__all__ = ["ENGINES", "Engine", "EngineError", "State", "open_engine"]
