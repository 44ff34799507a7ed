"""Redaction: replies name no path of this machine."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path
from typing import Any, Final

# What is no folder of the machine but a path of the service's own.
_OURS: Final = frozenset({"v1", "health", "metrics", "umbridge", "docs", "openapi.json"})
_TRACEBACK: Final = re.compile(
    # Up to the line of the exception, or the end of a text that was cut.
    r"Traceback \(most recent call last\):.*?(?=^\S(?!raceback)|\Z)",
    re.MULTILINE | re.DOTALL,
)


def redact(text: str) -> str:
    """Return a text with absolute paths cut to their last names, and no traceback.

    Only what begins with a folder that this machine has is taken for a path; ``N/m`` and
    ``/v1/jobs/3`` stay.
    """
    if "/" not in text:
        return text
    return _paths().sub(lambda match: f".../{match[1]}", _TRACEBACK.sub("", text))


def redact_values(value: Any) -> Any:
    """Return JSON's values with all their texts made `redact`."""
    if isinstance(value, str):
        return redact(value)
    if isinstance(value, dict):
        return {key: redact_values(value) for key, value in value.items()}
    if isinstance(value, list | tuple):
        return [redact_values(value) for value in value]
    return value


@cache
def _paths() -> re.Pattern[str]:
    names = {path.name for path in Path("/").iterdir() if path.is_dir()} - _OURS
    roots = "|".join(sorted(map(re.escape, names))) or "tmp"
    name = r"[^/\s'\"<>|:;,()]*"
    return re.compile(rf"(?<![\w.:/-])/(?:{roots})(?=/)(?:/{name})*/({name})")
