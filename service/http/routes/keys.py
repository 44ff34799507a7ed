"""Keys over HTTP, for callers with the scope admin: list, add, rotate, revoke."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Request
from pydantic import AfterValidator, Field
from starlette.responses import Response

from wrenchbook.service.actors import ANY
from wrenchbook.service.http.bodies import Body
from wrenchbook.service.http.body import JsonRoute
from wrenchbook.service.http.openapi import answers, refused
from wrenchbook.service.http.problems import HttpProblemError
from wrenchbook.service.http.routes import Opened, json_reply
from wrenchbook.service.keys import (
    MAX_MEGABYTES,
    MAX_PATTERNS,
    MEGABYTES,
    NAME,
    OVERLAP_HOURS,
    RATE,
    Keyring,
    Scope,
    checked_name,
)
from wrenchbook.service.ledger import noted

router = APIRouter(
    prefix="/v1/keys",
    tags=["keys"],
    responses=refused(s409="the server has no keys, as many as there can be, or one of this name"),
    route_class=JsonRoute,
)


class KeyBody(Body):
    """A new key."""

    name: Annotated[
        str, AfterValidator(checked_name), Field(json_schema_extra={"pattern": f"^{NAME.pattern}$"})
    ]
    scope: Scope = "write"
    rate: Annotated[float, Field(strict=True, gt=0, lt=1000000000.0)] = RATE
    megabytes: Annotated[int, Field(strict=True, gt=0, le=MAX_MEGABYTES)] = MEGABYTES
    components: Annotated[tuple[str, ...], Field(max_length=MAX_PATTERNS)] = ANY
    expires: Annotated[float, Field(strict=True)] | None = None


class RotateBody(Body):
    """Validity of the old secret."""

    overlap_hours: Annotated[float, Field(strict=True, ge=0, le=8760)] = OVERLAP_HOURS


@router.get("")
def list_keys(request: Request) -> dict[str, Any]:
    """List keys without their secrets; needs an admin key."""
    return {"keys": _keyring(request).public()}


@router.post(
    "",
    status_code=201,
    responses=answers(dict[str, Any], "name, scope, and the secret as `key`", 201) | refused(422),
)
def add_key(request: Request, workspace: Opened, body: KeyBody) -> Response:
    """Create a key; the reply has the only copy of its secret."""
    keyring = _keyring(request)
    fields = body.model_dump()
    with noted(workspace.ledger, "key.add", body.name, after=fields):
        secret = keyring.add(**fields)
    return json_reply({"name": body.name, "scope": body.scope, "key": secret}, 201)


@router.post(
    "/{name}/rotate",
    status_code=201,
    responses=answers(dict[str, Any], "name, and the new secret as `key`", 201) | refused(404, 422),
)
def rotate_key(name: str, request: Request, workspace: Opened, body: RotateBody) -> Response:
    """Replace the secret of a key; the reply has the only copy."""
    keyring = _keyring(request)
    after = body.model_dump()
    with noted(workspace.ledger, "key.rotate", name, after=after):
        secret = keyring.rotate(name, 3600.0 * body.overlap_hours)
    return json_reply({"name": name, "key": secret, **after}, 201)


@router.delete("/{name}", responses=refused(404, 409, 422))
def revoke_key(name: str, request: Request, workspace: Opened) -> dict[str, Any]:
    """Revoke a key."""
    keyring = _keyring(request)
    may_be_last = request.app.state.access.always_needs_keys
    with noted(workspace.ledger, "key.revoke", name):
        keyring.revoke(name, may_be_last=may_be_last)
    return {"revoked": name}


def _keyring(request: Request) -> Keyring:
    """Return the server's keys; 409 while it has none: a first key would lock all others out."""
    access = request.app.state.access
    if not access.keys_needed:
        why = (
            "Every user of this machine may call it. Create the first key on this machine with: "
            "wrenchbook keys add NAME --scope admin --data FOLDER (the server's data "
            "directory); from then on every call needs a key."
        )
        raise HttpProblemError(409, "no-keys", "This server has no keys", why)
    return access.keyring
