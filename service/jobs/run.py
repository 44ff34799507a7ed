"""An attempt that a dispatcher looks after."""

from dataclasses import dataclass
from pathlib import Path

from wrenchbook.service.jobs.attempt import solver_began
from wrenchbook.service.jobs.engines.engine import Attempt
from wrenchbook.service.ledger import Job


@dataclass
class Run:
    """An attempt this dispatcher looks after.

    Attributes
    ----------
    taken : bool
        Whether an engine has taken it.
    witnessed : bool
        Whether its solver has lived in this dispatcher's time.
    adopted : bool
        Whether another dispatcher started it.
    leaving : bool
        Whether nobody wants its answer any more.
    began : bool
        Whether a solver was seen at it.
    died : float or None
        When it was first seen dead, monotonic seconds.
    """

    job: Job
    attempt: Attempt
    taken: bool = False
    witnessed: bool = True
    adopted: bool = False
    leaving: bool = False
    began: bool = False
    died: float | None = None

    @property
    def key(self) -> tuple[int, int]:
        """Job and attempt."""
        return self.job.id, self.job.attempt

    @property
    def folder(self) -> Path:
        """The attempt's folder."""
        return self.attempt.folder

    @property
    def is_pressing(self) -> bool:
        """Whether to look at it often: nobody may tell of its end, or something is due soon."""
        return self.adopted or self.leaving or self.died is not None

    @property
    def counts(self) -> bool:
        """Whether a solver that left nothing has died by itself, for all that is known."""
        return self.witnessed and (self.began or solver_began(self.folder))
