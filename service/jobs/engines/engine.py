"""What a dispatcher needs of an engine. Engines only execute; what counts the ledger decides.

Every engine runs `service.jobs.solve_attempt` FOLDER, as `child_command` puts it, somewhere that
sees the folder.
"""

from pathlib import Path
from typing import Literal, Protocol

State = Literal["running", "finished", "lost"]


class EngineError(Exception):
    """The engine could not take an attempt now; the job should wait and be tried again."""


class Engine(Protocol):
    """What a dispatcher needs of an engine. Called from one thread at a time."""

    @property
    def slots(self) -> int:
        """How many attempts it runs at the same time."""
        ...

    def submit(self, folder: Path) -> None:
        """Start the attempt in `folder`.

        Raises
        ------
        OSError, EngineError
            If it could not be started; nothing runs then.
        """
        ...

    def attach(self, folder: Path) -> None:
        """Look after an attempt that another dispatcher's engine started."""
        ...

    def poll(self, folder: Path) -> State:
        """Return ``finished`` if there is a result.json, else whether a solver is at it.

        ``lost`` is final: no solver lives that could still write a result.json there.
        """
        ...

    def cancel(self, folder: Path) -> None:
        """Ask the attempt's solver to end soon; `poll` tells when it has. May be repeated."""
        ...

    def close(self) -> None:
        """Let go of what the engine holds; solvers that run are left running."""
        ...
