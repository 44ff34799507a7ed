"""Recordings (LM_direct) and envelopes (LM_max) of a component, and their solves (LM_start)."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict
from typing import Annotated, Any, cast

import numpy as np
from fastapi import Query, Request
from numpy.typing import NDArray
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response

from wrenchbook.service import messages
from wrenchbook.service.contract import MAX_BLOCK, counted
from wrenchbook.service.http.batch import BINARY_BODY, is_binary, read_wrenches
from wrenchbook.service.http.bodies import (
    BinaryBlock,
    BlockBody,
    BlockKey,
    Body,
    EnvelopeStartBody,
    StartBody,
)
from wrenchbook.service.http.body import (
    JsonRoute,
    both_tolerances,
    checked,
    parsed_json,
    query_options,
    read_limited,
    with_wrenches,
)
from wrenchbook.service.http.openapi import answers, component_router, refused, takes
from wrenchbook.service.http.routes import DirectRoute, json_reply
from wrenchbook.service.query import job_link
from wrenchbook.service.recording.bound import bound_of
from wrenchbook.service.recording.start import (
    StartedSolves,
    start_envelope,
    start_recording,
    start_resolving,
)
from wrenchbook.service.recording.store import BlockResult, RecordingStore, Tally
from wrenchbook.service.workspace import Workspace
from wrenchbook.surrogate.table.rows import NEAR

Floats = NDArray[np.float64]
Positive = Annotated[float | None, Query(gt=0, allow_inf_nan=False)]

NUMBER_BYTES = 40  # largest mean size of a block's numbers: 17 digits, a comma, some blanks

router = component_router("recording", route=JsonRoute)
# These calls read their own bodies.
blocks = component_router("recording", codes=(404, 409, 422), route=DirectRoute)
_BLOCK = takes(BlockBody, BINARY_BODY, BinaryBlock)


class Block(messages.Gathered):
    recorded: int
    duplicate: bool


class Recorded(Block, messages.RecordingCounts):
    """Result of a block of wrenches in a recording."""


class Widened(Block, messages.Box):
    """Result of a block of wrenches in an envelope."""


class Cleared(messages.Message):
    component: str
    cleared: int


_QUEUED = answers(messages.Started, "solves are queued", 202) | refused(409, 429)


@blocks.post(
    "/recording",
    status_code=201,
    response_model=Recorded,
    responses=answers(Recorded, "the block was recorded before; nothing has changed"),
    openapi_extra=_BLOCK,
)
async def record(name: str, request: Request) -> Response:
    """LM_direct: save wrenches for later."""
    wrenches, block = await _block(name, request)
    result = await run_in_threadpool(_store(request).record, name, wrenches, block)
    fields = _block_fields(name, len(wrenches), result)
    return json_reply(Recorded(**fields, **_counts(result.tally)), 200 if result.known else 201)


@router.get("/recording", response_model=messages.Recording)
def get_recording(name: str, request: Request) -> Response:
    """Show the recording."""
    recording = _store(request).recording(name)
    tally = recording.tally
    fields = {"reason": _thinning(tally), "wrenches": recording.wrenches, **_counts(tally)}
    return json_reply(messages.Recording(component=name, outside=tally.outside, **fields))


@router.delete("/recording", response_model=Cleared)
def clear_recording(name: str, request: Request) -> Response:
    """Clear the recording."""
    before = _store(request).clear(name, "recording")
    return json_reply(Cleared(component=name, cleared=before.offered))


@router.post("/recording/start", response_model=messages.Started, responses=_QUEUED)
def solve_recording(name: str, request: Request, order: StartBody) -> Response:
    """LM_start: queue solves of recorded wrenches that are not covered."""
    return _start(name, request, order, start_recording, _store(request))


@blocks.post("/envelope", response_model=Widened, openapi_extra=_BLOCK)
async def widen_envelope(name: str, request: Request) -> Response:
    """LM_max: widen the envelope by a block of wrenches."""
    wrenches, block = await _block(name, request)
    result, envelope = await run_in_threadpool(_store(request).widen, name, wrenches, block)
    fields, (low, high) = _block_fields(name, len(wrenches), result), envelope.box
    return json_reply(Widened(**fields, count=result.tally.offered, min=low, max=high))


@router.get("/envelope", response_model=messages.Envelope)
def get_envelope(
    name: str, request: Request, translation: Positive = None, rotation: Positive = None
) -> Response:
    """Show the envelope and a bound of its displacements."""
    workspace: Workspace = request.app.state.workspace
    component = workspace.library[name]
    tolerance = both_tolerances(translation, rotation) or component.tolerance
    envelope = _store(request).envelope(name)
    bound = bound_of(workspace.tables.surrogate(name), envelope, tolerance)
    low, high = envelope.box
    return json_reply(
        messages.Envelope(
            component=name,
            inputs=component.space.input_names,
            outputs=component.space.output_names,
            count=envelope.tally.offered,
            min=low,
            max=high,
            outside=envelope.tally.outside,
            at_min=envelope.lowest,
            at_max=envelope.highest,
            displacement_bound=bound.displacement,
            bound={"kind": bound.kind, "formula": bound.formula, "coverage": bound.coverage},
            negligible=bound.negligible,
            tolerance=cast(Any, tolerance and asdict(tolerance)),
            reason=bound.reason,
        )
    )


@router.delete("/envelope", response_model=Cleared)
def clear_envelope(name: str, request: Request) -> Response:
    """Clear the envelope."""
    before = _store(request).clear(name, "envelope")
    return json_reply(Cleared(component=name, cleared=before.offered))


@router.post("/envelope/start", response_model=messages.Started, responses=_QUEUED)
def solve_envelope(name: str, request: Request, order: EnvelopeStartBody) -> Response:
    """LM_start: queue solves of the envelope's extreme wrenches."""
    return _start(name, request, order, start_envelope, _store(request))


@router.post("/table/resolve", response_model=messages.Started, responses=_QUEUED)
def resolve_table(name: str, request: Request, order: StartBody) -> Response:
    """Queue solves of wrenches that only an earlier setup has solved."""
    return _start(name, request, order, start_resolving)


def _store(request: Request) -> RecordingStore:
    return request.app.state.recording_store


async def _block(name: str, request: Request) -> tuple[Floats, tuple[str, int] | None]:
    """Return a block's wrenches, shape (n, inputs), SI, and its key if there is one."""
    space = request.app.state.workspace.library.as_read(name).space
    limit = MAX_BLOCK * len(space.inputs) * NUMBER_BYTES
    body = await read_limited(request.receive, limit)
    binary = is_binary(request)
    options = query_options(request.query_params, BinaryBlock.model_fields if binary else ())
    key: BlockKey
    if binary:
        key = sent = checked(BinaryBlock, options)
        wrenches = read_wrenches(body, sent.inputs, space, MAX_BLOCK, np.inf)
    else:
        fields = await run_in_threadpool(parsed_json, body)
        form = BlockBody, fields, len(space.inputs), np.inf, MAX_BLOCK
        wrenches, key = await run_in_threadpool(with_wrenches, *form)
    if key.client is None or key.sequence is None:
        return wrenches, None
    return wrenches, (key.client, key.sequence)


def _block_fields(name: str, count: int, result: BlockResult) -> dict[str, Any]:
    """Return the fields of a block's reply that recordings and envelopes share."""
    remarks = [_thinning(result.tally)]
    if result.known:
        remarks.append("this block was recorded before; nothing has changed")
    if result.outside:
        remarks.append(
            f"{result.outside} of these are outside the load range: they are kept, and solved only "
            "by a start with beyond_range true (--beyond-range)"
        )
    return {
        "component": name,
        "recorded": count,
        "duplicate": result.known,
        "outside": result.tally.outside,
        "reason": "; ".join(filter(None, remarks)),
    }


def _counts(tally: Tally) -> dict[str, Any]:
    return {
        "total": tally.offered,
        "kept": tally.offered - tally.merged - tally.thinned,
        "merged": tally.merged,
        "thinned": tally.thinned,
        "within": tally.within,
        "within_outside": tally.within_outside,
    }


def _thinning(tally: Tally) -> str:
    """Return the sentence on thinned wrenches; empty if there are none."""
    if not tally.thinned:
        return ""
    near = f"each differs by at most {tally.within:.2g} of the load range from one kept"
    if tally.within_outside > NEAR:
        near += f", or, outside the range, by {tally.within_outside:.2g} of itself"
    return f"thinned out: {counted(tally.thinned, 'wrench')}; {near}"


def _start(
    name: str,
    request: Request,
    order: Body,
    start: Callable[..., StartedSolves],
    *store: RecordingStore,
) -> Response:
    """Queue solves by the options in the body."""
    workspace = request.app.state.workspace
    began = time.time()
    started = start(workspace, name, *store, **order.model_dump())
    links = tuple(messages.JobLink(**job_link(job, began)) for job in started.jobs)
    body = messages.Started(**{**vars(started), "component": name, "jobs": links})
    return json_reply(body, 202 if started.jobs else 200)


router.routes.extend(blocks.routes)  # an included router's routes would lack the prefix
