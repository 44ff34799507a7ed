"""The UM-Bridge protocol, version 1.0, without HTTP: what it asks, and what is answered.

UM-Bridge (Seelinger et al. 2023, "UM-Bridge: Uncertainty quantification and modeling bridge") lets
any program for uncertainty quantification or optimisation call any simulation. Here each component
is one of its models: one input vector, the wrench, and one output vector, the displacement.

The protocol has no place for an error bar or a flag. So an answer is never silently a guess: where
the table does not cover the wrench it is solved, or refused, and an estimate is given only to whom
asks for one (`on_thin` in the config).
"""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite
from typing import Annotated, Any, Final, Literal

import numpy as np
import orjson
from numpy.typing import NDArray
from pydantic import Field, ValidationError

from wrenchbook.service.answering.queries import Outcome, Query
from wrenchbook.service.http.bodies import Body, Flag, Seconds, ToleranceBody
from wrenchbook.service.http.problems import ProblemError, plain_errors
from wrenchbook.surrogate.answer import METHODS
from wrenchbook.surrogate.table.rows import OUTPUTS, Tolerance

PROTOCOL: Final = 1.0
SIZES: Final = [6]  # one vector of six numbers, in and out
SUPPORT: Final = {
    "Evaluate": True,
    "Gradient": True,
    "ApplyJacobian": True,
    "ApplyHessian": False,
}
DEFAULT_WAIT_S: Final = 600.0  # a caller of this protocol waits for a simulation, however long
Call = Literal["Evaluate", "Gradient", "ApplyJacobian"]
_VECTOR: Final[dict[str, str]] = {"Gradient": "sens", "ApplyJacobian": "vec"}


class UmBridgeError(Exception):
    """A mistake as the protocol spells it.

    Attributes
    ----------
    kind : str
        ``ModelNotFound``, ``UnsupportedFeature``, ``InvalidInput`` or ``InvalidOutput``.
    status : int
        400 for the caller's mistakes, 500 where there is no output to give.
    """

    def __init__(self, kind: str, message: str) -> None:
        super().__init__(message)
        self.kind, self.status = kind, 500 if kind == "InvalidOutput" else 400

    def body(self) -> dict[str, Any]:
        """Return what the reply says."""
        return {"error": {"type": self.kind, "message": str(self)}}


class Config(Body):
    """What a call's ``config`` may say; a key that is none of these is a mistake."""

    method: str | None = None
    tolerance: ToleranceBody | None = None
    on_thin: Literal["wait", "estimate", "reject"] = "wait"
    wait_s: Seconds = DEFAULT_WAIT_S
    beyond_range: Flag = False


class EvaluateBody(Body):
    """A call's body, for the OpenAPI document; calls are read leniently in all but numbers."""

    name: str
    input: Annotated[
        list[Annotated[list[float], Field(min_length=6, max_length=6)]],
        Field(min_length=1, max_length=1, description="the wrench: N and N·m"),
    ]
    config: Config = Config()


class ProductBody(EvaluateBody):
    """The same with what the derivative is multiplied by: ``sens`` or ``vec``."""

    outWrt: Literal[0] = 0  # noqa: N815  # the protocol's spelling
    inWrt: Literal[0] = 0  # noqa: N815
    sens: list[float] | None = None
    vec: list[float] | None = None


def read_fields(body: bytes) -> dict[str, Any]:
    """Return the object that a body is, whatever content type it came with.

    Raises
    ------
    UmBridgeError
        ``InvalidInput``, if it is no JSON object.
    """
    try:
        fields = orjson.loads(body)
    except orjson.JSONDecodeError as error:
        raise _invalid(f"the body is not valid JSON ({error}); it has no NaN and no Inf") from None
    if not isinstance(fields, dict):
        raise _invalid("the body must be a JSON object")
    return fields


def model_name(fields: dict[str, Any], names: Sequence[str]) -> str:
    """Return the component that a body names.

    Raises
    ------
    UmBridgeError
        ``ModelNotFound``, if it names none of `names`.
    """
    name = fields.get("name")
    if not isinstance(name, str) or name not in names:
        told = f"there is no component {name!r}" if "name" in fields else "the body has no 'name'"
        raise UmBridgeError("ModelNotFound", f"{told}; there are: {', '.join(names)}")
    return name


def read_query(fields: dict[str, Any], call: Call) -> Query:
    """Return the question that a body asks.

    Raises
    ------
    UmBridgeError
        ``InvalidInput``, naming the field.
    """
    config = _config(fields.get("config"))
    inputs = fields.get("input")
    if not isinstance(inputs, list) or len(inputs) != 1:
        raise _invalid("input must be a list of one list, the six numbers Fx Fy Fz Mx My Mz")
    tolerance = config.tolerance
    return Query(
        wrench=tuple(_numbers(inputs[0], "input[0]")),
        on_thin=config.on_thin,
        wait_s=config.wait_s,
        tolerance=Tolerance(tolerance.translation, tolerance.rotation) if tolerance else None,
        method=config.method,
        beyond_range=config.beyond_range,
        derivatives=call != "Evaluate",
    )


def read_direction(fields: dict[str, Any], call: Call) -> NDArray[np.float64] | None:
    """Return what the derivative is multiplied by; None for ``Evaluate``.

    Shape (6,): weights of the outputs, per m and rad, for ``Gradient``; loads, N and N·m, for
    ``ApplyJacobian``.

    Raises
    ------
    UmBridgeError
        ``InvalidInput``, naming the field.
    """
    if call == "Evaluate":
        return None
    for key in ("outWrt", "inWrt"):
        if type(fields.get(key)) is not int or fields[key] != 0:
            raise _invalid(f"{key} must be 0: there is one vector in and one out")
    word = _VECTOR[call]
    return np.array(_numbers(fields.get(word), word))


def output_of(
    call: Call, outcome: Outcome, direction: NDArray[np.float64] | None
) -> list[list[float]] | list[float]:
    """Return what a reply's ``output`` is: u in one list, J^T sens or J vec.

    Displacements and J vec are m and rad; J^T sens is per N and N·m. `direction` has shape (6,).

    Raises
    ------
    UmBridgeError
        ``InvalidOutput``, if there is no answer yet, or part of it is not known.
    """
    if outcome.unsolved:
        raise UmBridgeError("InvalidOutput", _why_unsolved(outcome))
    if direction is None:
        return [_known(outcome.displacement, outcome)]
    derivative = outcome.derivative
    if derivative is None or not np.isfinite(derivative).all():
        told = "the derivative is not known here: the row that answers brings no tangent"
        raise UmBridgeError("InvalidOutput", told)
    told = derivative.T @ direction if call == "Gradient" else derivative @ direction
    if not np.isfinite(told).all():
        raise _invalid(f"{_VECTOR[call]} is too large: the product with the derivative overflows")
    return told.tolist()


def error_of(problem: ProblemError) -> UmBridgeError:
    """Return a refusal of the main call in this protocol's words."""
    detail = str(problem.body["detail"])
    if problem.status == 404:
        return UmBridgeError("ModelNotFound", detail)
    if problem.status >= 500 or problem.status == 424:  # no output: a solve or the ledger failed
        return UmBridgeError("InvalidOutput", detail)
    return _invalid(detail)


def _invalid(message: str) -> UmBridgeError:
    return UmBridgeError("InvalidInput", message)


def _config(fields: Any) -> Config:
    try:
        config = Config.model_validate({} if fields is None else fields)
    except ValidationError as error:
        told = "; ".join(f"config.{one['loc']}: {one['msg']}" for one in plain_errors(error))
        raise _invalid(told) from None
    if config.method is not None and config.method not in METHODS:
        told = f"unknown method {config.method!r}: one of {', '.join(METHODS)}"
        raise _invalid(f"config.method: {told}")
    return config


def _numbers(found: Any, name: str) -> list[float]:
    """Return six finite numbers without negative zeros; a word or a truth is no number."""
    if not isinstance(found, list) or len(found) != 6:
        length = len(found) if isinstance(found, list) else type(found).__name__
        raise _invalid(f"{name} must be a list of six numbers, not {length}")
    for place, number in enumerate(found):
        if type(number) not in (float, int) or not isfinite(number):
            raise _invalid(f"{name}[{place}] must be a finite number, not {number!r}")
    return [float(number) + 0.0 for number in found]


def _known(displacement: tuple[float, ...] | None, outcome: Outcome) -> list[float]:
    numbers = displacement or (None,) * 6
    lost = [name for name, number in zip(OUTPUTS, numbers, strict=True) if not _is_number(number)]
    if lost:
        why = outcome.reason or "no row of the table holds it"
        raise UmBridgeError("InvalidOutput", f"{', '.join(lost)} not known: {why}")
    return list(displacement or ())


def _is_number(number: float | None) -> bool:
    return number is not None and isfinite(number)


def _why_unsolved(outcome: Outcome) -> str:
    if outcome.job is None:
        return f"not solved: {outcome.reason}"
    return (
        f"not solved within config wait_s: job {outcome.job.id} is {outcome.job.status}; ask again "
        "later, with a longer wait_s, or with config on_thin 'estimate'"
    )
