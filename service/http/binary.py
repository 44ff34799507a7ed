"""The batch call's binary form: float64 in, float64 out, and no text in between."""

from __future__ import annotations

from typing import Annotated, Final

import numpy as np
from fastapi import Request
from pydantic import Field, ValidationError

from wrenchbook.fea.bundle.tables import LARGEST_LOAD
from wrenchbook.service.answering.queries import BatchQuery
from wrenchbook.service.http.bodies import MAX_BATCH, Body, Derivatives, Flag, OnThin, Seconds
from wrenchbook.service.http.parsing import VersionQuery, known_method
from wrenchbook.service.http.problems import bad_body, plain_errors
from wrenchbook.surrogate.table.rows import LOADS, Tolerance

MEDIA_TYPE: Final = "application/octet-stream"
ROW_BYTES: Final = 6 * 8
_Bar = Annotated[float, Field(gt=0, allow_inf_nan=False)]

BODY: Final = {
    MEDIA_TYPE: {
        "schema": {
            "type": "string",
            "format": "binary",
            "description": "little-endian float64 (n, 6): force and moment, N and N·m",
        }
    }
}
REPLY: Final = {
    MEDIA_TYPE: {
        "schema": {
            "type": "string",
            "format": "binary",
            "description": "little-endian float64 (n, 13): displacement and error bar, m and rad; "
            "coverage 0 covered, 1 thin, 2 outside; NaN where nothing is known. With "
            "derivatives=true then (n, 36): du/dw of each wrench, 6 x 6, an output a line. The "
            "header Wrenchbook-Tolerance has the tolerance for whole bars, m and rad",
        }
    }
}
_JSONS = Field(description="binary form: as in JSON")


class BinaryOptions(Body):
    """The options of a binary batch, which are query parameters."""

    on_thin: Annotated[OnThin, _JSONS] = "queue"
    wait_s: Annotated[Seconds, Field(description="binary form: s, with on_thin=wait")] = 30.0
    method: Annotated[str | None, _JSONS] = None
    translation: Annotated[_Bar | None, Field(description="binary form: tolerance, m")] = None
    rotation: Annotated[_Bar | None, Field(description="binary form: tolerance, rad")] = None
    beyond_range: Annotated[Flag, _JSONS] = False
    derivatives: Annotated[
        Derivatives, Field(description="binary form: add (n, 36) behind the (n, 13)")
    ] = False


class BinaryQuery(BinaryOptions, VersionQuery):
    """All query parameters of a batch, for the OpenAPI document."""


def is_binary(request: Request) -> bool:
    """Tell whether a batch comes as float64."""
    kind = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    return kind == MEDIA_TYPE


def read_binary(body: bytes, options: dict[str, str]) -> BatchQuery:
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
    return BatchQuery(
        read_wrenches(body),
        full.on_thin,
        full.wait_s,
        limit,
        known_method(full.method),
        full.beyond_range,
        full.derivatives,
    )


def read_wrenches(body: bytes, most: int = MAX_BATCH, largest: float = LARGEST_LOAD) -> np.ndarray:
    """Read little-endian float64 as wrenches, shape (n, 6), N and N·m.

    Raises
    ------
    ProblemError
        422, if they are no whole wrenches, more than `most`, or a number is not finite.
    """
    if len(body) % ROW_BYTES:
        message = f"{len(body)} bytes are no whole number of wrenches, {ROW_BYTES} bytes each"
        raise bad_body([{"loc": "body", "msg": message}])
    if len(body) > most * ROW_BYTES:
        raise bad_body([{"loc": "body", "msg": f"at most {most} wrenches a call"}])
    wrenches = np.frombuffer(body, dtype="<f8").reshape(-1, 6).astype(float) + 0.0
    bad = np.argwhere(~(np.isfinite(wrenches) & (np.abs(wrenches) <= largest)))
    if len(bad):
        row, load = bad[0].tolist()
        found = wrenches[row, load]
        why = f"beyond {largest:g}" if np.isfinite(found) else "not finite"
        message = f"{LOADS[load]} is {found}, {why}"
        raise bad_body([{"loc": f"wrenches.{row}.{load}", "msg": message}])
    return wrenches
