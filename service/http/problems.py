"""Every error as ``application/problem+json`` (RFC 9457), saying what to do about it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import orjson
from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from pydantic import ValidationError
from starlette.exceptions import HTTPException
from starlette.responses import Response

from fea.bundle.read import BundleError
from service.answering.refusals import BeyondRangeError, NotCoveredError, SolveFailedError
from service.http.links import job_link
from service.ledger import (
    DamagedRowError,
    InvalidTransitionError,
    LedgerUnavailableError,
    UnknownJobError,
    UnknownRowError,
)
from service.library.component import (
    ComponentExistsError,
    LibraryUnavailableError,
    UnknownComponentError,
)
from service.ordering import NoSetupError
from service.tables.live import TableBehindError

MEDIA_TYPE = "application/problem+json"
_NAMED: dict[type[Exception], tuple[int, str, str]] = {
    UnknownComponentError: (404, "unknown-component", "No such component"),
    ComponentExistsError: (409, "component-exists", "The name is taken"),
    LibraryUnavailableError: (507, "disk", "The component cannot be written; nothing was added"),
    TableBehindError: (503, "table-behind", "The table is older than the ledger"),
    DamagedRowError: (500, "damaged-row", "A row is damaged on the disk"),
    NoSetupError: (409, "no-fea-setup", "The component has no finite-element setup"),
    UnknownJobError: (404, "unknown-job", "No such job"),
    UnknownRowError: (404, "unknown-row", "No such row"),
    NotCoveredError: (409, "not-covered", "The table does not cover this"),
    BeyondRangeError: (409, "beyond-range", "Outside the component's load range"),
    InvalidTransitionError: (409, "job-status", "The job's status does not allow this"),
    LedgerUnavailableError: (503, "ledger", "The ledger cannot be written; nothing was accepted"),
}
_TYPE_ROOT = "urn:wrenchbook:problem:"


class ProblemError(Exception):
    """An error on its way to becoming a problem+json answer.

    Parameters
    ----------
    status:
        HTTP status.
    kind:
        Short slug; becomes ``type`` as ``urn:wrenchbook:problem:<kind>``.
    title, detail:
        What is wrong in a few words; what it is exactly and what to do.
    extra:
        Further members of the answer, such as ``errors`` or ``job``.
    """

    def __init__(self, status: int, kind: str, title: str, detail: str, **extra: Any) -> None:
        super().__init__(detail)
        self.status = status
        self.body = {
            "type": _TYPE_ROOT + kind,
            "title": title,
            "status": status,
            "detail": detail,
            **extra,
        }

    def response(self) -> Response:
        """Return the answer."""
        return Response(orjson.dumps(self.body), status_code=self.status, media_type=MEDIA_TYPE)


def bad_body(errors: Sequence[dict[str, Any]], detail: str | None = None) -> ProblemError:
    """Describe a body that is not of the call's form; ``errors`` are ``{loc, msg}``."""
    first = f"{errors[0]['loc']}: {errors[0]['msg']}" if errors else "see the documentation"
    return ProblemError(
        422,
        "bad-request-body",
        "The request is not of this call's form",
        detail or f"Nothing was changed. {len(errors)} mistake(s); the first is {first}.",
        errors=list(errors),
    )


def plain_errors(error: ValidationError | RequestValidationError) -> list[dict[str, str]]:
    """Turn pydantic's errors into ``{loc, msg}`` with a dotted location."""
    return [
        {"loc": ".".join(map(str, one["loc"])) or "body", "msg": one["msg"]}
        for one in error.errors()
    ]


def problem_of(error: Exception) -> ProblemError:
    """Map a room's named error to its answer; an unmapped one is raised again."""
    if isinstance(error, ProblemError):
        return error
    if isinstance(error, ValidationError | RequestValidationError):
        return bad_body(plain_errors(error))
    if isinstance(error, BundleError):
        errors = [{"loc": p.where, "msg": p.message} for p in error.problems]
        detail = f"Nothing was added. {error}"
        return ProblemError(
            422, "bad-bundle", "The component bundle has mistakes", detail, errors=errors
        )
    if isinstance(error, SolveFailedError):
        return ProblemError(
            424,
            "solve-failed",
            f"The solve failed: {error.kind}",
            str(error),
            job=job_link(error.job),
            **error.facts,
        )
    for kind, (status, slug, title) in _NAMED.items():
        if isinstance(error, kind):
            facts = getattr(error, "facts", {})
            return ProblemError(status, slug, title, str(error), **facts)
    raise error


def crash_of(method: str, path: str) -> ProblemError:
    """Return what a call answers that came to a mistake of ours."""
    detail = f"{method} {path} failed; the server's log has the traceback."
    return ProblemError(500, "internal", "The server made a mistake", detail)


def install(app: FastAPI) -> None:
    """Make every error of ``app`` answer as a problem."""

    def answer(_: Request, error: Exception) -> Response:
        return problem_of(error).response()

    def http_answer(request: Request, error: Exception) -> Response:
        assert isinstance(error, HTTPException)
        problem = ProblemError(
            error.status_code,
            "http",
            str(error.detail),
            f"{request.method} {request.url.path}: {error.detail}. The calls are in /openapi.json.",
        )
        response = problem.response()
        response.headers.update(error.headers or {})
        return response

    def crash(request: Request, _: Exception) -> Response:
        return crash_of(request.method, request.url.path).response()

    named = (BundleError, ValidationError, RequestValidationError, SolveFailedError, *_NAMED)
    for kind in (ProblemError, *named):
        app.add_exception_handler(kind, answer)
    app.add_exception_handler(HTTPException, http_answer)
    app.add_exception_handler(Exception, crash)
