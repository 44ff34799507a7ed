"""Every error as ``application/problem+json`` (RFC 9457), with its remedy."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from itertools import islice
from math import ceil
from typing import Any

import orjson
from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from pydantic import ValidationError
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect
from starlette.responses import Response
from starlette.routing import Match

from wrenchbook.fea.bundle.read import BundleError
from wrenchbook.service import keys, ledger
from wrenchbook.service.actors import NotPermittedError
from wrenchbook.service.events import ListenerQuotaError, TooManyListenersError
from wrenchbook.service.fields.deformed import NoFieldsError, TooFarError
from wrenchbook.service.files.durable import NO_ROOM
from wrenchbook.service.files.redact import redact_values
from wrenchbook.service.formats.rig import RigError
from wrenchbook.service.formats.units import UnitError
from wrenchbook.service.formats.xlsx import SheetFullError
from wrenchbook.service.http.bodies import FORMS
from wrenchbook.service.jobs.waiting import TooManyPollsError
from wrenchbook.service.library import component
from wrenchbook.service.library.rigs import ShippedRigError, UnknownRigError
from wrenchbook.service.mistakes import mistake_of
from wrenchbook.service.ops.logs import REQUEST_ID
from wrenchbook.service.query import (
    BeyondRangeError,
    NotCoveredError,
    RefusedError,
    SolveFailedError,
)
from wrenchbook.service.sandbox import SandboxBusyError, SandboxError
from wrenchbook.service.submission import NoSetupError
from wrenchbook.service.tables.mapped import TableBehindError
from wrenchbook.surrogate.answer import UnknownMethodError

MEDIA_TYPE = "application/problem+json"
# Status as nginx counts it: the caller disconnected before its request was complete.
CLIENT_GONE = 499
METHODS = ("GET", "HEAD", "POST", "PUT", "PATCH", "DELETE")
MAX_ERRORS = 1000
MAX_TEXT = 1000  # characters of a message: longer ones are cut
REPEATED = "is there more than once; send one"
MAX_PLACE = 200  # characters of a path or a key, which a caller may send at any length
# Status, kind and title of each error, by package; a subclass that is not listed has those of its
# base.
_NAMED: dict[type[Exception], tuple[int, str, str]] = {
    # Components, and the rest of the library.
    component.UnknownComponentError: (404, "unknown-component", "No such component"),
    component.ComponentExistsError: (409, "component-exists", "The name is taken"),
    component.OneWrenchError: (409, "one-wrench", "The call takes one wrench alone"),
    component.LibraryUnavailableError: (507, "disk", "The component cannot be written"),
    NoSetupError: (409, "no-fea-setup", "The component has no finite-element setup"),
    UnknownRigError: (404, "unknown-rig", "No such rig"),
    ShippedRigError: (409, "shipped", "The rig cannot be removed"),
    RigError: (422, "rig", "The rig is not accepted"),
    # Queries and tables.
    UnknownMethodError: (422, "method", "Not a method of this table"),
    NotCoveredError: (409, "not-covered", "The table does not cover this"),
    BeyondRangeError: (409, "beyond-range", "Outside the component's load range"),
    SolveFailedError: (424, "solve-failed", "The solve failed"),
    TableBehindError: (503, "table-behind", "The table is older than the ledger"),
    NoFieldsError: (409, "no-surface", "No deformed surface can be shown"),
    TooFarError: (409, "beyond-range", "Outside the component's load range"),
    # Files of rows.
    UnitError: (422, "unit", "Not a unit this export can use"),
    SheetFullError: (409, "export", "This export cannot be made"),
    SandboxError: (422, "too-costly", "The file cannot be read"),
    SandboxBusyError: (503, "busy", "Too many files are being read"),
    # The ledger.
    ledger.UnknownJobError: (404, "unknown-job", "No such job"),
    ledger.UnknownVersionError: (404, "unknown-version", "No such version of the table"),
    ledger.UnknownRowError: (404, "unknown-row", "No such row"),
    ledger.UnknownImportError: (404, "unknown-import", "No such finished import or finding"),
    ledger.AppendError: (409, "append", "Rows cannot be appended to this import"),
    ledger.BlockKeyError: (409, "block-key", "The block's number cannot be used"),
    ledger.InvalidTransitionError: (409, "job-status", "The job's status does not allow this"),
    ledger.RowStatusError: (409, "row-status", "The row's state does not allow this"),
    ledger.QuotaError: (429, "quota", "The quota is used up"),
    ledger.DamagedRowError: (500, "damaged-row", "A row is damaged on the disk"),
    ledger.ImportRunningError: (503, "importing", "Another table is being imported"),
    ledger.ReadOnlyError: (403, "read-only", "This server takes no writes"),
    ledger.LedgerFullError: (507, "disk", "The disk is full; nothing was accepted"),
    ledger.LedgerBusyError: (503, "ledger", "The ledger is busy"),
    ledger.LedgerUnavailableError: (503, "ledger", "The ledger cannot be used"),
    # Callers and keys.
    NotPermittedError: (403, "not-permitted", "The caller may not do this"),
    TooManyPollsError: (503, "busy", "Too many callers wait for jobs"),
    ListenerQuotaError: (429, "listeners", "The key has too many listeners"),
    TooManyListenersError: (503, "too-many-listeners", "Too many listeners"),
    keys.KeyExistsError: (409, "key-exists", "The name is taken"),
    keys.UnknownKeyError: (404, "unknown-key", "No valid key has this name"),
    keys.KeysBusyError: (503, "busy", "The keys are being changed"),
    keys.LastKeyError: (409, "last-key", "The last key cannot be revoked"),
    keys.KeysFullError: (409, "keys-full", "The server has as many keys as it can"),
    keys.KeysUnavailableError: (507, "disk", "The keys cannot be read or written"),
}
# The beginning of a message on several query parameters together: the parameter to correct.
_NAMED_PARAMETER = re.compile(r"([a-z_]+): ")
_TYPE_ROOT = "urn:wrenchbook:problem:"


class HttpProblemError(HTTPException):
    """A problem+json reply: its HTTP status, and `kind`, the end of its ``type``.

    `title` is the mistake in short, `detail` the exact mistake with its remedy. `extra` are further
    members, such as ``errors`` or ``job``.
    """

    def __init__(
        self,
        status: int,
        kind: str,
        title: str,
        detail: str,
        *,
        headers: Mapping[str, str] | None = None,
        **extra: Any,
    ) -> None:
        super().__init__(status, detail, headers)
        self.status = status
        members = {"type": _TYPE_ROOT + kind, "title": title, "status": status, "detail": detail}
        self.body = members | extra

    def __str__(self) -> str:
        return self.detail

    def response(self) -> Response:
        """Return the reply; a 5xx has its request id, as the server's log does."""
        body = self.body
        if self.status >= 500 and (request_id := REQUEST_ID.get()):
            body = {**body, "request_id": request_id}
        return Response(orjson.dumps(redact_values(body)), self.status, self.headers, MEDIA_TYPE)


def bad_body(errors: Sequence[dict[str, Any]]) -> HttpProblemError:
    """Describe a request that has not the call's form, by at most MAX_ERRORS ``{loc, msg}``."""
    first = f"{errors[0]['loc']}: {errors[0]['msg']}" if errors else "see the documentation"
    several = ""
    if len(errors) > 1:
        several = f"Nothing was changed. {len(errors)} mistakes; the first is "
    return HttpProblemError(
        422,
        "bad-request-body",
        "The request does not have the form of this call",
        f"{several}{first}.",
        errors=list(errors[:MAX_ERRORS]),
    )


def plain_errors(error: ValidationError | RequestValidationError) -> list[dict[str, str]]:
    """Turn pydantic's errors into ``{loc, msg}`` with a dotted location."""
    if isinstance(error, RequestValidationError):
        errors = error.errors()
    else:
        errors = error.errors(include_url=False)
    mistakes = []
    for mistake in islice(errors, MAX_ERRORS):
        path = mistake["loc"]
        part = str(*path[:1])
        if part in ("body", "query"):  # a parameter has the name that the caller has sent
            path = path[1:]
        path = [name for name in path if name not in FORMS]  # a span's form is no field
        loc = ".".join(map(str, path))[:MAX_PLACE] or part or "body"
        message = mistake_of(mistake)[:MAX_TEXT]
        if loc == "query" and (named := _NAMED_PARAMETER.match(message)):
            loc, message = named[1], message[named.end() :]
        mistakes.append({"loc": loc, "msg": message})
    return mistakes


def problem_of(error: Exception) -> HttpProblemError:
    """Return the problem of a named error of a package; raise any other error again."""
    if isinstance(error, HttpProblemError):
        return error
    if isinstance(error, ValidationError | RequestValidationError):
        return bad_body(plain_errors(error))
    if type(error) is keys.KeysError:  # an invalid value; its subclasses are other errors
        return bad_body([{"loc": "body", "msg": str(error)}])
    if isinstance(error, BundleError):
        errors = [{"loc": p.where, "msg": p.message} for p in error.problems[:MAX_ERRORS]]
        title = "The component bundle has mistakes"
        detail = f"Nothing was added. {error}"
        return HttpProblemError(422, "bad-bundle", title, detail, errors=errors)
    if isinstance(error, OSError) and error.errno in NO_ROOM:  # of a body's temporary file too
        where = "a file in the data directory or in TMPDIR cannot be written"
        detail = f"{error.strerror}: {where}; {NO_ROOM[error.errno]}, then send the request again."
        return HttpProblemError(507, "disk", "A file cannot be written", detail)
    kind = next((kind for kind in type(error).__mro__ if kind in _NAMED), None)
    if kind is None:
        raise error
    status, name, title = _NAMED[kind]
    if isinstance(error, SolveFailedError):
        title = f"{title}: {error.kind}"
    headers = None
    if isinstance(
        error, ledger.LedgerBusyError | ledger.QuotaError | TableBehindError | ListenerQuotaError
    ):
        headers = {"Retry-After": str(ceil(error.retry_s))}  # they pass by themselves
    facts = error.facts if isinstance(error, RefusedError) else {}
    return HttpProblemError(status, name, title, str(error), headers=headers, **facts)


def _methods_of(app: FastAPI, path: str) -> list[str]:
    """Return the methods that a path accepts; HEAD is answered as GET."""

    def is_accepted(method: str) -> bool:
        scope = {"type": "http", "path": path, "method": method.replace("HEAD", "GET")}
        return any(route.matches(scope)[0] is Match.FULL for route in app.routes)

    return [method for method in METHODS if is_accepted(method)]


def _answer(_: Request, error: Exception) -> Response:
    return problem_of(error).response()


def _answer_http(request: Request, error: Exception) -> Response:
    """Answer an error of the framework: a path or a method that no route has."""
    assert isinstance(error, HTTPException)
    call = f"{request.method} {request.url.path[:MAX_PLACE]}"
    headers = dict(error.headers or {})
    text = f"{call}: {error.detail}. See /openapi.json for all calls."
    if error.status_code == 404:
        text = f"There is no call {call}. Correct the path; /openapi.json has all calls."
        if request.url.path.startswith("/v1/v1/"):  # Client("http://host/v1")
            text = f"There is no call {call}. Leave /v1 out of the server's address; a client "
            text += "adds it to the address."
    elif error.status_code == 405:  # the error has the methods of one of the path's routes
        headers["Allow"] = ", ".join(_methods_of(request.app, request.scope["path"]))
        text = f"There is no call {call}. The path accepts {headers['Allow']}."
    title = str(error.detail)
    return HttpProblemError(
        error.status_code, "http", title, text, headers=headers or None
    ).response()


def _answer_crash(request: Request, _: Exception) -> Response:
    path = request.url.path[:MAX_PLACE]
    detail = f"{request.method} {path} failed because of a bug in the server (request "
    detail += f"{REQUEST_ID.get()}). Report it with the traceback, which the server's log has "
    detail += "under this number; its operator can read it."
    return HttpProblemError(500, "internal", "Internal server error", detail).response()


def install(app: FastAPI) -> None:
    """Make every error of ``app`` a problem reply."""
    bodies = BundleError, keys.KeysError, ValidationError, RequestValidationError
    for kind in (HttpProblemError, OSError, *bodies, *_NAMED):
        app.add_exception_handler(kind, _answer)
    app.add_exception_handler(HTTPException, _answer_http)
    app.add_exception_handler(ClientDisconnect, lambda *_: Response(status_code=CLIENT_GONE))
    app.add_exception_handler(Exception, _answer_crash)
