"""Profiles of test rigs by name: columns, frame, zero and cycles of its files, as TOML texts."""

from __future__ import annotations

from typing import Annotated, Literal

from fastapi import APIRouter, Path, Request
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response

from wrenchbook.service.formats.rig import MAX_RIG, NAME, shipped_rigs
from wrenchbook.service.http.body import read_limited
from wrenchbook.service.http.openapi import BYTES, TEXT, answers, refused
from wrenchbook.service.http.problems import bad_body
from wrenchbook.service.http.routes import Opened, json_reply
from wrenchbook.service.http.routes.table import PACKED_TYPE, profile_of, profile_problem
from wrenchbook.service.library.rigs import remove_rig, rig_of, store_rig, stored_rigs
from wrenchbook.service.messages import RigCard, Rigs

router = APIRouter(prefix="/v1/rigs", tags=["rigs"], responses=refused(404, 422))

RigName = Annotated[str, Path(pattern=f"^{NAME.pattern}$")]
_TOML = {"application/toml": TEXT}
_REPLACED = refused(s409="the server stores as many as it may")


@router.get("", summary="The profiles: stored ones, and those of the program", response_model=Rigs)
def list_rigs(workspace: Opened) -> Response:
    stored, shipped = stored_rigs(workspace.ledger), shipped_rigs()
    cards = [
        RigCard(name=name, origin="stored", title=_title(text)) for name, text in stored.items()
    ]
    rest = [name for name in shipped if name not in stored]
    cards += [RigCard(name=name, origin="shipped", title=_title(shipped[name])) for name in rest]
    return json_reply(Rigs(rigs=cards))


@router.get(
    "/{name}",
    summary="A profile as TOML: the stored one of this name, else the program's",
    response_class=Response,
    responses={200: {"description": "the profile", "content": _TOML}},
)
def get_rig(name: RigName, workspace: Opened) -> Response:
    return Response(rig_of(workspace.ledger, name), 200, None, "application/toml; charset=utf-8")


@router.put(
    "/{name}",
    summary="Store a profile, or replace it; it is checked as an import checks it",
    responses=answers(RigCard, "stored") | _REPLACED,
    openapi_extra={"requestBody": {"required": True, "content": {PACKED_TYPE: BYTES, **_TOML}}},
)
async def put_rig(name: RigName, request: Request, workspace: Opened) -> Response:
    try:
        text = (await read_limited(request.receive, 4 * MAX_RIG)).decode("utf-8-sig")
        if len(text) > MAX_RIG:
            raise ValueError(f"has {len(text):,} characters; a rig has {MAX_RIG:,} at most")
        profile_of(text)
    except UnicodeDecodeError:
        raise bad_body([{"loc": "body", "msg": "is not UTF-8"}]) from None
    except ValueError as error:
        raise profile_problem(error) from None
    await run_in_threadpool(store_rig, workspace.ledger, name, text)
    return json_reply(RigCard(name=name, origin="stored", title=_title(text)))


@router.delete("/{name}", summary="Remove a stored profile; imports keep the text of theirs")
def delete_rig(name: RigName, workspace: Opened) -> dict[Literal["removed"], str]:
    remove_rig(workspace.ledger, name)
    return {"removed": name}


def _title(text: str) -> str:
    """Return the comment in a profile's first line; empty if it has none."""
    first = text.lstrip().partition("\n")[0]
    return first.lstrip("# ").strip()[:200] if first.startswith("#") else ""
