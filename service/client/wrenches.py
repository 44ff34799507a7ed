"""Checks of wrenches, tolerances and options before a request; errors name the wrong number."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable, Mapping, Sequence
from numbers import Real
from typing import Protocol, TypeVar, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..contract import LOADS, OnThin
from .errors import Document, InvalidArgument, Json

ON_THIN: tuple[OnThin, ...] = get_args(OnThin)

Vector = NDArray[np.float64]
T = TypeVar("T")


class TolerancePair(Protocol):
    """A tolerance as attributes: ``translation``, m, and ``rotation``, rad."""

    @property
    def translation(self) -> float:
        """The tolerance of translations, m."""
        ...

    @property
    def rotation(self) -> float:
        """The tolerance of rotations, rad."""
        ...


Tolerance = Mapping[str, float] | Sequence[float] | TolerancePair
Load = ArrayLike | Mapping[str, ArrayLike]  # (6,), or force and moment (3,), N and N·m


def single_wrench(force: ArrayLike, moment: ArrayLike | None = None) -> Vector:
    """Return a checked wrench (6,), N and N·m, of a force and a moment (3,), zero if not given.

    The force alone may be the whole wrench (6,).

    Raises InvalidArgument with the number that is NaN or infinite, or the shape that is wrong.
    """
    # A fast path for loops of thousands of calls a second: a finite sum has finite terms.
    if (
        type(force) is np.ndarray
        and force.shape == (6,)
        and force.dtype == np.float64
        and moment is None
        and math.isfinite(sum(force.tolist()))
    ):
        return force.copy()
    wrench = _numbers(force, "force")
    if moment is not None or wrench.shape != (6,):
        parts = wrench, np.zeros(3) if moment is None else _numbers(moment, "moment")
        for name, part in zip(("force", "moment"), parts, strict=True):
            if part.shape != (3,):
                six = "; to give a wrench of six numbers, pass it as force and leave moment out"
                raise InvalidArgument(
                    f"{name} must be three numbers (x, y, z), but has the shape {part.shape}"
                    f"{six * (part.shape == (6,))}"
                )
        wrench = np.concatenate(parts)
    _require_finite(wrench[None, :], "")
    return wrench


def loads_body(
    force: ArrayLike | None,
    moment: ArrayLike | None,
    loads: Mapping[str, Load] | None,
    inputs: Mapping[str, float] | None,
) -> Document:
    """Return the checked loads of a call in the form of the request.

    They are force and moment of a component with one interface, or the loads by interface, and the
    further inputs by name, SI.

    Raises InvalidArgument if both a wrench and loads are given, if a shape is wrong or a number is
    not finite.
    """
    body: Document = {}
    is_wrench = force is not None or moment is not None
    if is_wrench and loads is not None:
        raise InvalidArgument(
            "loads already gives force and moment of each interface; leave force= and moment= out"
        )
    if is_wrench:
        body = _parts(single_wrench(np.zeros(3) if force is None else force, moment))
    elif loads is not None:
        body["loads"] = {}
        for name, load in _mapping("loads", loads).items():
            parts = load if isinstance(load, Mapping) else {"force": load}
            unknown = [repr(key) for key in parts if key not in ("force", "moment")]
            if unknown:
                raise InvalidArgument(
                    f"loads[{name!r}] has the key {', '.join(unknown)}, but only force and moment "
                    "are allowed; remove the others"
                )
            try:
                wrench = single_wrench(parts.get("force", np.zeros(3)), parts.get("moment"))
            except InvalidArgument as error:
                raise InvalidArgument(f"loads[{name!r}]: {error}") from None
            body["loads"][name] = _parts(wrench)
    elif inputs is None:
        raise InvalidArgument(
            "the call has no load; give force=[Fx, Fy, Fz] in N, moment=[Mx, My, Mz] in N·m, or "
            "loads={INTERFACE: [Fx, Fy, Fz, Mx, My, Mz]}"
        )

    for name, value in _mapping("inputs", inputs or {}).items():
        number = _numbers(value, f"inputs[{name!r}]")
        if number.shape or not np.isfinite(number):
            raise InvalidArgument(f"inputs[{name!r}] must be one finite number, not {value!r}")
        body.setdefault("inputs", {})[name] = number.item()
    return body


def wrench_of(body: Mapping[str, Json]) -> Vector:
    """Return the wrench of `loads_body`'s result for one interface, shape (6,), N and N·m."""
    zero = [0.0] * 3
    return np.array([*body.get("force", zero), *body.get("moment", zero)])


def _mapping(name: str, values: Mapping[str, T]) -> Mapping[str, T]:
    if not isinstance(values, Mapping):
        raise InvalidArgument(f"{name} must map names to values, {{NAME: ...}}, not {values!r}")
    return values


def _parts(wrench: Vector) -> Document:
    return {"force": wrench[:3].tolist(), "moment": wrench[3:].tolist()}


def many_wrenches(wrenches: ArrayLike, inputs: int | None = len(LOADS)) -> Vector:
    """Return checked wrenches (n, inputs), SI; with any number of inputs if it is None."""
    block = _numbers(wrenches, "wrenches")
    if block.size == 0 and block.ndim <= 2:
        return np.empty((0, inputs or len(LOADS)))
    if block.ndim != 2 or block.shape[1] < len(LOADS) or inputs not in (None, block.shape[1]):
        width = f"{len(LOADS)} or more" if inputs is None else inputs
        single = "; put a single wrench in brackets: [wrench]" * (block.ndim == 1)
        raise InvalidArgument(
            f"wrenches must have the shape (n, {width}), one wrench in each row, not "
            f"{block.shape}{single}"
        )
    _require_finite(block, "wrench {}: ")
    return block


def options(
    *, on_thin: str | None = None, tolerance: Tolerance | None = None, **others: Json
) -> Document:
    """Return the options of a call that are not None, after a check of frequent mistakes."""
    if on_thin is not None:
        require_one_of("on_thin", on_thin, ON_THIN)
    limit = None if tolerance is None else tolerance_body(tolerance)
    values = {"on_thin": on_thin, "tolerance": limit, **others}
    return {name: value for name, value in values.items() if value is not None}


def tolerance_body(tolerance: Tolerance) -> dict[str, float]:
    """Return a tolerance in the form of the request, positive and finite.

    It is ``translation`` in m and ``rotation`` in rad, as keys, as attributes or in this order.
    """
    try:
        if isinstance(tolerance, str):
            raise TypeError
        if isinstance(tolerance, Mapping):
            pair = (tolerance["translation"], tolerance["rotation"])
        elif isinstance(tolerance, Iterable):
            pair = tuple(tolerance)
        else:
            pair = (tolerance.translation, tolerance.rotation)
        translation, rotation = (float(part) for part in pair)
    except (KeyError, TypeError, ValueError, AttributeError):
        raise InvalidArgument(
            "tolerance: must be two numbers, m and rad, such as {'translation': 1e-6, "
            f"'rotation': 1e-5}}, not {tolerance!r}"
        ) from None
    body = {"translation": translation, "rotation": rotation}
    for name, least in (("translation", "0 m, such as 1e-6"), ("rotation", "0 rad, such as 1e-5")):
        if not 0.0 < body[name] < np.inf:
            raise InvalidArgument(
                f"tolerance: {name} must be finite and above {least}, not {body[name]:g}"
            )
    return body


def _numbers(values: ArrayLike, name: str) -> Vector:
    """Return numbers as an array of floats; InvalidArgument for a text, also one of digits."""
    try:
        block = np.asarray(values)
    except ValueError:
        raise InvalidArgument(f"{name} has rows of different lengths; make all equal") from None
    if block.dtype.kind not in "fiu" and block.size:
        for at, item in np.ndenumerate(np.asarray(values, dtype=object)):
            if isinstance(item, bool | np.bool) or not isinstance(item, Real):
                if not at:
                    raise InvalidArgument(
                        f"{name} must be numbers, such as [1.0, 2.0, 3.0], not {item!r:.80}"
                    )
                place = f"{name}[{', '.join(map(str, at))}]"
                remedy = "a float (0.0 for no load)" if item is None else "a float, such as 1.5"
                raise InvalidArgument(f"{place} is {item!r:.80}, not a number; give {remedy}")
        raise InvalidArgument(f"{name} has the type {block.dtype}; convert it to float64")
    if "numpy.ma" in sys.modules and np.ma.is_masked(values):  # np.ma takes 8 ms to load
        raise InvalidArgument(f"{name} must be numbers, but has masked ones; fill or remove them")
    return block.astype(float)


def require_one_of(name: str, value: str, known: Sequence[str]) -> None:
    """Raise InvalidArgument if the value of an argument is not among the known ones."""
    if not isinstance(value, str) or value not in known:  # an array has no single truth value
        raise InvalidArgument(f"{name} must be one of {', '.join(known)}, not {value!r:.80}")


def floats_of(name: str, values: ArrayLike, shape: tuple[int, ...]) -> Vector:
    """Return a copy of an argument as finite floats of a shape; raises InvalidArgument."""
    try:
        array = np.array(values, dtype=float)
    except (TypeError, ValueError):
        raise InvalidArgument(f"{name} must be numbers of shape {shape}, not {values!r}") from None
    if array.shape != shape:
        raise InvalidArgument(f"{name} must have shape {shape}, not {array.shape}")
    # A sum is the fastest test of all numbers; that of finite ones may overflow.
    if not (math.isfinite(array.sum()) or np.isfinite(array).all()):
        raise InvalidArgument(f"{name} must be finite, not {array.tolist()}")
    return array


def _require_finite(block: Vector, where: str) -> None:
    """Raise InvalidArgument with the place of the first number that is not finite."""
    finite = np.isfinite(block)
    if not finite.all():
        bad = np.argwhere(~finite)
        row, column = bad[0].tolist()
        name = LOADS[column] if block.shape[1] == len(LOADS) else f"input {column}"
        raise InvalidArgument(f"{where.format(row)}{name} must be finite, not {block[row, column]}")
