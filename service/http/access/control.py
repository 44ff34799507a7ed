"""Access control of every request, before anything of its body is read."""

from __future__ import annotations

from collections.abc import Mapping
from math import ceil
from secrets import compare_digest
from typing import Any, Final
from weakref import WeakKeyDictionary

from starlette.types import Receive, Send
from starlette.types import Scope as Scope_

from wrenchbook.service.events import Listener
from wrenchbook.service.http.access.headers import preflight, sending
from wrenchbook.service.http.access.origins import check_host, check_origin, is_public
from wrenchbook.service.http.access.permission import (
    OPEN,
    PERMISSION,
    Permission,
    Rates,
    permission_of,
)
from wrenchbook.service.http.access.security import SecuritySettings
from wrenchbook.service.http.body import counted
from wrenchbook.service.http.problems import HttpProblemError
from wrenchbook.service.keys import Key, Keyring, Scope, digest_of

_READING: Final = ("GET", "HEAD", "OPTIONS")
_JSON: Final = b"application/json"
_BYTES: Final = b"application/octet-stream"
_BINARY: Final = ("/displacements", "/recording", "/envelope")
# Calls that name what they take themselves: files of many kinds.
_ANY_TYPE: Final = ("/table", "/v1/components")
_UMBRIDGE: Final = "/umbridge/"  # clients send the content type of their library
_NO_LIMIT: Final = 1e6  # requests a second and MiB: no limits


class AccessControl:
    """Authentication, rate limits and origin checks of every request.

    Parameters
    ----------
    keyring : Keyring
        The keys of the data directory.
    security : SecuritySettings
        Allowed hosts and origins, and whether keys are needed.
    rates : Rates, optional
        What keys may send now, shared by the web workers of a server; of this process if None.
    """

    def __init__(
        self, keyring: Keyring, security: SecuritySettings, rates: Rates | None = None
    ) -> None:
        self.security = security
        self.keyring = keyring
        self._rates = rates or Rates()
        own = digest_of(security.own_key or "")
        self._own = Key("own", "admin", own, 0.0, _NO_LIMIT, int(_NO_LIMIT))
        self._permissions: dict[str, Permission] = {}
        self._streams: WeakKeyDictionary[Listener, Permission] = WeakKeyDictionary()
        self.heads: dict[bytes, Any] = {}  # cache of the fast path, emptied once a key changes
        self._version = keyring.version

    @property
    def keys_needed(self) -> bool:
        """Whether every call needs a key."""
        return self.security.keys_needed or len(self.keyring) > 0

    def admit(self, path: str, head: Mapping[bytes, bytes]) -> Permission | None:
        """Return the permission of a query of the fast path; None for the ordinary path.

        The fast path counts each query itself, and sends neither refusals nor CORS headers; what a
        key without the scope `write` may ask depends on the body.
        """
        try:
            permission = self.check("POST", path, head, counts=False)
        except HttpProblemError:
            return None
        return permission if permission.allows("write") and b"origin" not in head else None

    def end_with_key(self, listener: Listener, permission: Permission) -> None:
        """End a listener of events once its key is revoked or changed."""
        self._streams[listener] = permission
        if not self._holds(permission):  # since it was permitted
            listener.end()

    async def pass_on(
        self, scope: Scope_, receive: Receive, send: Send
    ) -> tuple[Receive, Send] | None:
        """Return a permitted request's `receive` and `send`; answer any other and return None."""
        head = dict(scope["headers"])
        origin = head.get(b"origin")
        listed = None
        if origin is not None and origin.decode("latin-1").lower() in self.security.origins:
            listed = origin
        send = sending(send, scope["path"], listed)
        if listed and scope["method"] == "OPTIONS" and b"access-control-request-method" in head:
            await send({"type": "http.response.start", "status": 204, "headers": preflight(listed)})
            await send({"type": "http.response.body", "body": b""})
            return None
        try:
            if PERMISSION not in scope:  # the fast path has admitted and counted it already
                scope[PERMISSION] = self.check(scope["method"], scope["path"], head)
        except HttpProblemError as refused:
            await refused.response()(scope, receive, send)
            return None
        most = permission_of(scope).most_bytes
        if most is not None and b"transfer-encoding" in head:
            receive = counted(receive, most)
        return receive, send

    def check(
        self, method: str, path: str, head: Mapping[bytes, bytes], *, counts: bool = True
    ) -> Permission:
        """Return the permission of a request by its head; `counts`: it is one of its key's rate.

        Raises
        ------
        HttpProblemError
            401, 403, 413, 415 or 429; nothing of the body was read.
        """
        check_host(self.security, head)
        if is_public(method, path):
            return OPEN
        check_origin(self.security, head)
        permission = self._permission(head)
        needed = _needed(method, path)
        if not permission.allows(needed):
            raise beyond_scope(permission, needed)
        if counts and (seconds := permission.wait()) > 0.0:
            raise _too_often(permission, seconds)
        _check_length(permission, head)
        if method not in _READING and _has_body(head):
            _check_kind(path, head)
        return permission

    def _permission(self, head: Mapping[bytes, bytes]) -> Permission:
        self.refresh()
        if not self.keys_needed:
            return OPEN
        word, _, secret = head.get(b"authorization", b"").decode("latin-1").partition(" ")
        secret = secret.strip()
        if word.lower() != "bearer" or not secret:
            raise _no_key("This server needs a key, and the request has none.")
        permission = self._permissions.get(secret)
        if permission is None:
            key = self._key(secret)
            if key is None:
                raise _no_key("The request's key is none of this server's; it may be revoked.")
            permission = self._permissions[secret] = Permission(key, self._rates)
        return permission

    def _key(self, secret: str) -> Key | None:
        own = self.security.own_key
        if own is not None and compare_digest(secret.encode(), own.encode()):
            return self._own
        return self.keyring.find(secret)

    def refresh(self) -> None:
        """Once a key has changed, end its streams and drop cached permissions; for the loop."""
        if self.keyring.look() == self._version:
            return
        self._version = self.keyring.version
        self.heads.clear()
        self._permissions.clear()
        for listener, permission in list(self._streams.items()):
            if not self._holds(permission):
                listener.end()

    def _holds(self, permission: Permission) -> bool:
        """Return whether a request that was permitted would be so now."""
        key = permission.key
        return not self.keys_needed if key is None else key is self._own or self.keyring.has(key)


def beyond_scope(permission: Permission, needed: Scope) -> HttpProblemError:
    """Return the refusal of a call that needs another scope."""
    assert permission.key is not None
    also = ""
    if needed == "write":
        also = " A displacement with on_thin 'estimate' or 'reject' needs no more than read."
    return HttpProblemError(
        403,
        "scope",
        "The key's scope does not allow this",
        f"The key {permission.key.name!r} is for {permission.key.scope}, this call needs {needed}; "
        f"nothing was changed.{also} Make another with: wrenchbook keys add NAME --scope {needed}",
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
    """Refuse bodies that a page may send without a preflight: a form, or text, that holds JSON.

    A program may leave the type out. A request with an Origin, which browsers send, may not.
    """
    kind = _kind(head)
    if path.endswith(_ANY_TYPE) or not (kind or b"origin" in head):
        return
    if path.startswith(_UMBRIDGE) and b"origin" not in head:
        return
    taken = (_JSON, _BYTES) if path.endswith(_BINARY) else (_JSON,)
    if kind not in taken:
        raise HttpProblemError(
            415,
            "media-type",
            "Not a form this call takes",
            f"The content type is {kind.decode('latin-1')[:100] or 'missing'}. Send the header "
            f"Content-Type: {' or '.join(one.decode() for one in taken)} (curl: --json, or -H).",
        )


def _check_length(permission: Permission, head: Mapping[bytes, bytes]) -> None:
    most, length = permission.most_bytes, head.get(b"content-length", b"0")
    if most is not None and length.isdigit() and int(length[:20]) > most:
        raise _too_large(most)


def _too_large(most: int) -> HttpProblemError:
    detail = f"This key may send at most {most >> 20} MiB at once; nothing was changed. Send parts."
    return HttpProblemError(413, "too-large", "The body is too large", detail)


def _too_often(permission: Permission, seconds: float) -> HttpProblemError:
    assert permission.key is not None
    return HttpProblemError(
        429,
        "rate",
        "The key is used too often",
        f"The key {permission.key.name!r} may ask {permission.key.rate:g} times a second; nothing "
        "was changed. Ask for many wrenches at once with POST .../displacements, or more slowly.",
        headers={"Retry-After": str(ceil(seconds))},
    )


def _no_key(why: str) -> HttpProblemError:
    return HttpProblemError(
        401,
        "key",
        "A key is needed",
        f"{why} Send the header Authorization: Bearer KEY; wrenchbook's own client takes "
        "key=, its commands the variable WRENCHBOOK_KEY. Whoever runs the server makes one with: "
        "wrenchbook keys add NAME",
        headers={"WWW-Authenticate": 'Bearer realm="wrenchbook"'},
    )
