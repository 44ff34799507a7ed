"""A bundle on its way in: a zip of strangers, unpacked, read and checked behind the fence."""

from __future__ import annotations

import json
import logging
import shutil
from pathlib import Path
from typing import Any, BinaryIO, Final

from fea.bundle.read import BundleError, Problem
from service.files.discreet import discreet
from service.library.bundle_zip import MAX_BUNDLE_BYTES, one_problem
from service.sandbox import FenceError, Limits, fenced, program
from service.sandbox.limits import MIB

log = logging.getLogger(__name__)

# The largest mesh of a generator, two million cells, takes 3 GB; a solve of half of that is days.
CHECK: Final = Limits(memory=2048 * MIB, seconds=300.0, output=MAX_BUNDLE_BYTES)
# Pieces of 1 MiB, the archive's list of files, and a component.toml that is small.
UNPACK: Final = Limits(memory=256 * MIB, seconds=120.0, output=MAX_BUNDLE_BYTES)
DECK = "deck"


def unpack(archive: BinaryIO, incoming: Path) -> tuple[Path, bool]:
    """Unpack a bundle's zip below `incoming`; return its folder, and whether it has a deck.

    Raises
    ------
    BundleError
        If the archive or its component.toml has mistakes, or takes too much to be read.
    FenceBusyError
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
        (told,) = fenced("service.library.bundle_zip:unpacked", kept, where, UNPACK)
    except FenceError as error:
        raise one_problem("bundle", str(error)) from None
    kept.unlink()
    if told.fields["problems"]:
        raise BundleError([Problem(where, why) for where, why in told.fields["problems"]])
    return target / told.fields["folder"], bool(told.fields["deck"])


def check_mesh(folder: Path) -> dict[str, Any]:
    """Build the bundle's mesh and resolve its groups, in a process of its own.

    The web process never imports the finite-element stack; a bad mesh file can cost that process
    its life without costing the server anything.

    Raises
    ------
    BundleError
        With every problem found, or with what ended the check.
    FenceBusyError
        If too many others are being checked.
    """
    try:
        run = program("fea.check", str(folder), limits=CHECK)
    except FenceError as error:
        raise one_problem("mesh", f"{error} A coarser mesh does.") from None
    try:
        report = json.loads(run.out.strip().splitlines()[-1])
        if report["ok"]:
            return report
        problems = [Problem(p["where"], p["message"]) for p in report["problems"][:1000]]
    except (IndexError, ValueError, KeyError, TypeError):
        raise one_problem("mesh", _ended(folder, run.err)) from None
    raise BundleError(problems)


def _ended(folder: Path, printed: str) -> str:
    """Return what a check that gave no report ended with; the log has all of it."""
    log.warning("the check of %s ended without a report:\n%s", folder.name, printed[-4000:])
    last = discreet((printed.strip().splitlines() or [""])[-1])[:300]
    if "MemoryError" in last or "bad_alloc" in printed[-4000:]:
        most = CHECK.memory >> 20
        return f"The mesh takes more than {most} MiB of memory to check. Give a coarser one."
    return f"The mesh check stopped without an answer ({last or 'it printed nothing'})."
