"""Digests of the program's own code: what was made by other code is not taken for this one's."""

from __future__ import annotations

import hashlib
from functools import cache
from pathlib import Path

_ROOT = Path(__file__).resolve().parents[2]


@cache
def code_digest(*folders: str) -> str:
    """Return a digest, 16 hexadecimal digits, of the Python files below some folders.

    Parameters
    ----------
    folders
        Such as ``surrogate`` or ``service/jobs``.
    """
    found = hashlib.sha256()
    for folder in folders:
        for path in sorted((_ROOT / folder).rglob("*.py")):
            found.update(path.relative_to(_ROOT).as_posix().encode() + b"\0" + path.read_bytes())
    return found.hexdigest()[:16]
