"""What the solver of a job printed: the end of it, for whoever asks why a solve failed."""

from __future__ import annotations

import pathlib
import sys

from fastapi import APIRouter, Request
from starlette.responses import PlainTextResponse, Response

from service.http.openapi import refused
from service.http.problems import ProblemError
from service.http.routes.jobs import JobId
from service.jobs.attempt import LOG
from service.workspace import Workspace

router = APIRouter(prefix="/v1/jobs", tags=["jobs"], responses=refused(404, 422))

# The end, where the reason stands; all of it is in the attempt's files.
MOST_LOG_BYTES = 64 * 1024
CODE = pathlib.Path(__file__).parents[3]


@router.get(
    "/{job_id}/log",
    summary="What the last attempt printed, its end",
    response_class=PlainTextResponse,
    response_description="its end",
)
def attempt_log(job_id: JobId, request: Request) -> Response:
    workspace: Workspace = request.app.state.workspace
    job = workspace.ledger.job(job_id)
    path = workspace.attempt_folder(job) / LOG
    if path.is_symlink() or not path.is_file():  # a deck's command may have put a link there
        why = f"Job {job.id} is {job.status}, and its last attempt has left no log here."
        raise ProblemError(404, "no-files", "No log", why)
    with path.open("rb") as log:
        size = log.seek(0, 2)
        log.seek(max(0, size - MOST_LOG_BYTES))
        end = log.read(MOST_LOG_BYTES).decode(errors="replace")
    told = without_places(end, workspace.settings.folder)
    if size > MOST_LOG_BYTES:
        told = f"[the first {size - MOST_LOG_BYTES} bytes are in .../files]\n{told}"
    return Response(told, 200, None, "text/plain")


def without_places(text: str, data: pathlib.Path) -> str:
    """Return a text without the folders of this machine: who reads it may not be on it."""
    known = {
        str(data.absolute()): "<data>",
        str(CODE): "<wrenchbook>",
        sys.prefix: "<python>",
        sys.base_prefix: "<python>",
    }
    for place in sorted(known, key=len, reverse=True):
        text = text.replace(place, known[place])
    return text
