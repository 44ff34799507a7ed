"""Where a request comes from: this server's own page, a program, or a page of another site."""

from __future__ import annotations

from collections.abc import Mapping

from wrenchbook.service.http.door.opening import Opening
from wrenchbook.service.http.problems import ProblemError

# What every site may load or link to: it tells nothing about the tables.
_ANYBODYS = ("/page/",)
_ANYBODY = frozenset({"/", "/docs", "/openapi.json", "/favicon.ico"})


def is_anybodys(method: str, path: str) -> bool:
    """Tell whether a call is open to all: the page's own files, and the document of the calls."""
    return method in ("GET", "HEAD") and (path in _ANYBODY or path.startswith(_ANYBODYS))


def check_host(opening: Opening, head: Mapping[bytes, bytes]) -> None:
    """Refuse a request that names this server as nobody does.

    Raises
    ------
    ProblemError
        403: a page whose name was made to mean this machine calls it by that name.
    """
    if opening.hosts is None:
        return
    host = _name(head.get(b"host", b"").decode("latin-1"))
    if host not in opening.hosts:
        raise ProblemError(
            403,
            "host",
            "This server does not go by that name",
            f"It was asked as {host[:100]!r}. If that is a name of its own, start it with: "
            "wrenchbook serve --allow-host NAME",
        )


def check_site(opening: Opening, head: Mapping[bytes, bytes]) -> None:
    """Refuse a request that a page of another site sends, unless that is listed.

    Programs send none of the fields that tell; browsers send them, and pages cannot change them.

    Raises
    ------
    ProblemError
        403.
    """
    origin = head.get(b"origin")
    if origin is not None:
        told = origin.decode("latin-1").lower()
        if told in opening.origins:
            return
        if told.partition("://")[2] != head.get(b"host", b"").decode("latin-1").lower():
            raise _cross_site(told)
    elif head.get(b"sec-fetch-site", b"none") in (b"cross-site", b"same-site"):
        raise _cross_site("another site")


def _cross_site(origin: str) -> ProblemError:
    return ProblemError(
        403,
        "cross-site",
        "Pages of other sites may not call this server",
        f"The request comes from a page of {origin[:100]}; nothing was changed. If that page is "
        "yours, start the server with: wrenchbook serve --allow-origin "
        f"{origin[:100] if '://' in origin else 'ORIGIN'}",
    )


def _name(host: str) -> str:
    """Return a Host without its port, in lower case."""
    if host.startswith("["):
        return host[1:].partition("]")[0].lower()
    return host.partition(":")[0].lower()
