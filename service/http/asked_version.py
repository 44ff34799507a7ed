"""Which version of a table a question is to: ``?table_version=`` of the displacement calls."""

from __future__ import annotations

from typing import Annotated, Final

from pydantic import Field, ValidationError
from starlette.datastructures import QueryParams

from service.answering.queries import BatchQuery, Query
from service.http.bodies import Body
from service.http.problems import bad_body, plain_errors

NAME: Final = "table_version"
_WAIT = (
    "a solve makes a new version of the table: with table_version ask with on_thin 'queue', "
    "'estimate' or 'reject'"
)


class VersionQuery(Body):
    """The query of a displacement call in JSON; other parameters are refused."""

    table_version: Annotated[
        int | None,
        Field(
            ge=0,
            lt=2**63,
            description="the table as it was: the same answers again, whatever rows have come "
            "since. Nothing is queued then; the newest version if left out",
        ),
    ] = None


def version_of(query: bytes) -> int | None:
    """Return the version that a call's query string names; None for the newest.

    Raises
    ------
    ProblemError
        422, if it is no version, stands twice, or there is anything else in the query.
    """
    return _read(QueryParams(query).multi_items()) if query else None


def split_version(query: QueryParams) -> tuple[int | None, dict[str, str]]:
    """Return the version that a query names, as `version_of`, and all else that it says."""
    named = [pair for pair in query.multi_items() if pair[0] == NAME]
    return _read(named), {name: value for name, value in query.items() if name != NAME}


def _read(pairs: list[tuple[str, str]]) -> int | None:
    if len(pairs) > 1 and all(name == NAME for name, _ in pairs):
        raise bad_body([{"loc": f"query.{NAME}", "msg": "stands more than once; keep one"}])
    try:
        return VersionQuery.model_validate(dict(pairs)).table_version
    except ValidationError as error:
        told = plain_errors(error)
        raise bad_body([{**one, "loc": f"query.{one['loc']}"} for one in told]) from None


def check_version(query: Query | BatchQuery) -> None:
    """Refuse to wait for a solve at an earlier version.

    Raises
    ------
    ProblemError
        422.
    """
    if query.on_thin == "wait":
        raise bad_body([{"loc": "on_thin", "msg": _WAIT}])
