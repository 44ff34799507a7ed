"""The calls of the UM-Bridge protocol, for the OpenAPI document."""

from __future__ import annotations

from typing import Final

from service.http import umbridge
from service.http.call import JSON, Call
from service.http.schemas import OBJECT, TEXT, Schema, body_of

_KINDS: Final = ["ModelNotFound", "UnsupportedFeature", "InvalidInput", "InvalidOutput"]


def _object(**fields: Schema) -> Schema:
    return {"type": "object", "required": list(fields), "properties": fields}


_ERROR: Final = _object(error=_object(type={"enum": _KINDS}, message=TEXT))
_NAMED: Final = _object(name=TEXT)
_SIZES: Final[Schema] = {"type": "array", "items": {"type": "integer"}}
_VECTOR: Final[Schema] = {"type": "array", "items": {"type": "number"}, "minItems": 6}


def _call(output: Schema, body: Schema = _NAMED) -> Call:
    """Return a call of the protocol, which has errors of its own form."""
    told = {200: "the answer", 400: "a mistake of the caller's", 500: "there is no output to give"}
    return Call(told, (), {JSON: {"anyOf": [output, _ERROR]}}, {JSON: body}, always=())


_PRODUCT: Final = _call(_object(output=_VECTOR), body_of(umbridge.ProductBody))
UMBRIDGE_CALLS: Final[dict[tuple[str, str], Call]] = {
    ("get", "/umbridge/Info"): Call({200: "the components"}, (), {JSON: OBJECT}, always=()),
    ("post", "/umbridge/ModelInfo"): _call(_object(support=OBJECT)),
    ("post", "/umbridge/InputSizes"): _call(_object(inputSizes=_SIZES)),
    ("post", "/umbridge/OutputSizes"): _call(_object(outputSizes=_SIZES)),
    ("post", "/umbridge/Evaluate"): _call(
        _object(output={"type": "array", "items": _VECTOR, "minItems": 1}),
        body_of(umbridge.EvaluateBody),
    ),
    ("post", "/umbridge/Gradient"): _PRODUCT,
    ("post", "/umbridge/ApplyJacobian"): _PRODUCT,
    ("post", "/umbridge/ApplyHessian"): _call(_ERROR),
}
