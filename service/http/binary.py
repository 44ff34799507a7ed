"""The batch call's binary form: float64 in, float64 out, and no text in between."""

from __future__ import annotations

from typing import Annotated, Any, Final

import numpy as np
from fastapi import Request
from pydantic import Field, ValidationError
from starlette.responses import Response

from service.http.bodies import MAX_BATCH, Body, OnThin, Seconds
from service.http.parsing import Batch
from service.http.problems import bad_body, plain_errors
from surrogate.rows import LOAD_SYMBOLS, Tolerance

MEDIA_TYPE: Final = "application/octet-stream"
ROW_BYTES: Final = 6 * 8
_Bar = Annotated[float, Field(gt=0, allow_inf_nan=False)]

PARAMETERS: Final[list[dict[str, Any]]] = [
    {"name": name, "in": "query", "required": False, "schema": schema, "description": text}
    for name, schema, text in (
        ("on_thin", {"enum": ["queue", "wait", "estimate", "reject"]}, "binary form: as in JSON"),
        ("wait_s", {"type": "number"}, "binary form: seconds, with on_thin=wait"),
        ("method", {"type": "string"}, "binary form: as in JSON"),
        ("translation", {"type": "number"}, "binary form: tolerance, m"),
        ("rotation", {"type": "number"}, "binary form: tolerance, rad"),
    )
]
BODY: Final[dict[str, Any]] = {
    "schema": {"type": "string", "format": "binary"},
    "description": "little-endian float64 (n, 6), N and N·m; the reply is (n, 13): displacement, "
    "error bar, coverage 0 covered, 1 thin, 2 outside; NaN where nothing can be said",
}


class BinaryOptions(Body):
    """The options of a binary batch, which are query parameters."""

    on_thin: OnThin = "queue"
    wait_s: Seconds = 30.0
    method: str | None = None
    translation: _Bar | None = None
    rotation: _Bar | None = None


def is_binary(request: Request) -> bool:
    """Tell whether a batch comes as float64."""
    kind = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    return kind == MEDIA_TYPE


def read_binary(body: bytes, options: dict[str, str]) -> Batch:
    """Read a binary batch and its query parameters.

    Raises
    ------
    ProblemError
        422, with every mistake's place.
    """
    try:
        full = BinaryOptions.model_validate(options)
    except ValidationError as error:
        raise bad_body(plain_errors(error)) from None
    if (full.translation is None) != (full.rotation is None):
        missing = "rotation" if full.rotation is None else "translation"
        raise bad_body([{"loc": missing, "msg": "a tolerance is translation and rotation, both"}])
    limit = None
    if full.translation is not None and full.rotation is not None:
        limit = Tolerance(full.translation, full.rotation)
    return Batch(_wrenches(body), full.on_thin, full.wait_s, limit, full.method)


def write_binary(reply: dict[str, Any], status: int) -> Response:
    """Lay out answers as little-endian float64 (n, 13)."""
    block = np.empty((len(reply["coverage"]), 13), dtype="<f8")
    block[:, :6], block[:, 6:12] = reply["displacements"], reply["errors"]
    block[:, 12] = reply["coverage"]
    headers = {
        "Wrenchbook-Table-Version": str(reply["table_version"]),
        "Wrenchbook-Elapsed-Us": f"{reply['elapsed_us']:.1f}",
        "Wrenchbook-Jobs": str(len(reply["jobs"])),
    }
    return Response(block.tobytes(), status, headers, MEDIA_TYPE)


def _wrenches(body: bytes) -> np.ndarray:
    if len(body) % ROW_BYTES:
        message = f"{len(body)} bytes are no whole number of wrenches, {ROW_BYTES} bytes each"
        raise bad_body([{"loc": "body", "msg": message}])
    if len(body) > MAX_BATCH * ROW_BYTES:
        raise bad_body([{"loc": "body", "msg": f"at most {MAX_BATCH} wrenches a call"}])
    wrenches = np.frombuffer(body, dtype="<f8").reshape(-1, 6).astype(float) + 0.0
    bad = np.argwhere(~np.isfinite(wrenches))
    if len(bad):
        row, load = bad[0].tolist()
        message = f"{LOAD_SYMBOLS[load]} is {wrenches[row, load]}, not finite"
        raise bad_body([{"loc": f"wrenches.{row}.{load}", "msg": message}])
    return wrenches
