"""Access control of every request before its body is read: keys, rates, hosts, origins, headers."""

from __future__ import annotations

import os
import weakref
from collections.abc import Mapping
from dataclasses import dataclass, field
from math import ceil
from secrets import compare_digest
from typing import Any, Final

from starlette.types import Receive, Send
from starlette.types import Scope as HttpScope

from wrenchbook.service.actors import ANY, CALLER, LOCAL, USER, Caller
from wrenchbook.service.events import Listener
from wrenchbook.service.http.body import counted, too_large
from wrenchbook.service.http.headers import QUERY, send_preflight, with_security_headers
from wrenchbook.service.http.permission import OPEN, PERMISSION, Permission, Rates, permission_of
from wrenchbook.service.http.problems import HttpProblemError
from wrenchbook.service.http.proxy import PEER, PEER_FIELD, ProxyTrust
from wrenchbook.service.keys import MAX_KEYS, OWN_KEY, Key, Keyring, Scope, digest_of, is_loopback
from wrenchbook.service.settings import listed
from wrenchbook.service.tables.rows import iso_time

_LOOPBACK_NAMES: Final = frozenset({"localhost", "127.0.0.1", "::1"})
_READING: Final = ("GET", "OPTIONS")  # HEAD is read as GET
# Open to every site and without a key, as are the files of the page: none has content of tables.
_PUBLIC: Final = frozenset({"/", "/docs", "/openapi.json", "/favicon.ico", "/health/live"})
_ADMIN: Final = ("/v1/keys", "/v1/audit")
# Calls whose replies only concern the components that the caller may use. A key limited to some
# components has no other calls: a new call is refused until it is listed here.
_LIMITED: Final = ("/v1/components", "/v1/jobs", "/v1/events", "/v1/scenes/plan", "/health/ready")
_LIMITED_NAMED: Final = ("/v1/components/", "/v1/jobs/", "/umbridge/")
_JSON: Final = b"application/json"
_BYTES: Final = b"application/octet-stream"
_BINARY: Final = ("/displacements", "/recording", "/envelope")
_RIGS: Final = "/v1/rigs/"  # TOML by PUT, which pages of another site send only after a preflight
# Calls that check content types themselves: files of many kinds.
_ANY_TYPE: Final = ("/table", "/v1/components")
_UMBRIDGE: Final = "/umbridge/"  # clients send the content type of their library
_NO_LIMIT: Final = 1e6  # requests a second and MiB that mean no limit
_DATA: Final = "--data FOLDER (the server's data directory)"


@dataclass(frozen=True)
class SecuritySettings:
    """Whether keys are needed; allowed hosts (all if None) and other sites; the server's own key.

    Keys are always needed once a key was stored. `server_key` permits all calls and is not stored.
    """

    keys_needed: bool = False
    hosts: frozenset[str] | None = None
    origins: frozenset[str] = field(default_factory=frozenset)
    server_key: str | None = None
    proxy: ProxyTrust | None = None


def security_settings(
    host: str, hosts: str | None, origins: str | None, proxy: ProxyTrust | None = None
) -> SecuritySettings:
    """Return the security settings of a server that listens on an address.

    `hosts` and `origins` are lists separated by commas. On loopback the server answers to
    loopback's names and listed ones: a page of another site whose name is made to mean this machine
    (DNS rebinding) is refused. On other addresses it needs keys, and answers to any name unless
    some are listed. The environment has the server's own key.
    """
    local, names = is_loopback(host), frozenset(listed(hosts and hosts.lower()))
    allowed = _LOOPBACK_NAMES | {host} | names if local or names else None
    sites = frozenset(site.rstrip("/").lower() for site in listed(origins))
    return SecuritySettings(not local, allowed, sites, os.environ.get(OWN_KEY), proxy)


class AccessControl:
    """Authentication, rate limits and origin checks of every request."""

    def __init__(self, keyring: Keyring, security: SecuritySettings) -> None:
        self.security = security
        self.keyring = keyring
        self.rates = Rates()
        digest = digest_of(security.server_key or "")
        self._server_key = Key(LOCAL, "admin", digest, 0.0, _NO_LIMIT, int(_NO_LIMIT))
        self._permissions: dict[str, Permission] = {}
        self._users: dict[tuple[str, Scope], Permission] = {}
        self._streams: weakref.WeakKeyDictionary[Listener, Permission] = weakref.WeakKeyDictionary()
        self.heads: dict[bytes, Any] = {}  # cache of the fast path, emptied when a key changes
        self._version = keyring.version
        self._had_keys = len(keyring) > 0

    @property
    def keys_needed(self) -> bool:
        """Whether every call needs a key: after the first key always.

        A server whose last key is revoked or moved away may be before a proxy's network.
        """
        return self.always_needs_keys or self._had_keys

    @property
    def always_needs_keys(self) -> bool:
        """Whether calls need a key even if the server has none."""
        return self.security.keys_needed or self.security.proxy is not None

    def admit(self, path: str, head: Mapping[bytes, bytes]) -> Permission | None:
        """Return the permission of a query of the fast path; None for the ordinary path.

        The fast path counts each query itself, and sends neither refusals nor CORS headers. It
        cannot decide on a key without the scope `write`, whose rights depend on the body, nor on a
        proxy's header, which depends on the connection.
        """
        if self.security.proxy is not None and self.security.proxy.user in head:
            return None
        try:
            permission = self.check("POST", path, head, counts=False)
        except HttpProblemError:
            return None
        return permission if permission.allows("write") and b"origin" not in head else None

    def end_with_key(self, listener: Listener, permission: Permission) -> None:
        """End a listener of events once its key is revoked or changed."""
        self._streams[listener] = permission
        if not self._holds(permission):  # a key may have changed after the permission was given
            listener.end()

    async def pass_on(
        self, scope: HttpScope, receive: Receive, send: Send
    ) -> tuple[Receive, Send] | None:
        """Return a permitted request's `receive` and `send`; answer all others, and return None."""
        head = dict(scope["headers"])
        origin = head.get(b"origin", b"")
        is_listed = origin.decode("latin-1").lower() in self.security.origins
        send = with_security_headers(send, scope["path"], origin if is_listed else None)
        if is_listed and scope["method"] == "OPTIONS" and b"access-control-request-method" in head:
            await send_preflight(send, origin)
            return None

        try:
            if PERMISSION not in scope:  # the fast path has admitted and counted it already
                if self.security.proxy is not None:
                    self.security.proxy.refuse_repeated(scope["headers"])
                peer = scope.get(PEER) or (scope.get("client") or ("",))[0]
                head[PEER_FIELD] = peer.encode()
                scope[PERMISSION] = self.check(scope["method"], scope["path"], head)
        except HttpProblemError as refused:
            await refused.response()(scope, receive, send)
            return None

        permission = permission_of(scope)
        CALLER.set(permission.caller)
        if permission.key is not None and b"transfer-encoding" in head:
            max_bytes = permission.key.megabytes << 20
            receive = counted(receive, max_bytes, _beyond_key(permission.key))
        return receive, send

    def check(
        self, method: str, path: str, head: Mapping[bytes, bytes], counts: bool = True
    ) -> Permission:
        """Check a request by its head, and return its permission; `counts`: for its key's rate.

        Raises HttpProblemError with status 401, 403, 413, 415 or 429 if the request is not
        permitted; its body was not read then.
        """
        self._check_host(head)
        if method == "GET" and (path in _PUBLIC or path.startswith("/page/")):
            return OPEN
        self._check_origin(head)
        permission = self._permission(head)

        # Whether a displacement queues anything depends on its body, which is read later.
        reads = method in _READING or (method == "POST" and QUERY.fullmatch(path) is not None)
        needed: Scope = "read" if reads else "write"
        if any(path == call or path.startswith(f"{call}/") for call in _ADMIN):
            needed = "admin"
        if not permission.allows(needed):
            raise beyond_scope(permission, needed)
        _check_components(permission.caller, method, path)

        key = permission.key
        if key is not None and counts and (seconds := permission.wait()) > 0.0:
            why = (
                f"The key {key.name!r} allows {key.rate:g} requests a second; nothing was changed. "
                f"Repeat the request in {ceil(seconds)} s, or send many wrenches at once with POST "
                ".../displacements."
            )
            retry = {"Retry-After": str(ceil(seconds))}
            raise HttpProblemError(429, "rate", "The key has too many requests", why, headers=retry)

        length = head.get(b"content-length", b"0")
        if key is not None and length.isdigit() and int(length[:20]) > key.megabytes << 20:
            raise _beyond_key(key)
        if method not in _READING and (length != b"0" or b"transfer-encoding" in head):
            _check_kind(path, head)
        return permission

    def _check_host(self, head: Mapping[bytes, bytes]) -> None:
        """Refuse a request whose Host is not allowed (DNS rebinding)."""
        if self.security.hosts is None:
            return
        host = head.get(b"host", b"").decode("latin-1").lower()
        name = host[1:].partition("]")[0] if host.startswith("[") else host.partition(":")[0]
        if name not in self.security.hosts:
            why = (
                f"Host {name[:100]!r} is not allowed. If it is a name of this server, start it "
                f"with: wrenchbook serve --allow-host {name[:100]}"
            )
            if not name:
                why = "The request has no Host. Send the header Host with the name of this server."
            raise HttpProblemError(403, "host", "The host is not allowed", why)

    def _check_origin(self, head: Mapping[bytes, bytes]) -> None:
        """Refuse a request of another site's page, unless `allow-origin` lists the site.

        Programs send neither Origin nor Sec-Fetch-Site; browsers do, and pages cannot change them.
        """
        site = "another site"
        if (origin := head.get(b"origin")) is not None:
            site = origin.decode("latin-1").lower()
            host = head.get(b"host", b"").decode("latin-1")
            if site in self.security.origins or site.partition("://")[2] == host.lower():
                return
        elif head.get(b"sec-fetch-site", b"none") not in (b"cross-site", b"same-site"):
            return
        why = (
            f"The request comes from a page of {site[:100]}; nothing was changed. If that page is "
            "yours, start the server with: wrenchbook serve --allow-origin "
            f"{site[:100] if '://' in site else 'ORIGIN'}"
        )
        title = "Pages of other sites may not call this server"
        raise HttpProblemError(403, "cross-site", title, why)

    def _permission(self, head: Mapping[bytes, bytes]) -> Permission:
        """Return the permission of a request by its key, or by a trusted proxy's headers."""
        self.refresh()
        if not self.keys_needed:
            return OPEN
        user = self.security.proxy.key_of(head) if self.security.proxy else None
        if user is not None:
            if len(self._users) >= MAX_KEYS:
                self._users.clear()
            return self._users.setdefault((user.name, user.scope), Permission(user, self.rates))
        sent = head.get(b"authorization", b"").decode("latin-1")
        word, _, secret = sent.partition(" ")
        secret = secret.strip()
        if word.lower() != "bearer" or not secret:
            why = "This server needs a key, and the request has none."
            if sent:  # the text may be a secret, so it is not quoted
                why = "The request's header Authorization is not of the form Bearer KEY."
            raise _no_key(why)
        permission = self._permissions.get(secret)
        if permission is None:
            server_key = (self.security.server_key or "").encode()
            is_server_key = bool(server_key) and compare_digest(secret.encode(), server_key)
            key = self._server_key if is_server_key else self.keyring.find(secret)
            if key is None:
                raise _no_key("This server has no such key: it is mistyped, or was revoked.")
            if not key.is_valid():
                end = iso_time(key.expires or 0.0)
                raise _no_key(f"The key {key.name!r} expired at {end}.", "The key has expired")
            stored = None if is_server_key else self.keyring
            permission = self._permissions[secret] = Permission(key, self.rates, stored)
        return permission

    def refresh(self) -> None:
        """End the streams of changed keys and empty the permissions' cache; call it in the loop."""
        if self.keyring.refresh() == self._version:
            return
        self._version = self.keyring.version
        self._had_keys |= len(self.keyring) > 0
        self.heads.clear()
        self._permissions.clear()
        for listener, permission in list(self._streams.items()):
            if not self._holds(permission):
                listener.end()

    def _holds(self, permission: Permission) -> bool:
        """Return whether a request that was permitted would be permitted now."""
        key = permission.key
        if key is None or key is self._server_key:
            return key is self._server_key or not self.keys_needed
        return key.name.startswith(USER) or self.keyring.has(key)


def beyond_scope(permission: Permission, needed: Scope, reads: str = "") -> HttpProblemError:
    """Return the refusal of a call that needs another scope; `reads`: its form that needs read."""
    assert permission.key is not None
    name, scope = permission.key.name, permission.key.scope
    holder = "key"
    remedy = f"Create another key with: wrenchbook keys add NAME --scope {needed} {_DATA}"
    if name.startswith(USER):
        holder = "user"
        remedy = f"Start the server with: wrenchbook serve --trust-proxy-scopes GROUP={needed}"
    if reads:
        remedy = f"{reads} {remedy}"
    why = f"The {holder} {name!r} has the scope {scope}, but this call needs {needed}"
    title = f"The {holder}'s scope does not allow this"
    return HttpProblemError(403, "scope", title, why + "; nothing was changed. " + remedy)


def _beyond_key(key: Key) -> HttpProblemError:
    """Return the refusal of a body that is larger than a key may send."""
    remedy = (
        f"Send it in parts, or with another key: wrenchbook keys add NAME --megabytes "
        f"{2 * key.megabytes} {_DATA}"
    )
    return too_large(key.megabytes << 20, f"the limit of the key {key.name!r}", remedy)


def _check_components(caller: Caller, method: str, path: str) -> None:
    """Refuse calls about other components, or the whole server, with a key for some components."""
    if caller.components == ANY:
        return
    name = path.split("/")[3] if path.startswith("/v1/components/") else None
    is_read_rig = method == "GET" and f"{path}/".startswith(_RIGS)
    limited = path in _LIMITED or path.startswith(_LIMITED_NAMED) or is_read_rig
    if limited and (name is None or caller.may_use(name)):
        return
    concern, command = "the whole server", "wrenchbook keys add NAME"
    if name is not None:
        concern = repr(name[:100])
        command = "wrenchbook keys add NAME --component PATTERN"
    why = (
        f"The key {caller.actor!r} is for {', '.join(caller.components)}, but this call concerns "
        f"{concern}; nothing was changed. Create another key with: {command} {_DATA}"
    )
    raise HttpProblemError(403, "components", "The key is not for this component", why)


def _check_kind(path: str, head: Mapping[bytes, bytes]) -> None:
    """Refuse bodies that a page may send without a preflight: a form, or text, that may be JSON.

    A program may leave the type out. A request with an Origin, which browsers send, may not.
    """
    kind = head.get(b"content-type", b"").partition(b";")[0].strip().lower()
    if path.endswith(_ANY_TYPE) or path.startswith(_RIGS) or not (kind or b"origin" in head):
        return
    if path.startswith(_UMBRIDGE) and b"origin" not in head:
        return
    accepted = (_JSON, _BYTES) if path.endswith(_BINARY) else (_JSON,)
    if kind not in accepted:
        why = (
            f"The content type is {kind.decode('latin-1')[:100] or 'missing'}. Send the header "
            f"Content-Type: {b' or '.join(accepted).decode()} (curl: --json, or -H)."
        )
        raise HttpProblemError(415, "media-type", "The content type is not accepted", why)


def _no_key(why: str, title: str = "A key is needed") -> HttpProblemError:
    """Return the 401 of a call without a valid key: `why`, and how to send and create a key."""
    why = (
        f"{why} Send the header Authorization: Bearer KEY (client: key=; commands: variable "
        "WRENCHBOOK_KEY). The server's operator creates a key with: wrenchbook keys add NAME "
        f"{_DATA}"
    )
    headers = {"WWW-Authenticate": 'Bearer realm="wrenchbook"'}
    return HttpProblemError(401, "key", title, why, headers=headers)
