"""Jobs and filling: what the server does in the background."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from .connection import Connection
from .errors import ServerTimeout
from .job import Job, Round
from .questions import component_path
from .wrenches import options

LONGEST_POLL_S = 20.0
ROUND = 24


class JobCalls(Connection):
    """Follow, cancel and retry jobs; fill tables."""

    def job(self, job: Job | int, wait_s: float | None = None) -> Job:
        """Return a job as it is now, or, with `wait_s`, once it has ended or the time is up.

        Raises
        ------
        ProblemError
            If there is no such job (404).
        """
        query = {"wait_s": wait_s} if wait_s else None
        return Job.read(self.call_json("GET", _path(job), query=query, wait_s=wait_s))

    def wait(self, job: Job | int, timeout: float = 600.0) -> Job:
        """Wait until a job has ended, and return it: look at its `Job.status`.

        Parameters
        ----------
        job : Job or int
            The job, or its number.
        timeout : float
            Seconds to wait at most.

        Raises
        ------
        ServerTimeout
            If it has not ended by then; it goes on in the server.
        """
        deadline = time.monotonic() + timeout
        while True:
            left = deadline - time.monotonic()
            asked = time.monotonic()
            now = self.job(job, wait_s=max(0.0, min(left, LONGEST_POLL_S)))
            if now.ended:
                return now
            if time.monotonic() >= deadline:
                raise ServerTimeout(
                    f"job {now.id} is still {now.status} after {timeout:g} s; it goes on in the "
                    "server"
                )
            # A server that answers at once instead of holding the call must not be hammered.
            if time.monotonic() - asked < 0.05:
                time.sleep(0.05)

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
            At most so many; 1000 unless told.
        after : int, optional
            Those after this job's number: the last one of the page before.
        """
        query = {"component": component, "status": status, "limit": limit, "after": after}
        return [Job.read(one) for one in self.call_json("GET", "/v1/jobs", query=query)["jobs"]]

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
            Waiting jobs unless told: what runs is let finish.

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
        tolerance: Any = None,
        budget: int | None = None,
        *,
        range: Mapping[str, Any] | None = None,  # noqa: A002 (the contract's word)
        outputs: Sequence[str] | None = None,
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
            of the load range that the table is wanted for; all of it otherwise.
        outputs : sequence of str, optional
            Which of ux uy uz rx ry rz are wanted; all otherwise.

        Raises
        ------
        ProblemError
            If the component is a table only and cannot be solved (409), or `range` is not within
            its load range (422).
        """
        wanted = {"range": dict(range) if range else None, "outputs": outputs and list(outputs)}
        body = options(tolerance=tolerance, budget=budget, **wanted)
        reply = self.call_json("POST", component_path(name, "fill"), body, repeatable=False)
        return Round.read(reply)

    def fill_until(
        self,
        name: str,
        tolerance: Any = None,
        budget: int = 100,
        *,
        round_size: int = ROUND,
        timeout: float = 3600.0,
        range: Mapping[str, Any] | None = None,  # noqa: A002 (the contract's word)
        outputs: Sequence[str] | None = None,
    ) -> Iterator[Round]:
        """Fill a table round by round, each designed on what the one before has found.

        Parameters
        ----------
        name, tolerance, range, outputs
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
            count = min(round_size, budget)
            order = self.fill(name, tolerance, count, range=range, outputs=outputs)
            deadline = time.monotonic() + timeout
            ended = tuple(self.wait(job, deadline - time.monotonic()) for job in order.jobs)
            yield Round(ended, order.stage, order.reason)
            budget -= len(ended)
            if not any(job.status == "done" for job in ended):
                return


def _path(job: Job | int) -> str:
    return f"/v1/jobs/{job.id if isinstance(job, Job) else int(job)}"
