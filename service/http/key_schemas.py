"""How the calls about keys are described for the OpenAPI document."""

from __future__ import annotations

from typing import Final

from service.http.call import JSON, Call
from service.http.routes.keys import KeyBody
from service.http.schemas import OBJECT, body_of

KEY_CALLS: Final[dict[tuple[str, str], Call]] = {
    ("get", "/v1/keys"): Call({200: "the keys, without their secrets"}, (409,), {JSON: OBJECT}),
    ("post", "/v1/keys"): Call(
        {201: "made; `key` is its secret, told this once"},
        (409, 422),
        {JSON: OBJECT},
        {JSON: body_of(KeyBody)},
    ),
}
