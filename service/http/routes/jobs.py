"""Routes of jobs: list, show or wait, cancel, retry, and the files and log of the last attempt."""

from __future__ import annotations

import pathlib
import sys
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Depends, Path, Query, Request
from pydantic import AfterValidator
from starlette.concurrency import run_in_threadpool
from starlette.responses import PlainTextResponse, Response, StreamingResponse

from wrenchbook.service.actors import ANY, CALLER
from wrenchbook.service.contract import NUMBER_LIMIT, OUTPUTS, by_part
from wrenchbook.service.files.redact import cut_paths, redact_values
from wrenchbook.service.http.openapi import BYTES, refused
from wrenchbook.service.http.problems import HttpProblemError
from wrenchbook.service.http.routes import Opened, WaitSeconds, attached, cut_page
from wrenchbook.service.jobs.attempt import LOG, pieces_of, read_progress, zipped
from wrenchbook.service.jobs.waiting import why_waiting
from wrenchbook.service.ledger import JobRecord, LedgerRow, Status, UnknownJobError
from wrenchbook.service.query import job_link
from wrenchbook.service.tables.rows import iso_time
from wrenchbook.service.workspace import Workspace
from wrenchbook.surrogate.table.space import DEFAULT

MAX_LOG_BYTES = 64 * 1024  # of the end of a log, which has the cause of a failure
PROGRAM = pathlib.Path(__file__).parents[3]


async def _check_access(request: Request, workspace: Opened) -> None:
    """Raise UnknownJobError for a job that the key may not use or that does not exist."""
    caller = CALLER.get()
    job_id = request.path_params.get("job_id", "")
    if caller.components == ANY or not job_id:
        return
    # Checked before FastAPI has parsed the number. Both refusals are the same text, so that a key
    # cannot learn which other jobs exist.
    if job_id.isdecimal() and len(job_id) < len(str(NUMBER_LIMIT)):
        with suppress(UnknownJobError):
            job = await run_in_threadpool(workspace.ledger.job, int(job_id))
            if caller.may_use(job.component):
                return
    raise UnknownJobError("the key does not allow this job; list its jobs with GET /v1/jobs")


router = APIRouter(
    prefix="/v1/jobs",
    tags=["jobs"],
    responses=refused(404, 422),
    dependencies=[Depends(_check_access)],
)


def _check_id(job_id: int) -> int:
    """Raise UnknownJobError for a number that the ledger cannot have."""
    if job_id >= NUMBER_LIMIT:
        raise UnknownJobError(f"there is no job {str(job_id)[:30]}; list all with GET /v1/jobs")
    return job_id


JobId = Annotated[int, Path(ge=1), AfterValidator(_check_id)]


def job_body(
    workspace: Workspace, job: JobRecord, rows: Mapping[int, LedgerRow] | None = None
) -> dict[str, Any]:
    """Return the fields of a job, with its progress while it runs and its displacement when done.

    `rows`: the rows of a list of jobs by row number; None to read the row of this job.
    """
    component = workspace.library.get(job.component)
    space = component.space if component is not None else DEFAULT
    if len(space.inputs) != len(job.wrench):  # its component is deleted, or has other inputs now
        space = None
    body: dict[str, Any] = {
        **job_link(job),
        "component": job.component,
        "actor": job.actor or None,
        **(space.by_name(job.wrench) if space else {"wrench": job.wrench}),
        "priority": job.priority,
        "attempt": job.attempt,
        "not_before": _time(job.not_before),
        "created": _time(job.created),
        "started": _time(job.started),
        "finished": _time(job.finished),
        "seconds": job.seconds,
        "error": redact_values(job.error),
    }
    if job.status == "running":
        progress = read_progress(workspace.attempt_folder(job))
        body["progress"] = asdict(progress) if progress else None
    if job.status == "done" and job.row is not None:
        body["row"] = job.row
        row = workspace.ledger.row(job.row) if rows is None else rows.get(job.row)
        if row is not None:  # GET /health/ready reports a damaged row
            parts = by_part(row.displacement, space.several if space else ())
            if space and space.several:
                parts = {"displacements": parts}
            elif len(row.displacement) != len(OUTPUTS):  # of interfaces whose names are unknown
                parts = {"displacement": row.displacement}
            body |= parts
    return body


@router.get("")
def list_jobs(
    workspace: Opened,
    response: Response,
    component: str | None = None,
    status: Status | None = None,
    actor: Annotated[str | None, Query(max_length=200)] = None,
    limit: Annotated[int, Query(ge=1, le=100_000)] = 1000,
    after: Annotated[int | None, Query(ge=1, lt=NUMBER_LIMIT)] = None,
) -> dict[str, Any]:
    """List jobs, newest first, in pages."""
    _check_known(workspace, component)
    jobs = workspace.ledger.jobs(component, status, limit + 1, below=after, actor=actor)
    query = {"component": component, "status": status, "actor": actor, "limit": limit}
    next_url = cut_page(response, "/v1/jobs", query, jobs)
    rows = workspace.ledger.rows_of([job.row for job in jobs if job.row is not None])
    return {"jobs": [job_body(workspace, job, rows) for job in jobs], "next": next_url}


@router.get("/{job_id}")
async def get_job(job_id: JobId, workspace: Opened, wait_s: WaitSeconds = 0.0) -> dict[str, Any]:
    """Show a job, or wait for its end."""
    (job,) = await workspace.polls.wait_all([job_id], wait_s)

    def body() -> dict[str, Any]:
        """Return the job's fields with those that lists omit: its notes, and why it waits."""
        waiting = None
        if job.status == "waiting":
            trouble = workspace.tables.trouble()
            waiting = why_waiting(workspace.ledger, job, workspace.settings.solvers, trouble)
        return job_body(workspace, job) | {
            "notes": redact_values(workspace.notes(job)),
            "waiting": redact_values(asdict(waiting)) if waiting else None,
        }

    return await run_in_threadpool(body)


@router.delete(
    "",
    responses={
        200: {"model": dict[Literal["cancelled"], int], "description": "number of cancelled jobs"}
    },
)
def cancel_jobs(
    workspace: Opened,
    component: str | None = None,
    status: Literal["waiting", "running"] = "waiting",
) -> dict[str, Any]:
    """Cancel all waiting or running jobs of the caller."""
    _check_known(workspace, component)
    return {"cancelled": workspace.ledger.cancel_many(component, status)}


@router.delete("/{job_id}", responses=refused(409))
def cancel_job(job_id: JobId, workspace: Opened) -> dict[str, Any]:
    """Cancel a job of the caller; with an admin key, any job."""
    return job_body(workspace, workspace.ledger.cancel(job_id))


@router.post("/{job_id}/retry", responses=refused(409, 429))
def retry_job(job_id: JobId, workspace: Opened) -> dict[str, Any]:
    """Queue a failed or cancelled job again."""
    return job_body(workspace, workspace.ledger.retry(job_id, workspace.quota))


@router.get(
    "/{job_id}/files",
    response_class=Response,
    responses={200: {"description": "the attempt's folder", "content": {"application/zip": BYTES}}},
)
def get_job_files(job_id: JobId, workspace: Opened) -> Response:
    """Download the files of the last attempt as a zip."""
    folder = _attempt_files(workspace, workspace.ledger.job(job_id))
    headers = attached(f"job-{job_id}.zip")
    return StreamingResponse(pieces_of(zipped(folder)), 200, headers, "application/zip")


@router.get("/{job_id}/log", response_class=PlainTextResponse)
def get_job_log(job_id: JobId, workspace: Opened) -> Response:
    """Show the end of the last attempt's log."""
    job = workspace.ledger.job(job_id)
    path = _attempt_files(workspace, job) / LOG
    if path.is_symlink() or not path.is_file():  # a deck's command may have made a link there
        raise HttpProblemError(
            404,
            "no-files",
            "No log",
            f"Attempt {job.attempt} of job {job.id}, which is {job.status}, has no log.txt. Read "
            f"its other files: GET /v1/jobs/{job.id}/files.",
        )
    with path.open("rb") as log:
        size = log.seek(0, 2)
        log.seek(max(0, size - MAX_LOG_BYTES))
        end = log.read(MAX_LOG_BYTES).decode(errors="replace")
    names = {  # in place of folders of this machine
        str(workspace.settings.data.absolute()): "<data>",
        str(PROGRAM): "<wrenchbook>",
        sys.prefix: "<python>",
        sys.base_prefix: "<python>",
    }
    for folder in sorted(names, key=len, reverse=True):  # one may be inside another
        end = end.replace(folder, names[folder])
    shown = cut_paths(end)
    if size > MAX_LOG_BYTES:
        shown = f"[the first {size - MAX_LOG_BYTES} bytes are in .../files]\n{shown}"
    return Response(shown, 200, None, "text/plain")


def _attempt_files(workspace: Workspace, job: JobRecord) -> pathlib.Path:
    """Return the folder of a job's last attempt; 404 with the reason if there is none."""
    folder = workspace.attempt_folder(job)
    if folder.is_dir():
        return folder
    state = f"Job {job.id} is {job.status}"
    retry = f"To have files, retry it: POST /v1/jobs/{job.id}/retry."
    title = "No files yet"
    if not job.is_final:
        detail = f"{state}, and no solver has begun it; ask again later."
    elif not job.attempt:
        detail = f"{state}, and no solver began it. {retry}"
    else:
        title = "The files are gone"
        detail = (
            f"{state}, but its folder jobs/{folder.parent.name}/{folder.name} was pruned "
            "(--keep-days), deleted or not copied. "
            + ("Its row needs no files." if job.status == "done" else retry)
        )
    raise HttpProblemError(404, "no-files", title, detail)


def _check_known(workspace: Workspace, component: str | None) -> None:
    """Raise UnknownComponentError, as an empty list of jobs would hide a wrong name."""
    if component is not None:
        _ = workspace.library[component]


def _time(seconds: float | None) -> str | None:
    """Return seconds since the epoch as ISO 8601 in UTC."""
    return None if seconds is None else iso_time(seconds, "milliseconds")
