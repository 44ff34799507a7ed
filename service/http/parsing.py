"""Reading the bodies of the displacement calls: quickly when well formed, kindly when not."""

from __future__ import annotations

from math import isfinite
from typing import Any, get_args

import numpy as np
import orjson
from pydantic import ValidationError

from service.answering.queries import BatchQuery, Query
from service.http.bodies import BatchBody, Body, DisplacementBody, OnThin, SolveBody
from service.http.problems import bad_body, plain_errors
from surrogate.answer import METHODS
from surrogate.table.rows import Tolerance

_PLAIN_FIELDS = frozenset({"force", "moment", "on_thin"})
_ON_THIN: dict[str, OnThin] = {word: word for word in get_args(OnThin)}


def read_query(body: bytes) -> Query:
    """Read the main call's body.

    A body of only force, moment and on_thin, which is what a simulator sends in its loop, is
    checked here; anything else, and every mistake, goes through pydantic.

    Raises
    ------
    ProblemError
        422, with every mistake's place.
    """
    fields = _json(body)
    if isinstance(fields, dict) and fields.keys() <= _PLAIN_FIELDS:
        wrench = _plain_wrench(fields.get("force"), fields.get("moment"))
        word = fields.get("on_thin", "queue")
        on_thin = _ON_THIN.get(word) if isinstance(word, str) else None
        if wrench is not None and on_thin is not None:
            return Query(wrench, on_thin)
    full = _checked(DisplacementBody, fields)
    return Query(
        full.wrench(),
        full.on_thin,
        full.wait_s,
        _tolerance(full.tolerance),
        known_method(full.method),
        full.detail,
        full.beyond_range,
        full.derivatives,
    )


def read_solve(body: bytes) -> Query:
    """Read DirectFEA's body.

    Raises
    ------
    ProblemError
        422, with every mistake's place.
    """
    full = _checked(SolveBody, _json(body))
    return Query(full.wrench(), "solve", full.wait_s, beyond_range=full.beyond_range)


def read_batch(body: bytes) -> BatchQuery:
    """Read the batch call's JSON body.

    Raises
    ------
    ProblemError
        422, with every mistake's place.
    """
    fields = _json(body)
    wrenches = _plain_wrenches(fields)
    if wrenches is not None:
        fields = {**fields, "wrenches": []}
    full = _checked(BatchBody, fields)
    if wrenches is None:
        wrenches = np.array(full.wrenches, dtype=float).reshape(-1, 6)
    return BatchQuery(
        wrenches + 0.0,
        full.on_thin,
        full.wait_s,
        _tolerance(full.tolerance),
        known_method(full.method),
        full.beyond_range,
        full.derivatives,
    )


def known_method(method: str | None) -> str | None:
    """Return a method's name as it is.

    Raises
    ------
    ProblemError
        422, if the surrogate has no such method.
    """
    if method is not None and method not in METHODS:
        message = f"unknown method {method!r}: one of {', '.join(METHODS)}"
        raise bad_body([{"loc": "method", "msg": message}])
    return method


def read_body(kind: type[Body], body: bytes) -> Any:
    """Read any other body with pydantic; an empty one counts as ``{}``.

    Raises
    ------
    ProblemError
        422, with every mistake's place.
    """
    return _checked(kind, _json(body or b"{}"))


def _json(body: bytes) -> Any:
    try:
        return orjson.loads(body)
    except orjson.JSONDecodeError as error:
        message = f"not valid JSON ({error}); note that JSON has no NaN and no Infinity"
        raise bad_body([{"loc": "body", "msg": message}]) from None


def _checked(kind: type[Body], fields: Any) -> Any:
    try:
        return kind.model_validate(fields)
    except ValidationError as error:
        raise bad_body(plain_errors(error)) from None


def _plain_wrench(force: Any, moment: Any) -> tuple[float, ...] | None:
    """Return six finite floats, or None if anything about the two lists is unusual."""
    if type(force) is not list or type(moment) is not list:
        return None
    if len(force) != 3 or len(moment) != 3:
        return None
    numbers = force + moment
    for number in numbers:
        if type(number) is not float and type(number) is not int:
            return None
        if not isfinite(number):
            return None
    return tuple([float(number) + 0.0 for number in numbers])


def _plain_wrenches(fields: Any) -> np.ndarray | None:
    """Return the batch as an array of shape (n, 6), or None if anything is unusual."""
    rows = fields.get("wrenches") if isinstance(fields, dict) else None
    if not isinstance(rows, list) or not rows:
        return None
    try:
        wrenches = np.array(rows)
    except ValueError:
        return None
    if wrenches.dtype.kind not in "fi" or wrenches.ndim != 2 or wrenches.shape[1] != 6:
        return None
    wrenches = wrenches.astype(float)
    return wrenches if np.isfinite(wrenches).all() else None


def _tolerance(body: Any) -> Tolerance | None:
    return Tolerance(body.translation, body.rotation) if body else None
