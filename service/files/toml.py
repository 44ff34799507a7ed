"""Values in TOML, which Python reads but does not write."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")  # TOML requires quotes around any other key


def toml_value(value: Any) -> str:
    """Return a text, a number, a list or a mapping as a value of TOML, on one line.

    Raises TypeError for any other type, such as None, which TOML does not have.
    """
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return toml_text(value)
    if isinstance(value, Mapping):
        pairs = (
            f"{key if _BARE_KEY.fullmatch(key) else toml_text(key)} = {toml_value(entry)}"
            for key, entry in value.items()
        )
        return f"{{{', '.join(pairs)}}}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(toml_value, value))}]"
    if isinstance(value, float):
        return repr(float(value))  # numpy's float64 too, whose repr is np.float64(1.5)
    if isinstance(value, int):
        return repr(value)
    raise TypeError(
        f"{value!r} of type {type(value).__name__} is no value of TOML; give a text, a number, a "
        "list or a mapping, or leave the entry out"
    )


def toml_text(text: str) -> str:
    """Return a TOML basic string; raises ValueError for a text that no UTF-8 has."""
    if any("\ud800" <= c <= "\udfff" for c in text):
        raise ValueError(f"{text!r} has an unpaired surrogate (invalid Unicode); remove it")
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return '"' + "".join(c if c.isprintable() else f"\\U{ord(c):08x}" for c in escaped) + '"'
