"""Profiles of test rigs by name: columns, frame, zero and cycles of its files, as TOML texts."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Path, Request
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response

from wrenchbook.service.formats.rig import MAX_RIG, NAME
from wrenchbook.service.http.body import read_limited
from wrenchbook.service.http.imports import check_meanings, profile_of
from wrenchbook.service.http.openapi import BYTES, TEXT, refused
from wrenchbook.service.http.problems import bad_body
from wrenchbook.service.http.routes import Opened
from wrenchbook.service.library.rigs import profiles, remove_rig, rig_of, store_rig

_UTF8 = 4  # largest number of bytes of a character
router = APIRouter(prefix="/v1/rigs", tags=["rigs"], responses=refused(404, 422))

RigName = Annotated[str, Path(pattern=f"^{NAME.pattern}$")]
_TOML = {"application/toml": TEXT}
_SENT = {"requestBody": {"required": True, "content": {"application/octet-stream": BYTES, **_TOML}}}
_READ: Any = {200: {"description": "the stored profile, or else the program's", "content": _TOML}}


@router.get("")
def list_rigs(workspace: Opened) -> dict[str, list[dict[str, str]]]:
    """List rig profiles."""
    rigs = []
    for name, (text, origin) in profiles(workspace.ledger).items():
        comment = text.partition("\n")[0].partition("#")[2]  # comment of the first line
        rigs.append({"name": name, "origin": origin, "title": comment.strip()})
    return {"rigs": rigs}


@router.get("/{name}", response_class=Response, responses=_READ)
def get_rig(name: RigName, workspace: Opened) -> Response:
    """Show a rig profile."""
    return Response(rig_of(workspace.ledger, name), 200, None, "application/toml; charset=utf-8")


@router.put("/{name}", openapi_extra=_SENT)
async def put_rig(name: RigName, request: Request, workspace: Opened) -> dict[str, str]:
    """Store or replace a rig profile."""
    content = await read_limited(request.receive, _UTF8 * MAX_RIG)
    text = content.decode("utf-8-sig", "replace")
    message = ""
    if "\ufffd" in text:
        line = text.partition("\ufffd")[0].count("\n") + 1
        message = f"must be UTF-8 text, but line {line} is not; save it as UTF-8"
    if len(text) > MAX_RIG:
        message = f"has {len(text)} characters, at most {MAX_RIG} are stored; shorten it"
    if message:
        raise bad_body([{"loc": "body", "msg": message}])
    check_meanings(profile_of(text))  # raises if the text is no profile
    await run_in_threadpool(store_rig, workspace.ledger, name, text)
    return {"stored": name}


@router.delete("/{name}", responses=refused(409))
def delete_rig(name: RigName, workspace: Opened) -> dict[str, str]:
    """Remove a stored rig profile."""
    remove_rig(workspace.ledger, name)
    return {"removed": name}
