"""What the calls of recordings and envelopes take and answer, for the OpenAPI document."""

from __future__ import annotations

from typing import Any, Final

from service.http import binary
from service.http.bodies import BlockBody, EnvelopeStartBody, StartBody
from service.http.call import JSON, Call
from service.http.schemas import JOB, SIX, Schema, body_of

BLOCK_PARAMETERS: Final[tuple[dict[str, Any], ...]] = (
    {
        "name": "client",
        "in": "query",
        "required": False,
        "schema": {"type": "string", "minLength": 1, "maxLength": 64},
        "description": "binary form: as in JSON",
    },
    {
        "name": "sequence",
        "in": "query",
        "required": False,
        "schema": {"type": "integer", "minimum": 0},
        "description": "binary form: as in JSON",
    },
)
_COUNT: Final[Schema] = {"type": "integer"}
_TOLD: Final[dict[str, Schema]] = {
    "component": {"type": "string"},
    "duplicate": {
        "type": "boolean",
        "description": "the block was recorded before; nothing has changed",
    },
    "outside": {**_COUNT, "description": "of all taken in: outside the load range"},
    "reason": {"type": "string", "description": "what there is to know; empty if nothing"},
}
_STANDS: Final[dict[str, Schema]] = {
    "total": {**_COUNT, "description": "wrenches taken in since it was cleared, each once"},
    "kept": {**_COUNT, "description": "wrenches kept; start solves these"},
    "merged": {**_COUNT, "description": "of total: within 1e-6 of the range of one kept"},
    "thinned": {
        **_COUNT,
        "description": "of total: left out by thinning, beyond 10,000 kept, or "
        "1,000 outside the load range",
    },
    "within": {
        "type": "number",
        "description": "every wrench taken in within the load range is as near as this to one "
        "kept: the largest difference of a load by its scale",
    },
    "within_outside": {
        "type": "number",
        "description": "the same of those outside the range; there the difference is by the load",
    },
}
_BOX: Final[dict[str, Schema]] = {
    "count": {**_COUNT, "description": "wrenches taken in since it was cleared, each once"},
    "min": {**SIX, "description": "least value of each load, N and N·m; null before the first"},
    "max": {**SIX, "description": "largest value of each load, N and N·m; null before the first"},
}
_WRENCHES: Final[Schema] = {"type": "array", "items": SIX, "description": "N and N·m"}


def _object(*parts: dict[str, Schema]) -> Schema:
    return {"type": "object", "properties": {k: v for part in parts for k, v in part.items()}}


RECORDED: Final = _object(_TOLD, {"recorded": _COUNT}, _STANDS)
RECORDING: Final = _object(_TOLD, _STANDS, {"wrenches": _WRENCHES})
WIDENED: Final = _object(_TOLD, {"recorded": _COUNT}, _BOX)
ENVELOPE: Final = _object(
    _TOLD,
    _BOX,
    {
        "at_min": {**_WRENCHES, "description": "the whole wrench at each least value, N and N·m"},
        "at_max": {**_WRENCHES, "description": "the whole wrench at each largest value, N and N·m"},
        "displacement_bound": {**SIX, "description": "m and rad; null where nothing is known"},
        "bound": {
            "type": "object",
            "description": "what displacement_bound is",
            "properties": {
                "kind": {"enum": ["bound", "estimate", "unknown"]},
                "formula": {"type": "string"},
                "coverage": {"enum": ["covered", "thin", "outside"]},
            },
        },
        "negligible": {
            "type": ["boolean", "null"],
            "description": "whether displacement_bound is within the tolerance; null: see reason",
        },
        "tolerance": {
            "type": ["object", "null"],
            "properties": {"translation": {"type": "number"}, "rotation": {"type": "number"}},
        },
    },
)
STARTED: Final = _object(
    {
        "component": {"type": "string"},
        "jobs": {"type": "array", "items": JOB, "description": "waiting or running for these"},
        "solved": {**_COUNT, "description": "wrenches that a row of the table has"},
        "covered": {**_COUNT, "description": "wrenches that the table covers: not solved"},
        "failed": {**_COUNT, "description": "wrenches whose solve has failed before"},
        "beyond_range": {**_COUNT, "description": "wrenches outside the load range: not solved"},
        "left": {**_COUNT, "description": "wrenches that the budget leaves"},
        "reason": {"type": "string", "description": "why not all; empty if all are queued"},
    }
)
CLEARED: Final = _object(
    {"component": {"type": "string"}, "cleared": {**_COUNT, "description": "wrenches forgotten"}}
)

_BLOCK: Final = {JSON: body_of(BlockBody), binary.MEDIA_TYPE: binary.BODY}
_STARTED: Final = {200: "nothing to queue; reason says why", 202: "solves are queued"}


def _calls(kind: str, taken: Schema, status: int, whole: Schema) -> dict[tuple[str, str], Call]:
    """Return the calls of recordings or of envelopes."""
    path = f"/v1/components/{{name}}/{kind}"
    start = StartBody if kind == "recording" else EnvelopeStartBody
    took = {status: "taken in, and durable"}
    if status != 200:
        took[200] = "the block was recorded before"
    return {
        ("post", path): Call(took, (404, 409, 413, 422), {JSON: taken}, _BLOCK, BLOCK_PARAMETERS),
        ("get", path): Call({200: f"the {kind}"}, (404, 422), {JSON: whole}),
        ("delete", path): Call({200: "cleared"}, (404, 422), {JSON: CLEARED}),
        ("post", f"{path}/start"): Call(
            _STARTED, (404, 409, 413, 422), {JSON: STARTED}, {JSON: body_of(start)}
        ),
    }


GATHER_CALLS: Final[dict[tuple[str, str], Call]] = {
    **_calls("recording", RECORDED, 201, RECORDING),
    **_calls("envelope", WIDENED, 200, ENVELOPE),
    ("post", "/v1/components/{name}/table/resolve"): Call(
        _STARTED, (404, 409, 413, 422), {JSON: STARTED}, {JSON: body_of(StartBody)}
    ),
}
