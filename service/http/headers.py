"""Security headers of replies: content policies, framing, and access by other sites (CORS)."""

from __future__ import annotations

import re
from typing import Final

from starlette.types import Message, Send

# Header lines of a reply of the fast path, as text: it is JSON, which no browser shows by itself.
PLAIN: Final = b"x-content-type-options: nosniff\r\n"
MAIN_CALL: Final = re.compile(r"/v1/components/[^/]+/displacement")
QUERY: Final = re.compile(MAIN_CALL.pattern + "s?")  # by POST, but it writes nothing by itself

Fields = tuple[tuple[bytes, bytes], ...]

_NOTHING: Final = b"default-src 'none'; frame-ancestors 'none'; sandbox"
# The page's scripts and styles are files of this server; plotly sets styles and makes pictures.
_PAGE: Final = (
    b"default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; "
    b"img-src 'self' data: blob:; font-src 'self' data:; connect-src 'self'; worker-src 'self' "
    b"blob:; manifest-src 'self'; form-action 'self'; base-uri 'none'; frame-ancestors 'none'"
)
# A report has inline scripts. The sandbox gives it no origin, so that it cannot call the server.
_REPORT: Final = (
    b"default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; "
    b"img-src data: blob:; frame-ancestors 'none'; sandbox allow-scripts allow-downloads"
)
_ALWAYS: Final[Fields] = (
    (b"x-content-type-options", b"nosniff"),
    (b"x-frame-options", b"DENY"),
    (b"referrer-policy", b"no-referrer"),
    (b"cross-origin-opener-policy", b"same-origin"),
)
_SAME_ORIGIN: Final[Fields] = ((b"cross-origin-resource-policy", b"same-origin"),)
_PREFLIGHT: Final[Fields] = (  # for 600 s a browser sends no other preflight
    (b"access-control-allow-methods", b"GET, POST, PUT, DELETE"),
    (
        b"access-control-allow-headers",
        b"authorization, content-type, if-none-match, accept, x-request-id",
    ),
    (b"access-control-max-age", b"600"),
    (b"content-length", b"0"),
)


async def send_preflight(send: Send, origin: bytes) -> None:
    """Answer the preflight of a page of a listed site (Fetch standard, section 3.2)."""
    fields = [*_allow(origin), *_PREFLIGHT]
    await send({"type": "http.response.start", "status": 204, "headers": fields})
    await send({"type": "http.response.body", "body": b""})


def with_security_headers(send: Send, path: str, origin: bytes | None) -> Send:
    """Return a `send` that adds security headers to replies of `path` that do not set them.

    `origin` is a listed site, whose pages may read the reply.
    """
    is_main = MAIN_CALL.fullmatch(path) is not None
    common, readers = _ALWAYS, _SAME_ORIGIN
    if origin is not None:
        readers = _allow(origin)
    elif is_main:  # the same headers as on the fast path
        common, readers = _ALWAYS[:1], ()

    async def send_with_headers(message: Message) -> None:
        if message["type"] == "http.response.start":
            fields = list(message.get("headers", ()))
            present = {name.lower(): value for name, value in fields}
            policies: Fields = ()
            if not is_main and path.startswith("/v1/"):
                is_report = present.get(b"content-type", b"").startswith(b"text/html")
                policy = _REPORT if is_report else _NOTHING
                # Other users of the same machine must not read the tables of a key from a cache.
                policies = (b"content-security-policy", policy), (b"cache-control", b"no-store")
            elif not is_main:
                policies = ((b"content-security-policy", _PAGE),)
            added = (*common, *policies, *readers)
            # A reply may have several Vary.
            fields += [one for one in added if one[0] not in present or one[0] == b"vary"]
            message = {**message, "headers": fields}
        await send(message)

    return send_with_headers


def _allow(origin: bytes) -> Fields:
    """Return headers that allow pages of a listed site to read the reply."""
    return (
        (b"access-control-allow-origin", origin),
        (b"access-control-expose-headers", b"location, link, etag, retry-after, x-request-id"),
        (b"cross-origin-resource-policy", b"cross-origin"),
        (b"vary", b"Origin"),
    )
