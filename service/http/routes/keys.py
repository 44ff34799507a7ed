"""Keys over HTTP, for whoever has one for admin: list, add, revoke."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from fastapi import APIRouter, Request
from pydantic import Field
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response

from wrenchbook.service.http.bodies import Body
from wrenchbook.service.http.body import read_limited
from wrenchbook.service.http.openapi import answers, refused, takes
from wrenchbook.service.http.parsing import read_body
from wrenchbook.service.http.problems import HttpProblemError, bad_body
from wrenchbook.service.http.replies import json_reply
from wrenchbook.service.keys import MEGABYTES, RATE, Keyring, KeysError

router = APIRouter(
    prefix="/v1/keys", tags=["keys"], responses=refused(s409="this server has no keys")
)


class KeyBody(Body):
    """A key to be made."""

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
    responses=answers(dict[str, Any], "made; `key` is its secret, sent this once", 201)
    | refused(422),
    openapi_extra=takes(KeyBody),
)
async def add_key(request: Request) -> Response:
    keyring = _keyring(request)
    body: KeyBody = read_body(KeyBody, await read_limited(request.receive))
    secret = await run_in_threadpool(_added, keyring, body)
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
    """Return the server's keys.

    Raises
    ------
    HttpProblemError
        409, while it needs none: whoever could ask would lock all others out.
    """
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


def _added(keyring: Keyring, body: KeyBody) -> str:
    try:
        return keyring.add(body.name, body.scope, rate=body.rate, megabytes=body.megabytes)
    except KeysError as error:
        raise bad_body([{"loc": "name", "msg": str(error)}]) from None
