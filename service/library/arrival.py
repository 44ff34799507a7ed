"""Bundles that arrive: uploads, unpacked and checked in the sandbox, and copies."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np

from wrenchbook.fea.bundle.read import BundleError, BundleProblem
from wrenchbook.service.files.redact import redact
from wrenchbook.service.library.bundle_zip import MAX_BUNDLE_BYTES, one_problem
from wrenchbook.service.library.component import Component
from wrenchbook.service.sandbox import MIB, Limits, Sandbox, SandboxError, run

# The largest mesh of a generator, two million cells, takes 3 GB; a solve of half of that is days.
CHECK: Final = Limits(memory=2048 * MIB, seconds=300.0, output=MAX_BUNDLE_BYTES)
# Pieces of 1 MiB, the archive's list of files, and a component.toml that is small.
UNPACK: Final = Limits(memory=256 * MIB, seconds=120.0, output=MAX_BUNDLE_BYTES)
CHECKER: Final = "wrenchbook.service.library.bundle_zip:checked"
SURFACE: Final = "wrenchbook.service.library.bundle_zip:surface"
_NO_REPORT: Final = "The mesh check stopped without an answer ({why})."
DECK = "deck"
# Places apart from those of `run`: a check may take minutes. It imports 75 MB, so none stays.
_checks: Final = Sandbox(keep=False)


def unpack(archive: BinaryIO, incoming: Path) -> tuple[Path, bool]:
    """Unpack a bundle's zip below `incoming`; return its folder, and whether it has a deck.

    Raises
    ------
    BundleError
        If the archive or its component.toml has mistakes, or takes too much to be read.
    SandboxBusyError
        If too many others are being read.
    OSError
        If the disk is full or cannot be written.
    """
    kept, target = incoming / "bundle.zip", incoming / "bundle"
    target.mkdir()
    archive.seek(0)
    with kept.open("wb") as file:
        shutil.copyfileobj(archive, file, 1 << 20)
    where = {"target": str(target)}
    try:
        (part,) = run("wrenchbook.service.library.bundle_zip:unpacked", kept, where, UNPACK)
    except SandboxError as error:
        raise one_problem("bundle", str(error)) from None
    kept.unlink()
    if part.fields["problems"]:
        raise BundleError([BundleProblem(where, why) for where, why in part.fields["problems"]])
    return target / part.fields["folder"], bool(part.fields["deck"])


def check_mesh(folder: Path) -> dict[str, Any]:
    """Build the bundle's mesh and resolve its groups, in a subprocess of its own.

    The web process never imports the finite-element stack; a bad mesh file can crash the subprocess
    without harm to the server.

    Raises
    ------
    BundleError
        With every problem found, or with what ended the check.
    SandboxBusyError
        If too many others are being checked.
    """
    try:
        (part,) = _checks.run(CHECKER, folder, None, CHECK)
        report = json.loads(part.fields["report"])
        if report["ok"]:
            return report
        problems = [BundleProblem(p["where"], p["message"]) for p in report["problems"][:1000]]
    except SandboxError as error:
        raise one_problem("mesh", _why_not(error)) from None
    except (ValueError, KeyError, TypeError) as error:
        raise one_problem("mesh", _NO_REPORT.format(why=f"a malformed report: {error}")) from None
    raise BundleError(problems)


@lru_cache(maxsize=64)
def surface_of(folder: Path, _fingerprint: str) -> dict[str, Any]:
    """Return the outer surface of a bundle's mesh, ``vertices`` in m and ``triangles``.

    Raises
    ------
    SandboxError, SandboxBusyError
        If its mesh cannot be built within the limits of a check, or too many others are built.
    """
    (part,) = _checks.run(SURFACE, folder, None, CHECK)
    return {name: np.array(array) for name, array in part.arrays.items()}


def _why_not(error: SandboxError) -> str:
    """Return why a check gave no report."""
    if error.kind == "memory" or "bad_alloc" in str(error):
        most = CHECK.memory >> 20
        return f"The mesh takes more than {most} MiB of memory to check. Give a coarser one."
    if error.kind in ("time", "crash", "size"):
        return f"{error} A coarser mesh does."
    return _NO_REPORT.format(why=redact(f"{error.kind}: {error}")[:300])


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


def toml_value(value: Any) -> str:
    """Return a text, a number, a list or a mapping as a value of TOML, on one line."""
    if isinstance(value, Mapping):
        return f"{{{', '.join(f'{key} = {toml_value(own)}' for key, own in value.items())}}}"
    if isinstance(value, list):
        return f"[{', '.join(map(toml_value, value))}]"
    return toml_text(value) if isinstance(value, str) else repr(value)


def toml_text(text: str) -> str:
    """Return a TOML basic string."""
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return '"' + "".join(c if c.isprintable() else f"\\U{ord(c):08x}" for c in escaped) + '"'
