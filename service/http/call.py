"""How one call is described for the OpenAPI document."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from service.http.schemas import Schema

JSON: Final = "application/json"
REFUSALS: Final[dict[int, str]] = {
    401: "this server needs a key, and the request has none of its own",
    403: "the key is not for this call, or a page of another site sends it",
    404: "there is no such component, job or row",
    409: "it cannot be done as things are; the detail says why",
    410: "rows of that version are damaged on the disk",
    413: "the body is too large",
    415: "a content type that this call does not take",
    422: "the request has mistakes; nothing was changed",
    424: "the solve of this wrench failed",
    429: "the key is used more often than it may be; Retry-After says when",
    500: "the server made a mistake; its log has the traceback",
    503: "the ledger cannot be read or written now; nothing was changed",
    507: "the disk is full; nothing was changed",
}
_DOOR: Final = (401, 403, 413, 429)  # what any call may be refused with before it is read
_SITES: Final = (403,)  # what it may be refused with where no key is needed
_ALWAYS: Final = (500, 503, 507)  # what any call may come to that asks the ledger


@dataclass(frozen=True)
class Call:
    """One call.

    Attributes
    ----------
    answers : mapping of int to str
        What each status means that is not a problem.
    refusals : tuple of int
        The statuses that are problems, keys of `REFUSALS`.
    always : tuple of int
        Those of them that need no naming: 500, 503 and 507; without any, it is a call of another
        protocol, which knows nothing of what the door refuses with either.
    replies : mapping of str to schema
        What success answers, by content type; what FastAPI says of it if empty.
    bodies : mapping of str to schema
        What it takes, by content type.
    parameters : tuple of dict
        Query parameters that the call reads by hand.
    """

    answers: Mapping[int, str]
    refusals: tuple[int, ...] = ()
    replies: Mapping[str, Schema] = field(default_factory=dict)
    bodies: Mapping[str, Schema] = field(default_factory=dict)
    parameters: tuple[dict[str, Any], ...] = ()
    always: tuple[int, ...] = _ALWAYS

    def all_refusals(self, *, keys: bool) -> tuple[int, ...]:
        """Return all statuses that are problems, in order; those of the door by its keys."""
        if not self.always:
            return tuple(sorted(self.refusals))
        door = (*(_DOOR if keys else _SITES), *((415,) if self.bodies else ()))
        return tuple(sorted({*door, *self.refusals, *self.always}))
