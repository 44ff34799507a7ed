"""What can go wrong between a simulator and the server."""

from __future__ import annotations

from typing import Any

_SHOWN = 5


class WrenchbookError(Exception):
    """The base of all errors that `Client`, `AsyncClient`, `Table` and `Mount` raise themselves."""


class InvalidArgument(WrenchbookError, ValueError):  # noqa: N818 (as below)
    """An argument is not valid; nothing was sent, and the text says what is valid."""


class TableError(WrenchbookError, ValueError, RuntimeError):
    """A packed table cannot be opened, or the compiled code that answers from it is not there."""


class MissingPackage(WrenchbookError, ImportError):  # noqa: N818 (as below)
    """A call needs a package that is not installed; the text says how to install it."""


class ProblemError(WrenchbookError):
    """The server refused a call; the text says what to do.

    Parameters
    ----------
    status : int
        HTTP status.
    title, detail : str
        What is wrong in a few words; what exactly, and what to do.
    errors : list of dict
        The mistakes one by one: ``{loc, msg}`` of a body, ``{row, field, message}`` of a table.
    body : dict, optional
        The whole ``application/problem+json`` answer, with members such as ``job``.

    Attributes
    ----------
    retry_after : float or None
        Seconds after which the server may take the request, where it tells.
    """

    retry_after: float | None = None

    def __init__(
        self,
        status: int,
        title: str,
        detail: str = "",
        errors: list[dict[str, Any]] | None = None,
        body: dict[str, Any] | None = None,
    ) -> None:
        super().__init__(status, title, detail)
        self.status = status
        self.title = title
        self.detail = detail
        self.errors = errors or []
        self.body = body or {}

    def __str__(self) -> str:
        lines = [f"{self.status} {self.title}"]
        if self.detail:
            lines[0] += f": {self.detail}"
        mistakes = self.body.get("causes", self.errors)
        lines += [f"  {mistake_line(one)}" for one in mistakes[:_SHOWN]]
        if len(mistakes) > _SHOWN:
            lines.append(f"  and {len(mistakes) - _SHOWN} more")
        return "\n".join(lines)


class ServerUnreachable(WrenchbookError, ConnectionError):  # noqa: N818 (a state of the world, and a public name)
    """Nothing answers at the address; the text says how to start a server."""

    refused = False  # whether the connection was refused: the server has not seen the request


class ServerTimeout(WrenchbookError, TimeoutError):  # noqa: N818 (as above)
    """The server, or a job, took longer than the timeout."""


def mistake_line(error: dict[str, Any]) -> str:
    """Lay out one mistake of a body, or one or all of a cause of a table."""
    if "row" in error:
        count = error.get("count", 1)
        fields = ", ".join(error.get("fields") or [error.get("field", "")])
        more = f" ({count} mistakes)" if count > 1 else ""
        return f"row {error['row']}, {fields}: {error.get('message', '')}{more}"
    return f"{error.get('loc', '')}: {error.get('msg', '')}"
