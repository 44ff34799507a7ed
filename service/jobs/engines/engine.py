"""What a dispatcher needs of an engine. Engines only execute; what counts the ledger decides.

An engine runs attempts: `service.jobs.solve_attempt` on a folder that holds what the attempt's has.
The attempt's own folder is on the dispatcher's machine and need not be seen where the solver runs;
whatever the engine, in the end it holds ``result.json`` (see `service.jobs.attempt`) and the log.

An engine that ends an attempt itself, at its deadline say, writes the ``result.json`` in the
solver's stead, with kind, message and remedy, once the solver is surely dead. What it knows of a
solver that died by itself it adds to the attempt's log as a last line: the dispatcher reads the
cause there.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Protocol

from service.jobs.attempt import Spec

State = Literal["submitted", "running", "finished", "lost"]
ALIVE: tuple[State, ...] = ("submitted", "running")

Heard = Callable[[str], None]
"""Told the task key of an attempt whose state may have changed; called from any thread."""


class EngineError(Exception):
    """The engine could not take an attempt now; the job should wait and be tried again."""


@dataclass(frozen=True)
class Attempt:
    """One attempt, as a dispatcher hands it to an engine.

    Attributes
    ----------
    task : str
        The task key: one attempt of one job of one data directory has it, and it is in the ledger
        before the engine hears of it. Handed in twice it is one attempt.
    folder : Path
        Its folder on this machine, absolute, with its spec.json.
    spec : Spec
        What it solves; ``spec.bundle`` is the component's folder on this machine.
    priority : int
        Of the job; higher ones go first where an engine has a queue of its own.
    deadline : float or None
        Seconds a solver may be at it, from its first instruction; then the attempt fails as
        ``deadline``. None sets no bound.
    memory : int or None
        Bytes a solve of this component takes, as the check of its bundle estimates them (right to a
        factor of two); None if no check has been stored.
    cores : int
        A solver uses so many; its libraries are held to as many threads.
    """

    task: str
    folder: Path
    spec: Spec
    priority: int = 0
    deadline: float | None = None
    memory: int | None = None
    cores: int = 1


class Engine(Protocol):
    """What a dispatcher needs of an engine. May be called from several threads, in turn."""

    @property
    def name(self) -> str:
        """Its name in the ledger: an attempt is looked after by dispatchers of that engine only."""
        ...

    @property
    def slots(self) -> int:
        """How many attempts it takes at the same time; may change as workers come and go."""
        ...

    @property
    def trouble(self) -> str | None:
        """What keeps it from running attempts at present, in words; None if nothing does."""
        ...

    def submit(self, attempt: Attempt) -> None:
        """Start the attempt, or put it into the engine's own queue; returns without waiting for it.

        Raises
        ------
        OSError, EngineError
            If it could not be taken; nothing runs then.
        """
        ...

    def attach(self, attempt: Attempt) -> None:
        """Look after an attempt that another dispatcher's engine of this name took.

        That one has died. Where nothing of the task is known any more `poll` says ``lost``, or the
        engine submits it again under the same key, as it sees fit.
        """
        ...

    def poll(self, attempt: Attempt) -> State:
        """Return how the attempt stands; quick, asks nobody far away.

        ``submitted`` until a solver is at it, then ``running``. ``finished`` once its folder holds
        a result.json and the other files that are to stay. ``lost`` is final: no solver lives that
        could still write one there. A death that is the engine's own doing or its machines' (a
        worker gone, a scheduler restarted) is not told: the engine runs the attempt again.
        """
        ...

    def cancel(self, attempt: Attempt) -> None:
        """Ask the attempt's solver to end soon; `poll` tells when it has. May be repeated.

        Also of an attempt that was neither submitted nor attached here: it was cancelled while no
        dispatcher lived, and its task key is all there is.
        """
        ...

    def forget(self, attempt: Attempt) -> None:
        """Let go of what is kept of an attempt that is settled, or that another dispatcher has."""
        ...

    def listen(self, heard: Heard) -> Callable[[], None]:
        """Have `heard` called when an attempt's state may have changed; returns what ends that.

        A dispatcher looks at an attempt at once when it is told, and at all of them once a second
        in case it was not.
        """
        ...

    def close(self) -> None:
        """Let go of what the engine holds; attempts that run are left running."""
        ...
