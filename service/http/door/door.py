"""The door: each request passes here before anything of it is read."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence
from math import ceil
from secrets import compare_digest
from typing import Final

from starlette.types import Receive, Send
from starlette.types import Scope as Scope_

from wrenchbook.service.http.body import counted
from wrenchbook.service.http.door.fields import preflight, sending
from wrenchbook.service.http.door.grant import GRANT, OPEN, Grant, grant_of
from wrenchbook.service.http.door.opening import Opening
from wrenchbook.service.http.door.sites import check_host, check_site, is_anybodys
from wrenchbook.service.http.problems import ProblemError
from wrenchbook.service.keys import Keyring, Scope, digest_of
from wrenchbook.service.keys.keyring import LOOK_S
from wrenchbook.service.keys.record import Key

Headers = Sequence[tuple[bytes, bytes]]

_READING: Final = ("GET", "HEAD", "OPTIONS")
_JSON: Final = b"application/json"
_BYTES: Final = b"application/octet-stream"
_BINARY: Final = ("/displacements", "/recording", "/envelope")
# Calls that name what they take themselves: files of many kinds.
_OF_THEIR_OWN: Final = ("/table", "/v1/components")
_OF_OTHERS: Final = "/umbridge/"  # whose clients say whatever their library says
_MOST_KNOWN: Final = 1024
_MOST_HEAD: Final = 2048  # bytes of a head that is worth knowing again
_FOR_ALL: Final = 1e6  # requests a second and MiB: no limits


class Door:
    """Who is let in.

    Parameters
    ----------
    keyring : Keyring
        The keys there are.
    opening : Opening
        How it stands.
    """

    def __init__(self, keyring: Keyring, opening: Opening) -> None:
        self.opening = opening
        self.keyring = keyring
        self._grants: dict[str, Grant] = {}
        self._known: dict[Headers, Grant] = {}
        self._last: Headers | None = None
        self._last_grant = OPEN
        self._version = keyring.version

    @property
    def keys_needed(self) -> bool:
        """Whether nobody is let in without a key."""
        return self.opening.keys_needed or len(self.keyring) > 0

    def admit(self, headers: Headers) -> Grant | None:
        """Count a query of the fast path; return its grant, or None where `check` has to decide.

        A head that was let in is known by its fields until a key changes.
        """
        if headers is self._last:  # a loop asks with one head, again and again
            known = self._last_grant
        else:
            known = self._admitted(tuple(headers))
            if known is None:
                return None
            self._last, self._last_grant = headers, known
        return known if known.key is None or known.wait() == 0.0 else None

    def _admitted(self, headers: Headers) -> Grant | None:
        """Return the grant of a plain question; None where there is anything to be told."""
        self._look()
        known = self._known.get(headers)
        if known is None:
            known = self._plain(headers)
            if known is None:
                return None
            if len(self._known) >= _MOST_KNOWN:
                self._known.clear()
            if sum(len(name) + len(value) for name, value in headers) <= _MOST_HEAD:
                self._known[headers] = known
        return known

    async def watch(self) -> None:
        """Take up changed keys from time to time, for those who are known by their heads."""
        while True:
            await asyncio.sleep(LOOK_S)
            self._look()

    async def pass_on(
        self, scope: Scope_, receive: Receive, send: Send
    ) -> tuple[Receive, Send] | None:
        """Let a request in and return what it goes on with, or answer it and return None."""
        head = dict(scope["headers"])
        origin = head.get(b"origin")
        listed = None
        if origin is not None and origin.decode("latin-1").lower() in self.opening.origins:
            listed = origin
        send = sending(send, scope["path"], listed)
        if listed and scope["method"] == "OPTIONS" and b"access-control-request-method" in head:
            await send({"type": "http.response.start", "status": 204, "headers": preflight(listed)})
            await send({"type": "http.response.body", "body": b""})
            return None
        try:
            if GRANT not in scope:  # the fast path has admitted and counted it already
                self.check(scope)
        except ProblemError as refused:
            await refused.response()(scope, receive, send)
            return None
        most = grant_of(scope).most_bytes
        if most is not None and b"transfer-encoding" in head:
            receive = counted(receive, most)
        return receive, send

    def check(self, scope: Scope_) -> None:
        """Let a request in, and note what whoever sent it may do.

        Raises
        ------
        ProblemError
            401, 403, 413, 415 or 429; nothing of the body was read.
        """
        method, path, head = scope["method"], scope["path"], dict(scope["headers"])
        check_host(self.opening, head)
        if is_anybodys(method, path):
            return
        check_site(self.opening, head)
        grant = self._grant(head)
        scope[GRANT] = grant
        needed = _needed(method, path)
        if not grant.allows(needed):
            raise beyond_scope(grant, needed)
        if (seconds := grant.wait()) > 0.0:
            raise _too_often(grant, seconds)
        _check_length(grant, head)
        if method not in _READING and _has_body(head):
            _check_kind(path, head)

    def _plain(self, headers: Headers) -> Grant | None:
        """Look at a plain question's head for the first time, as `_admitted` does."""
        head = dict(headers)
        if b"origin" in head or _kind(head) not in (_JSON, b""):
            return None
        try:
            check_host(self.opening, head)
            check_site(self.opening, head)
            grant = self._grant(head)
        except ProblemError:
            return None
        return grant if grant.allows("write") else None

    def _grant(self, head: Mapping[bytes, bytes]) -> Grant:
        self._look()
        if not self.keys_needed:
            return OPEN
        word, _, secret = head.get(b"authorization", b"").decode("latin-1").partition(" ")
        secret = secret.strip()
        if word.lower() != "bearer" or not secret:
            raise _no_key("This server needs a key, and the request has none.")
        grant = self._grants.get(secret)
        if grant is None:
            key = self._key(secret)
            if key is None:
                raise _no_key("The request's key is none of this server's; it may be revoked.")
            grant = self._grants[secret] = Grant(key)
        return grant

    def _key(self, secret: str) -> Key | None:
        own = self.opening.own_key
        if own is not None and compare_digest(secret.encode(), own.encode()):
            return Key("own", "admin", digest_of(own), 0.0, _FOR_ALL, int(_FOR_ALL))
        return self.keyring.find(secret)

    def _look(self) -> None:
        """Forget who was let in once a key has changed."""
        if self.keyring.look() == self._version:
            return
        self._version = self.keyring.version
        self._last = None
        self._known.clear()
        self._grants.clear()


def beyond_scope(grant: Grant, needed: Scope) -> ProblemError:
    """Return the refusal of what a key is not for."""
    assert grant.key is not None
    also = ""
    if needed == "write":
        also = " A displacement with on_thin 'estimate' or 'reject' needs no more than read."
    return ProblemError(
        403,
        "scope",
        "The key is not for this",
        f"The key {grant.key.name!r} is for {grant.key.scope}, this call needs {needed}; nothing "
        f"was changed.{also} Make another with: wrenchbook keys add NAME --scope {needed}",
    )


def _needed(method: str, path: str) -> Scope:
    if path == "/v1/keys" or path.startswith("/v1/keys/"):
        return "admin"
    # Whether a displacement queues anything stands in its body, which is looked at there.
    asks = path.startswith("/v1/components/") and path.endswith(("/displacement", "/displacements"))
    return "read" if method in _READING or (method == "POST" and asks) else "write"


def _has_body(head: Mapping[bytes, bytes]) -> bool:
    return head.get(b"content-length", b"0") != b"0" or b"transfer-encoding" in head


def _kind(head: Mapping[bytes, bytes]) -> bytes:
    return head.get(b"content-type", b"").partition(b";")[0].strip().lower()


def _check_kind(path: str, head: Mapping[bytes, bytes]) -> None:
    """Refuse what a page may send without asking first: a form, or text, that is JSON inside.

    A program may leave the type out. A browser tells the site of whatever it sends, and from there
    not even that is taken.
    """
    kind = _kind(head)
    if path.endswith(_OF_THEIR_OWN) or not (kind or b"origin" in head):
        return
    if path.startswith(_OF_OTHERS) and b"origin" not in head:
        return
    taken = (_JSON, _BYTES) if path.endswith(_BINARY) else (_JSON,)
    if kind not in taken:
        raise ProblemError(
            415,
            "media-type",
            "Not a form this call takes",
            f"The content type is {kind.decode('latin-1')[:100] or 'missing'}. Send the header "
            f"Content-Type: {' or '.join(one.decode() for one in taken)} (curl: --json, or -H).",
        )


def _check_length(grant: Grant, head: Mapping[bytes, bytes]) -> None:
    most, length = grant.most_bytes, head.get(b"content-length", b"0")
    if most is not None and length.isdigit() and int(length[:20]) > most:
        raise _too_large(most)


def _too_large(most: int) -> ProblemError:
    detail = f"This key may send at most {most >> 20} MiB at once; nothing was changed. Send parts."
    return ProblemError(413, "too-large", "The body is too large", detail)


def _too_often(grant: Grant, seconds: float) -> ProblemError:
    assert grant.key is not None
    return ProblemError(
        429,
        "rate",
        "The key is used too often",
        f"The key {grant.key.name!r} may ask {grant.key.rate:g} times a second; nothing was "
        "changed. Ask for many wrenches at once with POST .../displacements, or more slowly.",
        headers={"Retry-After": str(ceil(seconds))},
    )


def _no_key(why: str) -> ProblemError:
    return ProblemError(
        401,
        "key",
        "A key is needed",
        f"{why} Send the header Authorization: Bearer KEY; wrenchbook's own client takes "
        "key=, its commands the variable WRENCHBOOK_KEY. Whoever runs the server makes one with: "
        "wrenchbook keys add NAME",
        headers={"WWW-Authenticate": 'Bearer realm="wrenchbook"'},
    )
