"""Keys over HTTP, for whoever has one for admin: list, add, revoke."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from fastapi import APIRouter, Request
from pydantic import Field
from starlette.responses import Response

from wrenchbook.service.http.bodies import Body
from wrenchbook.service.http.body import JsonRoute
from wrenchbook.service.http.openapi import answers, refused
from wrenchbook.service.http.problems import HttpProblemError, bad_body
from wrenchbook.service.http.routes import json_reply
from wrenchbook.service.keys import MEGABYTES, RATE, Keyring, KeysError

router = APIRouter(
    prefix="/v1/keys",
    tags=["keys"],
    responses=refused(s409="this server has no keys"),
    route_class=JsonRoute,
)


class KeyBody(Body):
    """A new key."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.@-]{0,63}$")]
    scope: Literal["read", "write", "admin"] = "write"
    rate: Annotated[float, Field(gt=0, lt=1e9, description="most requests a second")] = RATE
    megabytes: Annotated[
        int, Field(strict=True, gt=0, lt=2**20, description="largest body, MiB")
    ] = MEGABYTES


@router.get("", summary="The keys there are, without their secrets; needs a key for admin")
def list_keys(request: Request) -> dict[str, Any]:
    return {"keys": [key.public() for key in _keyring(request).listed()]}


@router.post(
    "",
    status_code=201,
    summary="Make a key; its secret is sent this once",
    responses=answers(dict[str, Any], "the new key; `key` is its secret, sent this once", 201)
    | refused(422),
)
def add_key(request: Request, body: KeyBody) -> Response:
    try:
        secret = _keyring(request).add(
            body.name, body.scope, rate=body.rate, megabytes=body.megabytes
        )
    except KeysError as error:
        raise bad_body([{"loc": "name", "msg": str(error)}]) from None
    return json_reply({"name": body.name, "scope": body.scope, "key": secret}, 201)


@router.delete("/{name}", summary="Revoke a key", responses=refused(404, 422))
def revoke_key(name: str, request: Request) -> dict[str, Any]:
    keyring = _keyring(request)
    try:
        keyring.revoke(name)
    except KeysError as error:
        raise HttpProblemError(404, "unknown-key", "No such key", str(error)) from None
    return {"revoked": name}


def _keyring(request: Request) -> Keyring:
    """Return the server's keys; 409 while it needs none: a caller would lock all others out."""
    access = request.app.state.access
    if not access.keys_needed:
        raise HttpProblemError(
            409,
            "no-keys",
            "This server has no keys",
            "Every user of this machine may call it. Make the first key on the machine itself: "
            "wrenchbook keys add NAME --scope admin; from then on every call needs one.",
        )
    return access.keyring
