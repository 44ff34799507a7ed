"""What becomes of jobs, in the log, each line with the job's number for those who filter."""

import logging
from collections.abc import Iterable

from wrenchbook.service.ledger.records import Job

_log = logging.getLogger(__name__)

_LOUD = {"done": logging.INFO, "failed": logging.WARNING, "cancelled": logging.INFO}


def log_jobs(touched: Iterable[Job]) -> None:
    """Tell how jobs stand after a commit; those that wait or run only to whoever debugs."""
    if not _log.isEnabledFor(logging.WARNING):
        return
    for job in touched:
        level = _LOUD.get(job.status, logging.DEBUG)
        if _log.isEnabledFor(level):
            about = {"job": job.id, "attempt": job.attempt, "component": job.component}
            _log.log(level, "job %d of %s: %s", job.id, job.component, _words(job), extra=about)


def _words(job: Job) -> str:
    took = "" if job.seconds is None else f" after {job.seconds:.2f} s"
    if job.status == "done":
        return f"done{took}, row {job.row}"
    if job.error is not None:
        return f"failed{took}, {job.error.get('kind')}: {job.error.get('message')}"
    return f"{job.status}, attempt {job.attempt}" if job.attempt else job.status
