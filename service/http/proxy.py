"""Users that a trusted proxy states in headers, as proxies of OpenID Connect do."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from ipaddress import IPv4Network, IPv6Network, ip_address, ip_network
from typing import Final

from wrenchbook.service.actors import USER
from wrenchbook.service.http.problems import HttpProblemError
from wrenchbook.service.keys import SCOPES, Key, Scope, digest_of
from wrenchbook.service.settings import Settings, SettingsError, listed

PEER: Final = "wrenchbook.peer"  # key in a scope: the address of a connection
PEER_FIELD: Final = b":peer"  # the same among the header fields; no caller can send a ":" in a name
_HEADER: Final = re.compile(r"[A-Za-z0-9-]{1,64}")
_USER: Final = re.compile(r"[A-Za-z0-9][\w.@+:/=|-]{0,127}", re.ASCII)  # a mail address, or an id
# Headers of callers, which proxies pass on.
_OF_CALLERS: Final = ("authorization", "cookie", "host")
_MAX_GROUPS: Final = 1000


@dataclass(frozen=True)
class ProxyTrust:
    """The headers of trusted proxies, in lower case, their networks, and the scopes of groups."""

    user: bytes
    networks: tuple[IPv4Network | IPv6Network, ...]
    groups: bytes
    scopes: Mapping[str, Scope]

    def key_of(self, head: Mapping[bytes, bytes]) -> Key | None:
        """Return the user of a request as a key that is not stored; None without a user.

        The header is ignored if the request comes from an address that is not trusted.

        Raises HttpProblemError with status 403 if the user or its groups are refused.
        """
        sent = head.get(self.user, b"").decode("latin-1").strip()
        if not sent or not self.trusts(head.get(PEER_FIELD, b"").decode()):
            return None
        if not _USER.fullmatch(sent):
            malformed = f"The proxy sent the user {sent[:100]!r}; let it send a mail address, or an"
            raise _refused(malformed + " id of at most 128 letters and digits.")
        groups = head.get(self.groups, b"").decode("latin-1").split(",")[:_MAX_GROUPS]
        named = {"*", *(group.strip() for group in groups)}
        allowed: list[Scope] = [self.scopes[group] for group in named & self.scopes.keys()]
        if not allowed:
            others = ", ".join(sorted(named - {"*", ""}))[:200] or "none"
            why = f"No group of {sent} has a scope here (groups: {others}). Start the server with:"
            raise _refused(why + " wrenchbook serve --trust-proxy-scopes GROUP=read")
        name = f"{USER}{sent}"
        scope = max(allowed, key=SCOPES.index)
        return Key(name, scope, digest_of(name), 0.0)

    def refuse_repeated(self, fields: Iterable[tuple[bytes, bytes]]) -> None:
        """Refuse (400) a request with several headers of a proxy: the caller may have sent one."""
        names = [name for name, _ in fields]
        for name in (self.user, self.groups):
            if names.count(name) > 1:
                why = (
                    f"The request has the header {name.decode()} more than once; nothing was "
                    "changed. Let the proxy replace the caller's header, not add its own."
                )
                raise HttpProblemError(400, "users", "A proxy header is there twice", why)

    def trusts(self, peer: str) -> bool:
        """Return whether an address is that of a trusted proxy."""
        try:
            address = ip_address(peer)
        except ValueError:
            return False
        address = getattr(address, "ipv4_mapped", None) or address
        return any(address in network for network in self.networks)


def proxy_trust(settings: Settings) -> ProxyTrust | None:
    """Return the settings of trusted proxies, None without any; raises SettingsError."""
    user, groups = settings.trust_proxy_user, settings.trust_proxy_groups
    if user is None:
        if settings.trust_proxy_from or groups:
            option = "from" if settings.trust_proxy_from else "groups"
            why = f"--trust-proxy-{option} needs the header that names the user"
            raise SettingsError(why + "; add --trust-proxy-user X-Forwarded-User")
        return None
    _check_header("user", user)
    _check_header("groups", groups)
    scopes: dict[str, Scope] = {}
    for part in settings.trust_proxy_scopes.split(","):
        group, _, word = part.strip().partition("=")
        if not group or word not in SCOPES:
            raise SettingsError(
                f"--trust-proxy-scopes: {part!r} is not GROUP=SCOPE with one of the scopes "
                f"{', '.join(SCOPES)}; write for example lab=write,*=read"
            )
        scopes[group] = SCOPES[SCOPES.index(word)]
    addresses = listed(settings.trust_proxy_from)
    if not addresses:
        raise SettingsError("--trust-proxy-user needs an address; add --trust-proxy-from ADDRESS")
    try:
        networks = tuple(map(ip_network, addresses))
    except ValueError as error:
        raise SettingsError(f"--trust-proxy-from: {error}; write for example 10.0.0.0/8") from None
    return ProxyTrust(user.lower().encode(), networks, (groups or "").lower().encode(), scopes)


def _check_header(option: str, header: str | None) -> None:
    """Raise SettingsError if callers send the header of a proxy, or its name is not valid."""
    remedy = f"write the header that the proxy sets, such as X-Forwarded-{option.capitalize()}"
    if header and header.lower() in _OF_CALLERS:
        raise SettingsError(f"--trust-proxy-{option}: {header!r} comes from callers; {remedy}")
    if header and not _HEADER.fullmatch(header):
        raise SettingsError(f"--trust-proxy-{option}: {header!r} is no valid header; {remedy}")


def _refused(why: str) -> HttpProblemError:
    return HttpProblemError(
        403, "user", "The user may not call this server", f"{why} Nothing was changed."
    )
