"""Where solvers run: engines by name."""

from importlib.util import find_spec

from wrenchbook.service.jobs.engines.engine import Engine
from wrenchbook.service.jobs.engines.local import LocalEngine

ENGINES = ("local", "dask")
_SCHEMES = ("tcp", "tls", "ws", "wss", "ucx")  # that Dask connects to other machines by


class EngineSettingsError(ValueError):
    """An engine cannot be opened with these settings; the message has the remedy."""


def open_engine(
    name: str = "local", slots: int | None = None, *, scheduler: str | None = None
) -> Engine:
    """Return the engine of that name.

    Parameters
    ----------
    name : str
        ``local`` or ``dask``.
    slots : int, optional
        Solves at once of ``local``, the number of usable cores by default; the workers of a Dask
        cluster have as many as they have threads.
    scheduler : str, optional
        Address of the Dask scheduler, such as ``tcp://10.0.0.1:8786``.

    Raises
    ------
    EngineSettingsError
        If there is none of that name, or it lacks its scheduler or its packages.
    """
    check_engine(name, scheduler)
    if name == "local":
        return LocalEngine(slots)
    # Only a server with a cluster has Dask, and waits for its import.
    from wrenchbook.service.jobs.engines.dask import DaskEngine

    return DaskEngine(scheduler or "")


def check_engine(name: str, scheduler: str | None) -> None:
    """Refuse, before anything is opened, settings that `open_engine` would refuse."""
    if name not in ENGINES:
        raise EngineSettingsError(f"there is no engine {name!r}; there are: {', '.join(ENGINES)}")
    if name != "dask":
        if scheduler:
            raise EngineSettingsError(f"the engine {name} has no scheduler; add --engine dask")
        return
    if not scheduler:
        raise EngineSettingsError("the engine dask needs --scheduler tcp://HOST:8786 (or tls://)")
    if "://" not in scheduler:
        raise EngineSettingsError(f"{scheduler!r} is no address; write tcp://{scheduler}")
    if scheduler.split("://")[0] not in _SCHEMES:
        begins = " or ".join(f"{one}://" for one in _SCHEMES)
        raise EngineSettingsError(
            f"{scheduler!r} is no address of a Dask scheduler: it begins with {begins}"
        )
    if find_spec("distributed") is None:
        raise EngineSettingsError(
            "the engine dask is not installed: pip install wrenchbook[cluster]"
        )
