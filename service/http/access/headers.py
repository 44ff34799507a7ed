"""The fields that every reply carries, so that a browser does no more with it than it should."""

from __future__ import annotations

from starlette.types import Message, Send

_NOTHING = b"default-src 'none'; frame-ancestors 'none'; sandbox"
# The page's scripts and styles are files of this server; plotly sets styles and makes pictures.
_PAGE = (
    b"default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; "
    b"img-src 'self' data: blob:; font-src 'self' data:; connect-src 'self'; worker-src 'self' "
    b"blob:; manifest-src 'self'; form-action 'self'; base-uri 'none'; frame-ancestors 'none'"
)
# A report carries its own script, and runs it as a page of no site: it cannot call the server.
_REPORT = (
    b"default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; "
    b"img-src data: blob:; frame-ancestors 'none'; sandbox allow-scripts allow-downloads"
)
_ALWAYS = (
    (b"x-content-type-options", b"nosniff"),
    (b"x-frame-options", b"DENY"),
    (b"referrer-policy", b"no-referrer"),
    (b"cross-origin-opener-policy", b"same-origin"),
)
_MAIN = "/displacement"
PLAIN = b"x-content-type-options: nosniff\r\n"
"""Header fields of an answer of the fast path: JSON that no browser requests by itself."""

_EXPOSED = b"location, link, etag, retry-after, x-request-id"


def sending(send: Send, path: str, origin: bytes | None) -> Send:
    """Return a `send` that puts these fields into each reply that does not set them.

    Parameters
    ----------
    send : callable
        The server's.
    path : str
        Of the request.
    origin : bytes or None
        A listed site, whose pages may read the reply.
    """

    async def put(message: Message) -> None:
        if message["type"] == "http.response.start":
            fields = list(message.get("headers", ()))
            there = {name.lower() for name, _ in fields}
            # The main call's reply is the same whichever way it went.
            always = _ALWAYS[:1] if path.endswith(_MAIN) and not origin else _ALWAYS
            more = (*always, *_of(path, fields), *_across(origin, path))
            fields += [one for one in more if one[0] not in there]
            message = {**message, "headers": fields}
        await send(message)

    return put


def _of(path: str, fields: list[tuple[bytes, bytes]]) -> tuple[tuple[bytes, bytes], ...]:
    """Return the fields that go by what is replied."""
    kind = next((value for name, value in fields if name.lower() == b"content-type"), b"")
    if path.endswith(_MAIN):
        return ()
    if path.startswith("/v1/"):
        policy = _REPORT if kind.startswith(b"text/html") else _NOTHING
        # Other users of the same machine must not read the tables of a key from a cache.
        return (b"content-security-policy", policy), (b"cache-control", b"no-store")
    return ((b"content-security-policy", _PAGE),)


def _across(origin: bytes | None, path: str = "") -> tuple[tuple[bytes, bytes], ...]:
    """Return what lets a page of another site read the reply, or keeps it from that."""
    if origin is None:
        if path.endswith(_MAIN):
            return ()
        return ((b"cross-origin-resource-policy", b"same-origin"),)
    return (
        (b"access-control-allow-origin", origin),
        (b"access-control-expose-headers", _EXPOSED),
        (b"cross-origin-resource-policy", b"cross-origin"),
        (b"vary", b"Origin"),
    )


def preflight(origin: bytes) -> list[tuple[bytes, bytes]]:
    """Return the headers of a preflight's reply, for a page of an allowed origin."""
    return [
        *_across(origin),
        (b"access-control-allow-methods", b"GET, POST, DELETE"),
        (
            b"access-control-allow-headers",
            b"authorization, content-type, if-none-match, accept, x-request-id",
        ),
        (b"access-control-max-age", b"600"),
        (b"content-length", b"0"),
    ]
