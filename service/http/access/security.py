"""Security settings of a server: keys, allowed hosts and allowed origins."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from wrenchbook.service.keys import OWN_KEY, is_loopback

LOOPBACK_NAMES = frozenset({"localhost", "127.0.0.1", "::1"})


@dataclass(frozen=True)
class SecuritySettings:
    """Who may call a server, and under which names.

    Parameters
    ----------
    keys_needed : bool
        Whether a key is needed even while there is none; one is needed anyway once there is one.
    hosts : frozenset of str, optional
        Names it answers to, as Host has them, without a port; to any if None.
    origins : frozenset of str
        Other sites whose pages may call it, such as ``https://lab.example``.
    own_key : str, optional
        A secret that is good for all, and kept nowhere.
    """

    keys_needed: bool = False
    hosts: frozenset[str] | None = None
    origins: frozenset[str] = field(default_factory=frozenset)
    own_key: str | None = None


def security_settings(
    host: str, hosts: str | None, origins: str | None, own_key: str | None = None
) -> SecuritySettings:
    """Return how a server that listens on an address is opened.

    On loopback it answers to loopback's names and those listed: a page of another site whose name
    is made to mean this machine (DNS rebinding) is not let in. Elsewhere it needs keys, and answers
    to any name unless some are listed.

    Parameters
    ----------
    host : str
        The address.
    hosts, origins : str, optional
        Further names and other sites, with commas between them.
    """
    listed = _listed(hosts)
    local = is_loopback(host)
    names = LOOPBACK_NAMES | {host} | listed if local or listed else None
    own = frozenset(one.rstrip("/").lower() for one in _listed(origins))
    return SecuritySettings(not local, names, own, own_key)


def security_of_options(options: Mapping[str, Any]) -> SecuritySettings:
    """Return the security settings by the options of `serve` and the environment."""
    own = os.environ.get(OWN_KEY)
    return security_settings(options["host"], options["allow_host"], options["allow_origin"], own)


def _listed(text: str | None) -> frozenset[str]:
    return frozenset(one.strip().lower() for one in (text or "").split(",") if one.strip())
