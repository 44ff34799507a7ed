"""Parses bodies of displacement calls; pydantic names each mistake.

A mistake is a `HttpProblemError` of status 422 with the place of each mistake.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import orjson
from pydantic import ValidationError
from starlette.datastructures import QueryParams

from wrenchbook.fea.bundle.tables import LARGEST_LOAD
from wrenchbook.service.contract import MAX_BLOCK
from wrenchbook.service.http.bodies import (
    BatchBody,
    BlockBody,
    Body,
    DisplacementBody,
    LoadsBody,
    ToleranceBody,
)
from wrenchbook.service.http.problems import bad_body, plain_errors
from wrenchbook.service.query import Query, plain_query
from wrenchbook.surrogate.answer import METHODS
from wrenchbook.surrogate.table.rows import Tolerance
from wrenchbook.surrogate.table.space import DEFAULT, PER_INTERFACE, Space, SpaceError


def read_query(body: bytes, space: Space = DEFAULT) -> Query:
    """Return the query of the main call's body, of a component with the inputs of `space`.

    A body of only force, moment and on_thin, which is what a simulator sends in its loop, is
    checked without pydantic; anything else, and every mistake, goes through it.
    """
    fields = parsed_json(body)
    plain = plain_query(fields) if space.is_default else None
    if plain is not None:
        return plain
    full: DisplacementBody = checked(DisplacementBody, fields)
    wrench = loads_of(full, space)
    return query_of(full)._replace(wrench=wrench, detail=full.detail)


def query_of(body: DisplacementBody | BatchBody) -> Query:
    """Return the options of a body, as those of a query without a wrench."""
    limit, method = tolerance_of(body.tolerance), known_method(body.method)
    flags = False, body.beyond_range, body.derivatives
    return Query((), body.on_thin, body.wait_s, limit, method, *flags)


def loads_of(body: LoadsBody, space: Space) -> tuple[float, ...]:
    """Return the inputs of a component, (n,), SI: loads that a body does not have are zero.

    Raises HttpProblemError 422 with each interface or input that is unknown, and each further input
    that is missing.
    """
    loads = {name: wrench.wrench() for name, wrench in body.loads.items()}
    if not super(LoadsBody, body).is_empty():
        if loads or space.several:
            names = " or ".join(space.several) or "one of both"
            message = f"give force and moment of an interface in loads: {names}"
            raise bad_body([{"loc": "force", "msg": message}])
        loads = {space.interfaces[0]: body.wrench()}
    try:
        return space.vector(loads, {name: value + 0.0 for name, value in body.inputs.items()})
    except SpaceError as error:
        raise bad_body([{"loc": place, "msg": text} for place, text in error.mistakes]) from None


def read_block(body: bytes, inputs: int = PER_INTERFACE) -> tuple[np.ndarray, BlockBody]:
    """Read a block of wrenches for a recording or an envelope: shape (n, inputs), SI; its key."""
    fields = parsed_json(body)
    wrenches = plain_wrenches(fields, np.inf, inputs)
    if wrenches is not None and len(wrenches) <= MAX_BLOCK:
        return wrenches + 0.0, checked(BlockBody, {**fields, "wrenches": []})
    full = checked(BlockBody, fields)
    return even_rows(full.wrenches, inputs), full


def known_method(method: str | None, where: str = "method") -> str | None:
    """Return a method's name; 422, at `where` in the request, if there is no such method."""
    if method is not None and method not in METHODS:
        message = f"unknown method {method!r}: one of {', '.join(METHODS)}"
        raise bad_body([{"loc": where, "msg": message}])
    return method


def read_body(kind: type[Body], body: bytes) -> Any:
    """Read any other body with pydantic; an empty one counts as ``{}``."""
    return checked(kind, parsed_json(body or b"{}"))


def parsed_json(body: bytes) -> Any:
    """Return the values of JSON; 422, or MemoryError if it is too large for the parser."""
    try:
        return orjson.loads(body)
    except orjson.JSONDecodeError as error:
        if "memory" in str(error).lower():
            raise MemoryError from None
        message = f"not valid JSON ({error}); note that JSON has no NaN and no Infinity"
        raise bad_body([{"loc": "body", "msg": message}]) from None


def checked(kind: type[Body], fields: Any) -> Any:
    """Return the body of parsed JSON; 422 with every mistake's place."""
    try:
        return kind.model_validate(fields)
    except ValidationError as error:
        raise bad_body(plain_errors(error)) from None


def both_tolerances(translation: float | None, rotation: float | None) -> Tolerance | None:
    """Return a tolerance, m and rad; 422 if one of its two numbers is missing."""
    if translation is not None and rotation is not None:
        return Tolerance(translation, rotation)
    if translation is rotation:
        return None
    missing = "rotation" if rotation is None else "translation"
    raise bad_body([{"loc": missing, "msg": "a tolerance is translation and rotation, both"}])


def plain_wrenches(
    fields: Any, largest: float = LARGEST_LOAD, inputs: int = PER_INTERFACE
) -> np.ndarray | None:
    """Return the wrenches of a batch (n, inputs); None if anything is unusual in them."""
    return plain_rows(fields.get("wrenches"), largest, inputs) if isinstance(fields, dict) else None


def plain_rows(
    rows: Any, largest: float = LARGEST_LOAD, inputs: int = PER_INTERFACE
) -> np.ndarray | None:
    """Wrenches as an array (n, inputs); None if anything is unusual in them."""
    if not isinstance(rows, list) or not rows:
        return None
    try:
        wrenches = np.array(rows)
    except ValueError:
        return None
    if wrenches.dtype.kind not in "fi" or wrenches.ndim != 2 or wrenches.shape[1] != inputs:
        return None
    wrenches = wrenches.astype(float)
    fine = np.isfinite(wrenches) & (np.abs(wrenches) <= largest)
    return wrenches if fine.all() else None


def even_rows(wrenches: list[list[float]], inputs: int) -> np.ndarray:
    """Wrenches that pydantic has checked as an array (n, inputs); 422 if a length is wrong."""
    uneven = [place for place, wrench in enumerate(wrenches) if len(wrench) != inputs]
    if uneven:
        message = f"has {len(wrenches[uneven[0]])} numbers, and the component {inputs} inputs"
        raise bad_body([{"loc": f"wrenches.{uneven[0]}", "msg": message}])
    return np.array(wrenches, dtype=float).reshape(-1, inputs) + 0.0


def tolerance_of(body: ToleranceBody | None) -> Tolerance | None:
    """Return the tolerance of a body, m and rad."""
    return Tolerance(body.translation, body.rotation) if body else None


def refuse_query(query: QueryParams) -> None:
    """Refuse the query parameters of a call that takes none: 422 with the name of each."""
    if query:
        message = "this call takes no query parameters: send its options in the body"
        raise bad_body([{"loc": f"query.{name}", "msg": message} for name in query])
