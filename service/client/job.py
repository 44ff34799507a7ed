"""Solves in the server's queue, as its replies describe them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]
ENDED = ("done", "failed", "cancelled")


@dataclass(frozen=True, eq=False)
class Job:
    """A queued solve.

    Parameters
    ----------
    id : int
        Number of the job.
    status : str
        ``waiting``, ``running``, ``done``, ``failed`` or ``cancelled``.
    url : str
        Path of the job on the server.
    component : str
        Empty in the short form that a displacement carries.
    raw : dict
        The reply as it came: ``progress``, ``attempt``, ``created`` and more.
    """

    id: int
    status: str
    url: str = ""
    component: str = ""
    raw: dict[str, Any] = field(default_factory=dict, repr=False)

    @classmethod
    def read(cls, body: Mapping[str, Any]) -> Self:
        """Make one from a job of a reply."""
        return cls(
            body["id"],
            body["status"],
            body.get("url") or f"/v1/jobs/{body['id']}",
            body.get("component") or "",
            dict(body),
        )

    @property
    def ended(self) -> bool:
        """Whether nothing more will happen to it unless it is retried."""
        return self.status in ENDED

    @property
    def progress(self) -> float:
        """Fraction of the solve that is done, 0 to 1."""
        if self.status == "done":
            return 1.0
        return float((self.raw.get("progress") or {}).get("fraction", 0.0))

    @property
    def failure(self) -> str:
        """Why it failed and what to do; empty unless it did."""
        error = self.raw.get("error") or {}
        words = (error.get("kind"), error.get("message"), error.get("remedy"))
        return ". ".join(str(word).rstrip(".") for word in words if word)

    @property
    def seconds(self) -> float | None:
        """Time its last attempt took, s; None while it has not ended."""
        return self.raw.get("seconds")

    @property
    def vector(self) -> Vector | None:
        """The displacement a done job found, shape (6,), m and rad."""
        return joined(self.raw.get("translation"), self.raw.get("rotation"))


@dataclass(frozen=True, eq=False)
class Round:
    """One round of filling a table.

    Parameters
    ----------
    jobs : tuple of Job
        The solves queued; none when the table is as thick as asked.
    stage : str
        ``first``, ``refine`` or ``met``.
    reason : str
        Why these, or why none.
    """

    jobs: tuple[Job, ...]
    stage: str = ""
    reason: str = ""

    @classmethod
    def read(cls, body: Mapping[str, Any]) -> Self:
        """Make one from the reply of ``fill``."""
        jobs = tuple(Job.read(job) for job in body["jobs"])
        return cls(jobs, body.get("stage") or "", body.get("reason") or "")


def joined(first: Any, second: Any) -> Vector | None:
    """Return translation and rotation as one vector, shape (6,), m and rad; None if one is None."""
    if first is None or second is None:
        return None
    return np.concatenate([first, second])
