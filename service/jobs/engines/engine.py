"""The interface between dispatcher and engines. Engines only execute; the ledger decides.

An engine runs attempts: a solver (`service.jobs.solve_attempt`) works on a folder with a spec.json.
The attempt's own folder is on the dispatcher's machine and need not be visible where the solver
runs; in the end it holds ``result.json`` (see `service.jobs.attempt`) and the log.

An engine that ends an attempt itself, at its deadline for example, writes the ``result.json`` in
the solver's stead, with kind, message and remedy, once the solver is dead. The cause of a solver's
death, as far as the engine knows it, is the last line of the attempt's log.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Protocol

from wrenchbook.service.jobs.attempt import Spec

State = Literal["submitted", "running", "finished", "lost"]
ALIVE: tuple[State, ...] = ("submitted", "running")

Listener = Callable[[str], None]
"""Gets the task key of an attempt whose state may have changed; called from any thread."""


class EngineError(Exception):
    """The engine cannot take an attempt now; the job should wait and be tried again."""


@dataclass(frozen=True)
class Attempt:
    """One attempt, as a dispatcher hands it to an engine.

    Attributes
    ----------
    task : str
        The task key: unique to an attempt of a job of a data directory, and in the ledger before
        the engine gets it. Two submissions of one key are one attempt.
    folder : Path
        Its folder on this machine, absolute, with its spec.json.
    spec : Spec
        What it solves; ``spec.bundle`` is the component's folder on this machine.
    priority : int
        Of the job; higher ones go first where an engine has a queue of its own.
    deadline : float or None
        Seconds from the solver's first instruction after which the attempt fails as ``deadline``.
    memory : int or None
        Bytes a solve of this component takes, as the check of its bundle estimates them (right to a
        factor of two); None if no check has been stored.
    cores : int
        Cores of a solver; its libraries use as many threads.
    """

    task: str
    folder: Path
    spec: Spec
    priority: int = 0
    deadline: float | None = None
    memory: int | None = None
    cores: int = 1


class Engine(Protocol):
    """Runs attempts. Several threads may call it, one at a time."""

    @property
    def name(self) -> str:
        """Its name in the ledger: only dispatchers with this engine take its attempts over."""
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
        """Take over an attempt of another dispatcher, which has died, on an engine of this name.

        If nothing of the task is known any more, `poll` returns ``lost`` or the engine submits it
        again under the same key.
        """
        ...

    def poll(self, attempt: Attempt) -> State:
        """Return the attempt's state, without waiting for any other machine.

        ``submitted`` until a solver works on it, then ``running``. ``finished`` once its folder
        holds a result.json and the other artifacts. ``lost`` is final: no solver lives that could
        still write one there. A death of workers, scheduler or machines is no state: the engine
        runs the attempt again.
        """
        ...

    def cancel(self, attempt: Attempt) -> None:
        """Have the attempt's solver end soon; `poll` shows when it counts as ended. Repeatable.

        A solver on another machine may end some seconds later than the attempt. The attempt may be
        one that was neither submitted nor attached here: it was cancelled while no dispatcher
        lived, and its task key is all there is.
        """
        ...

    def forget(self, attempt: Attempt) -> None:
        """Drop what is kept of an attempt that is settled, or that another dispatcher has."""
        ...

    def listen(self, listener: Listener) -> Callable[[], None]:
        """Call the listener when an attempt's state may have changed; returns what ends that.

        A dispatcher polls such an attempt at once, and all attempts once a second.
        """
        ...

    def close(self) -> None:
        """Release the engine's resources; running attempts go on."""
        ...
