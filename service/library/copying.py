"""A component under another name: its bundle's files, and its rows."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

from wrenchbook.service.library.component import Component

_TOP_LEVEL = re.compile(r"^\s*\[", re.MULTILINE)
_LINE = {key: re.compile(rf"^[ \t]*{key}[ \t]*=.*$", re.MULTILINE) for key in ("name", "title")}


def copy_bundle(component: Component, name: str, title: str | None, folder: Path) -> None:
    """Copy a component's folder, with another name in its component.toml.

    Nothing else changes, so that its fingerprint, and with it the meaning of its rows, stays.
    """
    shutil.copytree(component.folder, folder, symlinks=False, dirs_exist_ok=False)
    file = folder / "component.toml"
    text = file.read_text(encoding="utf-8")
    begins = _TOP_LEVEL.search(text)
    end = begins.start() if begins else len(text)
    head = text[:end]
    for key, value in (("name", name), ("title", title)):
        if value is not None:
            head = _with_line(head, key, value)
    file.write_text(head + text[end:], encoding="utf-8")


def _with_line(head: str, key: str, value: str) -> str:
    line = f"{key} = {toml_text(value)}"
    if _LINE[key].search(head):
        return _LINE[key].sub(lambda _: line, head, count=1)
    return f"{line}\n{head}"


def toml_text(text: str) -> str:
    """Return a TOML basic string."""
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return '"' + "".join(c if c.isprintable() else f"\\U{ord(c):08x}" for c in escaped) + '"'
