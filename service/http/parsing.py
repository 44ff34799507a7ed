"""Parses bodies of displacement calls; pydantic names each mistake.

A mistake is a `HttpProblemError` of status 422 with the place of each mistake.
"""

from __future__ import annotations

from math import hypot
from typing import Any, get_args

import numpy as np
import orjson
from pydantic import ValidationError
from starlette.datastructures import QueryParams

from wrenchbook.fea.bundle.tables import LARGEST_LOAD
from wrenchbook.service.answering.queries import Query
from wrenchbook.service.contract import MAX_BLOCK
from wrenchbook.service.http.bodies import (
    BlockBody,
    Body,
    DisplacementBody,
    LoadsBody,
    OnThin,
    SolveBody,
)
from wrenchbook.service.http.problems import bad_body, plain_errors
from wrenchbook.surrogate.answer import METHODS
from wrenchbook.surrogate.table.rows import Tolerance
from wrenchbook.surrogate.table.space import DEFAULT, PER_INTERFACE, Space, SpaceError

_PLAIN_FIELDS = frozenset({"force", "moment", "on_thin"})
_NUMBERS = frozenset({int, float})  # not bool, which is an int to isinstance
_ON_THIN: dict[str, OnThin] = {word: word for word in get_args(OnThin)}


def read_query(body: bytes, space: Space = DEFAULT) -> Query:
    """Read the main call's body, of a component with the inputs of `space`.

    A body of only force, moment and on_thin, which is what a simulator sends in its loop, is
    checked here; anything else, and every mistake, goes through pydantic.
    """
    fields = parsed_json(body)
    plain = _plain_query(fields) if space.is_default else None
    if plain is not None:
        return plain
    full = checked(DisplacementBody, fields)
    return Query(
        loads_of(full, space),
        full.on_thin,
        full.wait_s,
        _tolerance(full.tolerance),
        known_method(full.method),
        full.detail,
        full.beyond_range,
        full.derivatives,
    )


def read_plain_query(body: bytes) -> Query | None:
    """Read the main call's body if it is of only force, moment and on_thin; None if it is not."""
    try:
        return _plain_query(orjson.loads(body))
    except orjson.JSONDecodeError:
        return None


def loads_of(body: LoadsBody, space: Space) -> tuple[float, ...]:
    """Return the inputs of a component, shape (n,), SI: loads that are not given are zero.

    Raises
    ------
    HttpProblemError
        422, with each interface or input that is unknown, and each further input that is missing.
    """
    loads = {name: one.wrench() for name, one in body.loads.items()}
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


def read_solve(body: bytes, space: Space = DEFAULT) -> Query:
    """Read DirectFEA's body, of a component with the inputs of `space`."""
    full = checked(SolveBody, parsed_json(body))
    return Query(loads_of(full, space), "solve", full.wait_s, beyond_range=full.beyond_range)


def read_block(body: bytes, inputs: int = PER_INTERFACE) -> tuple[np.ndarray, BlockBody]:
    """Read a block of wrenches for a recording or an envelope: shape (n, inputs), SI; its key."""
    fields = parsed_json(body)
    wrenches = plain_wrenches(fields, np.inf, inputs)
    if wrenches is not None and len(wrenches) <= MAX_BLOCK:
        return wrenches + 0.0, checked(BlockBody, {**fields, "wrenches": []})
    full = checked(BlockBody, fields)
    return even_rows(full.wrenches, inputs), full


def known_method(method: str | None, where: str = "method") -> str | None:
    """Return a method's name as it is, at `where` in the request; 422 if there is none such."""
    if method is not None and method not in METHODS:
        message = f"unknown method {method!r}: one of {', '.join(METHODS)}"
        raise bad_body([{"loc": where, "msg": message}])
    return method


def read_body(kind: type[Body], body: bytes) -> Any:
    """Read any other body with pydantic; an empty one counts as ``{}``."""
    return checked(kind, parsed_json(body or b"{}"))


def parsed_json(body: bytes) -> Any:
    """Return what a body holds as JSON.

    Raises
    ------
    HttpProblemError
        422.
    MemoryError
        If it is too large for the parser.
    """
    try:
        return orjson.loads(body)
    except orjson.JSONDecodeError as error:
        if "memory" in str(error).lower():
            raise MemoryError from None
        message = f"not valid JSON ({error}); note that JSON has no NaN and no Infinity"
        raise bad_body([{"loc": "body", "msg": message}]) from None


def checked(kind: type[Body], fields: Any) -> Any:
    """Return the body that parsed JSON is; 422 with every mistake's place."""
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


def _plain_query(fields: Any) -> Query | None:
    """Return the query that a well-formed plain body is, or None if anything is unusual."""
    if type(fields) is not dict or not fields.keys() <= _PLAIN_FIELDS:
        return None
    force, moment = fields.get("force"), fields.get("moment")
    if type(force) is not list or type(moment) is not list or len(force) != 3 or len(moment) != 3:
        return None
    numbers = (*force, *moment)
    # Finite loads that are too large together: pydantic finds the one that is, if any.
    if not _NUMBERS.issuperset(map(type, numbers)) or hypot(*numbers) > LARGEST_LOAD:
        return None
    word = fields.get("on_thin", "queue")
    on_thin = _ON_THIN.get(word) if type(word) is str else None
    # Adding zero makes floats of all, and 0 of -0.
    return Query(tuple([number + 0.0 for number in numbers]), on_thin) if on_thin else None


def plain_wrenches(
    fields: Any, largest: float = LARGEST_LOAD, inputs: int = PER_INTERFACE
) -> np.ndarray | None:
    """Return the batch as an array of shape (n, inputs), or None if anything is unusual."""
    return plain_rows(fields.get("wrenches"), largest, inputs) if isinstance(fields, dict) else None


def plain_rows(
    rows: Any, largest: float = LARGEST_LOAD, inputs: int = PER_INTERFACE
) -> np.ndarray | None:
    """Return wrenches as an array, (n, inputs), SI; None if there is anything unusual in them."""
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
    """Return wrenches that pydantic has checked as an array, (n, inputs), SI; 422 if one is not."""
    uneven = [place for place, one in enumerate(wrenches) if len(one) != inputs]
    if uneven:
        message = f"has {len(wrenches[uneven[0]])} numbers, and the component {inputs} inputs"
        raise bad_body([{"loc": f"wrenches.{uneven[0]}", "msg": message}])
    return np.array(wrenches, dtype=float).reshape(-1, inputs) + 0.0


def _tolerance(body: Any) -> Tolerance | None:
    return Tolerance(body.translation, body.rotation) if body else None


def refuse_query(query: QueryParams) -> None:
    """Refuse the query parameters of a call that takes none, so that none is overlooked.

    Raises
    ------
    HttpProblemError
        422, with the name of each.
    """
    if query:
        message = "this call takes no query parameters: send its options in the body"
        raise bad_body([{"loc": f"query.{name}", "msg": message} for name in query])
