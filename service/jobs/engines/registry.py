"""Engines by name."""

from collections.abc import Callable, Mapping

from service.jobs.engines.engine import Engine
from service.jobs.engines.local import LocalEngine

ENGINES: Mapping[str, Callable[[int | None], Engine]] = {"local": LocalEngine}


def open_engine(name: str = "local", slots: int | None = None) -> Engine:
    """Return the engine of that name; `slots` defaults to the number of usable cores.

    Raises
    ------
    ValueError
        If there is none of that name.
    """
    if name not in ENGINES:
        raise ValueError(f"there is no engine {name!r}; there are: {', '.join(ENGINES)}")
    return ENGINES[name](slots)
