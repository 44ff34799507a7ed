"""One spelling of loads and outputs on the wire: fx .. mz and ux .. rz."""

from __future__ import annotations

import re
from typing import Any

# The tables' room writes them with a subscript, as formulas do.
_SUBSCRIPTED = re.compile(r"\b(?:([FM])_([xyz])|([ur])_([xyz]))(?![A-Za-z0-9_])")


def spelt(text: str) -> str:
    """Return a text with every load and output as the wire spells it."""
    return _SUBSCRIPTED.sub(lambda found: found.group().replace("_", "").lower(), text)


def on_the_wire(body: Any) -> Any:
    """Return a reply's body with the keys and texts of all its parts in the wire's spelling."""
    if isinstance(body, dict):
        return {
            spelt(key) if isinstance(key, str) else key: on_the_wire(value)
            for key, value in body.items()
        }
    if isinstance(body, list | tuple):
        return [on_the_wire(one) for one in body]
    return spelt(body) if isinstance(body, str) else body
