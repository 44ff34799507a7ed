"""How the end of an attempt becomes the ledger's word on its job."""

import contextlib
import logging
from collections.abc import Callable
from pathlib import Path
from typing import Any

from wrenchbook.service.fields.store import FieldStore
from wrenchbook.service.jobs.attempt import (
    BadOutcomeError,
    Spec,
    read_outcome,
    solver_seconds,
    tidy,
)
from wrenchbook.service.ledger import JobRecord, Ledger
from wrenchbook.service.tables.solver_errors import SolverErrors

_log = logging.getLogger(__name__)


def spec_of(job: JobRecord, bundle: Path | str = "") -> Spec:
    """Return what the job's present attempt solves, with the component's files in `bundle`."""
    place = str(Path(bundle).absolute())
    return Spec(job.id, job.attempt, job.component, place, job.fingerprint, job.wrench)


def settle(
    ledger: Ledger,
    job: JobRecord,
    folder: Path,
    *,
    died: Callable[[int, int], JobRecord] | None = None,
    fields: FieldStore | None = None,
    errors: SolverErrors | None = None,
) -> None:
    """Record in the ledger how a job's attempt ended; safe to repeat.

    Parameters
    ----------
    ledger : Ledger
        Where the row or the reason goes.
    job : Job
        The job as it was when the attempt began.
    folder : path
        The attempt's folder; no solver works in it any more.
    died : callable, optional
        Ledger call for a solver that left no outcome; `Ledger.release` by default.
    fields : FieldStore, optional
        Where the deformed surface goes that the solver left.
    errors : SolverErrors, optional
        The same for the estimate of the solver's own error.

    Raises
    ------
    StaleAttemptError
        If the job has gone on without this attempt.
    """
    outcome = _outcome(job, folder)
    status = None if outcome is None else outcome.get("status")
    if errors is not None:  # before the row too: the table's version with the row then has it
        errors.settle(job.component, job.fingerprint, (outcome or {}).get("solver_error"))
    if outcome is None:
        (died or ledger.release)(job.id, job.attempt)
    elif status == "done":
        if fields is not None:  # without its row it does no harm, and is found by its wrench
            fields.take(folder, job.component, job.fingerprint, job.wrench)
        _commit(ledger, job, folder, outcome)
    elif status == "failed":
        ledger.fail(job.id, job.attempt, _error(outcome), solver_seconds(folder))
    else:
        ledger.release(job.id, job.attempt)


def _commit(ledger: Ledger, job: JobRecord, folder: Path, outcome: dict[str, Any]) -> None:
    try:
        ledger.commit(
            job.id,
            job.attempt,
            outcome["displacement"],
            compliance=outcome.get("compliance"),
            curvature=outcome.get("curvature"),
            origin=_origin(job, outcome),
            seconds=solver_seconds(folder),
        )
    except (ValueError, TypeError, KeyError) as error:
        ledger.fail(job.id, job.attempt, _bad_answer(error))
        return
    with contextlib.suppress(OSError):
        tidy(folder)


def _origin(job: JobRecord, outcome: dict[str, Any]) -> str:
    """Return the job of a row, with version and code digest of the program that solved it."""
    program = outcome.get("program")
    return f"job {job.id}, wrenchbook {program}" if isinstance(program, str) else f"job {job.id}"


def notes_of(job: JobRecord, folder: Path) -> list[str]:
    """Return the solver's notes on its answer from the attempt's folder; often none."""
    notes = (_outcome(job, folder) or {}).get("notes")
    return [str(note) for note in notes] if isinstance(notes, list) else []


def _outcome(job: JobRecord, folder: Path) -> dict[str, Any] | None:
    try:
        return read_outcome(folder, spec_of(job))
    except BadOutcomeError as error:
        _log.warning("taken for a lost attempt: %s", error)
        return None


def _error(outcome: dict[str, Any]) -> dict[str, str]:
    error = outcome.get("error")
    if isinstance(error, dict) and {"kind", "message", "remedy"} <= error.keys():
        return {name: str(error[name]) for name in ("kind", "message", "remedy")}
    return _bad_answer(ValueError(f"failed without a reason: {error!r}"))


def component_missing(job: JobRecord, error: Exception) -> dict[str, str]:
    """Return the error of a job whose component the library does not give."""
    return {
        "kind": "component_missing",
        "message": f"there is no component {job.component} to solve any more: {error}",
        "remedy": "add the component again and retry the job, or leave it",
    }


def _bad_answer(error: Exception) -> dict[str, str]:
    return {
        "kind": "bad_answer",
        "message": f"the solver's answer is not usable: {error!r}",
        "remedy": "see result.json and log.txt in the attempt's folder",
    }
