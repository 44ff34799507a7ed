"""Solves in the server's queue: their state, and the calls that follow, cancel and order them."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, Protocol, Self

import numpy as np

from ..messages import JobLink, Queued
from .errors import InvalidArgument, Json, ServerTimeout
from .transport import Connection, component_path
from .wrenches import Tolerance, Vector, options

ENDED = ("done", "failed", "cancelled")
LONGEST_POLL_S = 20.0  # proxies end calls that take longer
SHORTEST_POLL_S = 0.05  # limits polls to 20 a second if a server answers at once
ROUND = 24  # default number of solves in a round of `fill_until`


class Job(JobLink):
    """A queued solve.

    Attributes
    ----------
    id : int
        Number of the job.
    status : str
        ``waiting``, ``running``, ``done``, ``failed`` or ``cancelled``.
    url : str
        Path of the job on the server.
    component : str
        Its name.
    seconds : float or None
        Time its last attempt took, s; None while it has not ended.
    raw : dict
        The reply as it came: ``progress``, ``attempt``, ``created`` and more.
    """

    component: str = ""
    seconds: float | None = None

    @classmethod
    def read(cls, body: Mapping[str, Json], component: str = "", **more: Any) -> Self:
        """Return a job from its JSON; `component`: of a short form that lacks it."""
        job = super().read(body, **more)
        job.__dict__["component"] = job.component or component
        return job

    @classmethod
    def read_all(cls, body: Mapping[str, Json], component: str) -> tuple[Self, ...]:
        """Make the jobs of a reply about one component."""
        return tuple(cls.read(job, component) for job in body["jobs"])

    @property
    def ended(self) -> bool:
        """Whether the job is done, failed or cancelled."""
        return self.status in ENDED

    @property
    def progress(self) -> float:
        """Fraction of the solve that is done, 0 to 1."""
        if self.status == "done":
            return 1.0
        return float((self.raw.get("progress") or {}).get("fraction", 0.0))

    @property
    def failure(self) -> str:
        """The cause of a failure and its remedy; empty unless the job failed."""
        error = self.raw.get("error") or {}
        parts = (error.get("kind"), error.get("message"), error.get("remedy"))
        return ". ".join(str(part).rstrip(".") for part in parts if part)

    @property
    def vector(self) -> Vector | None:
        """The displacement of a done job, shape (6,), or six an interface, m and rad."""
        parts = list(self.raw.get("displacements", {}).values()) or [self.raw]
        vectors = [joined(part.get("translation"), part.get("rotation")) for part in parts]
        known = [vector for vector in vectors if vector is not None]
        return np.concatenate(known) if known else None


class Answer(Protocol):
    """A reply that may have a job, such as a `Displacement`."""

    @property
    def job(self) -> Job | None:
        """The job that solves the wrench, or None."""


class Round(Queued):
    """One round of filling a table: its ``jobs``, ``stage`` and ``reason``, see `Queued`."""

    jobs: tuple[Job, ...]


def joined(first: Any, second: Any) -> Vector | None:
    """Return translation and rotation as one vector, shape (6,), m and rad.

    None if either is None.
    """
    return None if first is None or second is None else np.concatenate([first, second])


class JobCalls(Connection):
    """Follow, cancel and retry jobs; fill tables."""

    def job(self, job: Job | int, wait_s: float | None = None) -> Job:
        """Return a job as it is now, or, with `wait_s`, once it has ended or the time is up.

        Raises
        ------
        ProblemError
            If there is no such job (404).
        """
        query = {"wait_s": wait_s or None}
        return Job.read(self.call_json("GET", _path(job), query=query, wait_s=wait_s))

    def wait(self, job: Job | int | Answer, timeout: float = 600.0) -> Job:
        """Wait until a job has ended, and return it: look at its `Job.status`.

        Parameters
        ----------
        job : Job, int or Displacement
            The job, its number, or an answer of `solve` or `displacement` that has a job.
        timeout : float
            Seconds to wait at most.

        Raises
        ------
        InvalidArgument
            If it is none of these, or an answer without a job.
        ServerTimeout
            If it has not ended by then; it goes on in the server.
        """
        path = _path(job)
        deadline = time.monotonic() + timeout
        while True:
            began = time.monotonic()
            poll_s = max(0.0, min(deadline - began, LONGEST_POLL_S))
            reply = self.call_json("GET", path, query={"wait_s": poll_s or None}, wait_s=poll_s)
            now = Job.read(reply)
            if now.ended:
                return now
            if time.monotonic() >= deadline:
                raise ServerTimeout(
                    f"job {now.id} of {now.component} is still {now.status} after {timeout:g} s "
                    f"and continues on the server; wait again: client.wait({now.id}, {timeout:g})"
                )
            if time.monotonic() - began < SHORTEST_POLL_S:
                time.sleep(SHORTEST_POLL_S)

    def jobs(
        self,
        component: str | None = None,
        status: str | None = None,
        limit: int | None = None,
        after: int | None = None,
    ) -> list[Job]:
        """Return the jobs, newest first, of one component or status if given.

        Parameters
        ----------
        component, status : str, optional
            Only these.
        limit : int, optional
            At most so many; 1000 if not given.
        after : int, optional
            Those after this job's number: the last one of the page before.
        """
        query = {"component": component, "status": status, "limit": limit, "after": after}
        return [Job.read(job) for job in self.call_json("GET", "/v1/jobs", query=query)["jobs"]]

    def cancel(self, job: Job | int) -> Job:
        """Cancel a job that has not ended, and return it."""
        return Job.read(self.call_json("DELETE", _path(job), repeatable=False))

    def cancel_jobs(self, component: str | None = None, status: str = "waiting") -> int:
        """Cancel all jobs of a status that has not ended, of one component if given.

        Parameters
        ----------
        component : str, optional
            Only this component's.
        status : {"waiting", "running"}
            Jobs that run are not cancelled if not given.

        Returns
        -------
        int
            How many were cancelled.

        Raises
        ------
        ProblemError
            If there is no such component (404), or jobs of that status have ended (422).
        """
        query = {"component": component, "status": status}
        return self.call_json("DELETE", "/v1/jobs", query=query, repeatable=False)["cancelled"]

    def retry(self, job: Job | int) -> Job:
        """Queue a failed or cancelled job again, and return it."""
        return Job.read(self.call_json("POST", f"{_path(job)}/retry", {}, repeatable=False))

    def fill(
        self,
        name: str,
        tolerance: Tolerance | None = None,
        budget: int | None = None,
        *,
        range: Mapping[str, Json] | None = None,  # noqa: A002 (the contract's word)
        outputs: Sequence[str] | None = None,
        for_joint: bool = False,
    ) -> Round:
        """Queue one round of the solves that lower a table's error most.

        Parameters
        ----------
        name : str
            The component.
        tolerance : mapping or pair, optional
            ``{"translation": m, "rotation": rad}`` to reach; the component's own otherwise.
        budget : int, optional
            Solves to queue at most.
        range : mapping, optional
            ``{"force": [[low, high], ...], "moment": [...]}``, three of each, N and N·m: the part
            of the load range that the table is needed for; all of it otherwise.
        outputs : sequence of str, optional
            Which of ux uy uz rx ry rz are needed; all otherwise.
        for_joint : bool
            Whether a joint will use the table: it is then also filled until the compliance is
            positive definite and the error of each load at most 5 % of half its range.

        Raises
        ------
        ProblemError
            If the component is a table only and cannot be solved (409), or `range` is not within
            its load range, or given with `for_joint` (422).
        """
        part = {"range": dict(range) if range else None, "outputs": outputs and list(outputs)}
        body = options(tolerance=tolerance, budget=budget, for_joint=for_joint or None, **part)
        reply = self.call_json("POST", component_path(name, "fill"), body, repeatable=False)
        return Round.read(reply, jobs=Job.read_all(reply, name))

    def fill_until(
        self,
        name: str,
        tolerance: Tolerance | None = None,
        budget: int = 100,
        *,
        round_size: int = ROUND,
        timeout: float = 3600.0,
        range: Mapping[str, Json] | None = None,  # noqa: A002 (the contract's word)
        outputs: Sequence[str] | None = None,
        for_joint: bool = False,
    ) -> Iterator[Round]:
        """Fill a table round by round, each designed with the results of the round before.

        Parameters
        ----------
        name, tolerance, range, outputs, for_joint
            As in `fill`.
        budget : int
            Solves to spend at most, over all rounds.
        round_size : int
            Solves of one round at most.
        timeout : float
            Seconds to wait for the jobs of one round.

        Yields
        ------
        Round
            Each round once its jobs have ended; the last one may be without jobs, with the reason.
            It ends when the tolerance is met, the budget is spent, or no job of a round was done.

        Raises
        ------
        ServerTimeout
            If a round does not end in time; its jobs go on in the server.
        """
        while budget > 0:
            size = min(round_size, budget)
            queued = self.fill(
                name, tolerance, size, range=range, outputs=outputs, for_joint=for_joint
            )
            deadline = time.monotonic() + timeout
            ended = ()
            for job in queued.jobs:
                ended += (self.wait(job, deadline - time.monotonic()),)
            yield replace(queued, jobs=ended)
            budget -= len(ended)
            if not any(job.status == "done" for job in ended):
                return


def _path(job: Job | int | Answer) -> str:
    """Return the path of a job, given as a Job, its number, or an answer that has a job."""
    number: Any = job if isinstance(job, Job) else getattr(job, "job", job)
    if number is None:
        raise InvalidArgument(
            "this answer has no job to wait for: it is complete, or no solve was queued. Read "
            "its attribute reason"
        )
    try:
        return f"/v1/jobs/{number.id if isinstance(number, Job) else int(number)}"
    except (TypeError, ValueError):
        raise InvalidArgument(
            f"job must be a Job, the number of a job, or an answer that has a job, not {job!r}"
        ) from None
