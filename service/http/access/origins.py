"""Checks of Host and Origin: calls by other names, and by pages of other sites, are refused."""

from __future__ import annotations

from collections.abc import Mapping

from wrenchbook.service.http.access.security import SecuritySettings
from wrenchbook.service.http.problems import HttpProblemError

# Open to every site and without a key: these files contain nothing of the tables.
_PUBLIC_FOLDERS = ("/page/",)
_PUBLIC = frozenset({"/", "/docs", "/openapi.json", "/favicon.ico", "/health/live"})


def is_public(method: str, path: str) -> bool:
    """Return whether a call needs no key: the page's files, the document, a liveness probe."""
    return method in ("GET", "HEAD") and (path in _PUBLIC or path.startswith(_PUBLIC_FOLDERS))


def check_host(security: SecuritySettings, head: Mapping[bytes, bytes]) -> None:
    """Refuse a request whose Host is not allowed (DNS rebinding).

    Raises
    ------
    HttpProblemError
        403.
    """
    if security.hosts is None:
        return
    host = _name(head.get(b"host", b"").decode("latin-1"))
    if host not in security.hosts:
        raise HttpProblemError(
            403,
            "host",
            "The host is not allowed",
            f"Host {host[:100]!r} is not allowed. If it is a name of this server, start it with: "
            "wrenchbook serve --allow-host NAME",
        )


def check_origin(security: SecuritySettings, head: Mapping[bytes, bytes]) -> None:
    """Refuse a request of another site's page, unless `allow-origin` lists the site.

    Programs send neither Origin nor Sec-Fetch-Site; browsers do, and pages cannot change them.

    Raises
    ------
    HttpProblemError
        403.
    """
    origin = head.get(b"origin")
    if origin is not None:
        site = origin.decode("latin-1").lower()
        if site in security.origins:
            return
        if site.partition("://")[2] != head.get(b"host", b"").decode("latin-1").lower():
            raise _cross_site(site)
    elif head.get(b"sec-fetch-site", b"none") in (b"cross-site", b"same-site"):
        raise _cross_site("another site")


def _cross_site(origin: str) -> HttpProblemError:
    return HttpProblemError(
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
