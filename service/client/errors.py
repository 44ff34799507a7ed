"""The client's errors and warnings; each message has a remedy."""

from __future__ import annotations

import importlib
import sys
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeAlias

Json: TypeAlias = Any  # a value of a JSON document
Document = dict[str, Json]

_SHOWN = 5  # mistakes in the text of a ProblemError: more would hide its remedy
# Beginnings of messages, for one column and for several.
_PLURALS = {"is not a known column": "are not known columns", "is ": "are ", "has ": "have "}
_FOLDER = str(Path(__file__).parent)


class WrenchbookError(Exception):
    """The base of all errors that `Client`, `AsyncClient`, `Table` and `Mount` raise themselves."""


class InvalidArgument(WrenchbookError, ValueError):  # noqa: N818 (as below)
    """An argument is not valid; nothing was sent, and the message states valid values."""


class TableError(WrenchbookError, ValueError, RuntimeError):
    """A packed table cannot be opened, or the compiled kernel is missing."""


class MissingPackage(WrenchbookError, ImportError):  # noqa: N818 (as below)
    """A call needs a package that is not installed; the message has the command to install it."""


class ProblemError(WrenchbookError):
    """The server refused a call; the text says what to do.

    Parameters
    ----------
    status : int
        HTTP status.
    title, detail : str
        What is wrong, in short; what exactly, and what to do.
    errors : list of dict
        The mistakes one by one: ``{loc, msg}`` of a body, ``{row, field, message}`` of a table.
    body : dict, optional
        The whole ``application/problem+json`` answer, with members such as ``job``.

    Attributes
    ----------
    retry_after : float or None
        Seconds after which the server may take the request, if it names a time.
    """

    retry_after: float | None = None

    def __init__(
        self,
        status: int,
        title: str,
        detail: str = "",
        errors: list[Document] | None = None,
        body: Document | None = None,
    ) -> None:
        super().__init__(status, title, detail)
        self.status = status
        self.title = title
        self.detail = detail
        self.errors = errors or []
        self.body = body or {}

    @property
    def causes(self) -> list[Document]:
        """The mistakes by cause, without a single one that the detail states."""
        first, *more = causes = self.body.get("causes", self.errors) or [{}]
        text = str(first.get("msg") or first.get("message", ""))
        return causes if more or first.get("count", 1) > 1 or text not in self.detail else []

    def __str__(self) -> str:
        lines = [f"{self.status} {self.title}"]
        if self.detail:
            lines[0] += f": {self.detail}"
        mistakes = self.causes
        lines += [f"  {mistake_line(mistake)}" for mistake in mistakes[:_SHOWN]]
        if len(mistakes) > _SHOWN:
            lines.append(f"  and {len(mistakes) - _SHOWN} more")
        return "\n".join(lines)


class ServerUnreachable(WrenchbookError, ConnectionError):  # noqa: N818 (a state of the world, and a public name)
    """Nothing answers at the address, or the server ended the connection before its reply."""

    refused = False  # whether the connection was refused: the server has not received the request


class ServerTimeout(WrenchbookError, TimeoutError):  # noqa: N818 (as above)
    """The server, or a job, took longer than the timeout."""


class MountError(WrenchbookError, RuntimeError):
    """A mount cannot continue; its pose is unchanged."""


class SensorError(MountError):
    """The reading of the simulation cannot be the wrench on the component."""


class SourceError(MountError, TypeError):
    """The source of a mount is neither a table nor a client that the mode can use."""


class DisplacementUnknown(MountError):  # noqa: N818 (a state of the table, and a public name)
    """The component's table cannot answer, or lacks an output that the pose needs."""


class CouplingDiverged(MountError):  # noqa: N818 (the public name)
    """Scene and component drive each other apart instead of to an equilibrium.

    Parameters
    ----------
    message : str
        What happened, and the remedy.
    residuals : sequence of float
        How far pose and answer were apart, iteration by iteration, in tolerances.
    spectral_radius : float, optional
        G, the spectral radius of compliance times the scene's stiffness, where it is known.
    """

    def __init__(
        self, message: str, residuals: Sequence[float] = (), spectral_radius: float | None = None
    ) -> None:
        super().__init__(message)
        self.residuals = tuple(residuals)
        self.spectral_radius = spectral_radius


class MountWarning(UserWarning):
    """The loop continues, with numbers that may be wrong; issued once for each mount and kind."""


class JointError(WrenchbookError, RuntimeError):
    """A joint cannot continue, or its scene cannot have a joint."""


class JointRangeError(JointError):
    """The relative pose is far beyond the range of the part."""


class JointWarning(UserWarning):
    """The run continues, but numbers may be wrong; issued once for each joint and kind."""


def warn(message: str, category: type[Warning]) -> None:
    """Issue a warning at the line of the user's program that called the client."""
    level = 1
    caller = sys._getframe()
    while caller is not None and caller.f_code.co_filename.startswith(_FOLDER):
        level = level + 1
        caller = caller.f_back
    warnings.warn(message, category, stacklevel=level)


def required(module: str, user: str, install: str) -> Any:
    """Return a module; `install` is pip's name of it, `user` the call that needs it.

    Raises MissingPackage if the module is not installed.
    """
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        name = (error.name or module).partition(".")[0]  # the module, or a module that it imports
        raise MissingPackage(
            f"{user} needs the package {name!r}, which is not installed; run: pip install "
            f"{install}",
            name=name,
        ) from error


def mistake_line(error: Document) -> str:
    """Return a line on one mistake of a body, or on one or all mistakes of a cause in a table."""
    if "row" in error:
        count = error.get("count", 1)
        fields = ", ".join(error.get("fields") or [error.get("field", "")])
        more = f" ({count} mistakes)" if count > 1 else ""
        rows = error.get("rows") or [error["row"]]
        # 0: the mistake concerns the file, or a column.
        place = f"row{'s' * (len(rows) > 1)} {', '.join(map(str, rows))}, " * bool(error["row"])
        message = error.get("message", "")
        if len(error.get("fields") or ()) > 1:
            for singular, plural in _PLURALS.items():
                if message.startswith(singular):
                    message = plural + message.removeprefix(singular)
                    break
        return f"{place}{fields}: {message}{more}"
    return f"{error.get('loc', '')}: {error.get('msg', '')}"
