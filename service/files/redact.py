"""Redaction: replies contain no path of this machine."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path
from typing import Any, Final

# First parts of the service's own URL paths, which are no folders of the machine.
_OURS: Final = frozenset({"v1", "health", "metrics", "umbridge", "docs", "openapi.json"})
# Endings of files that the service and its solvers read and write.
_SUFFIXES: Final = (
    "csv|dat|db|fmu|frd|gz|h5|hdf5|inp|json|log|lvm|mat|msh|npz|parquet|py|step|stp|tdms|toml|txt|"
    "wbt|xls|xlsx|zip"
)
_TRACEBACK: Final = re.compile(
    # Up to the line of the exception, or to the end of a text that was cut.
    r"Traceback \(most recent call last\):.*?(?=^\S(?!raceback)|\Z)",
    re.MULTILINE | re.DOTALL,
)


def redact(text: str) -> str:
    """Return a text with absolute paths cut to their last names, and no traceback.

    Only a text that begins with a folder of this machine counts as a path; ``N/m`` and
    ``/v1/jobs/3`` stay. A path with spaces is cut if it is quoted, or ends with one of `_SUFFIXES`.
    """
    return cut_paths(_TRACEBACK.sub("", text))


def cut_paths(text: str) -> str:
    """Return a text with absolute paths cut to their last names, as `redact` does."""
    for pattern in _path_patterns():
        text = pattern.sub(r".../\g<name>", text)
    return text


def redact_values(value: Any) -> Any:
    """Return JSON values with `redact` applied to all texts."""
    if isinstance(value, str):
        return redact(value)
    if isinstance(value, dict):
        return {key: redact_values(value) for key, value in value.items()}
    return [redact_values(value) for value in value] if isinstance(value, list | tuple) else value


@cache
def _path_patterns() -> tuple[re.Pattern[str], ...]:
    """Return patterns of paths, the most certain first; the group ``name`` is the last name."""
    names = {path.name for path in Path("/").iterdir() if path.is_dir()} - _OURS
    roots = "|".join(sorted(map(re.escape, names))) or "tmp"
    root = rf"(?<![\w.:/-])/(?:{roots})(?=/)"
    plain, spaced = r"[^/\s'\"<>|:;,()]*", r"[^/\n'\"<>|:;,]*"
    # A space before a slash is between two paths, not within one. The number of folders is limited,
    # since each start of a text without a suffix would read on to the text's end.
    folder = rf"/(?! ){spaced}(?<! )"
    return (
        re.compile(rf"(?<=(['\"])){root}(?:/{spaced})*/(?P<name>{spaced})(?=\1)"),
        re.compile(rf"{root}(?:{folder}){{0,40}}?/(?P<name>(?! ){spaced}?\.(?:{_SUFFIXES})\b)"),
        re.compile(rf"{root}(?:/{plain})*/(?P<name>{plain})"),
    )
