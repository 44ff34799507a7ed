"""The engines that run attempts, `local` and `dask`. Engines execute; the ledger decides.

Several threads may call an engine, one at a time; no call waits for another machine. ``name``
stands in the ledger: only dispatchers with this engine take its attempts over. ``slots`` is how
many attempts it takes at the same time, ``trouble`` what keeps it from running any.

- ``submit`` starts or queues an attempt; OSError or `EngineError` says that nothing runs then.
- ``attach`` takes over an attempt of another dispatcher, which has died. If nothing of the task is
  known any more, it is ``lost``, or submitted again under the same key.
- ``poll`` returns ``submitted`` until a solver works on the attempt, then ``running``, ``finished``
  once its folder holds a result.json and the other artifacts. ``lost`` is final: no solver lives
  that could still write one there. A death of workers, scheduler or machines is no state: the
  engine runs the attempt again. An engine that ends an attempt itself, at its deadline for example,
  writes the result.json in the solver's stead, once the solver is dead. The cause of a solver's
  death, as far as it is known, is the last line of the attempt's log.
- ``cancel`` has the solver end soon; `poll` shows when it counts as ended. It may be repeated, and
  the attempt may be one that was neither submitted nor attached here.
- ``forget`` drops what is kept of an attempt that is recorded, or that another dispatcher has;
  ``close`` releases the engine's resources, and running attempts go on.
"""

from __future__ import annotations

from importlib.util import find_spec
from typing import TYPE_CHECKING, TypeAlias

from wrenchbook.service.jobs.solver_pool import LocalEngine

if TYPE_CHECKING:  # only a server with a cluster has Dask, and waits for its import
    from wrenchbook.service.jobs.dask import DaskEngine

Engine: TypeAlias = "LocalEngine | DaskEngine"


class EngineSettingsError(ValueError):
    """An engine cannot be opened with these settings; the message has the remedy."""


_SCHEMES = ("tcp", "tls", "ws", "wss", "ucx")  # that Dask connects to other machines by


def open_engine(
    name: str = "local", slots: int | None = None, *, scheduler: str | None = None
) -> Engine:
    """Return the engine ``local``, with so many slots, or ``dask``, of the scheduler at an address.

    Raises `EngineSettingsError` if there is none of that name, or it lacks its scheduler or its
    packages.
    """
    check_engine(name, scheduler)
    if name == "local":
        return LocalEngine(slots)
    from wrenchbook.service.jobs.dask import DaskEngine

    return DaskEngine(scheduler or "")


def check_engine(name: str, scheduler: str | None) -> None:
    """Refuse, before anything is opened, settings that `open_engine` would refuse."""
    why = None
    if name not in ("local", "dask"):
        why = f"there is no engine {name!r}; there are: local, dask"
    elif name == "local":
        why = scheduler and "the engine local has no scheduler; add --engine dask"
    elif not scheduler:
        why = "the engine dask needs --scheduler tcp://HOST:8786 (or tls://)"
    elif "://" not in scheduler:
        why = f"{scheduler!r} is no address; write tcp://{scheduler}"
    elif scheduler.split("://")[0] not in _SCHEMES:
        begins = " or ".join(f"{scheme}://" for scheme in _SCHEMES)
        why = f"{scheduler!r} is no address of a Dask scheduler: it begins with {begins}"
    elif find_spec("distributed") is None:
        why = "the engine dask is not installed: pip install wrenchbook[cluster]"
    if why:
        raise EngineSettingsError(why)
