"""Checks of a data directory's files other than ledger and tables, and the result of all checks."""

from __future__ import annotations

import os
import shutil
import time
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from wrenchbook.service.fields.record import DamagedFieldsError, read_geometry, read_row
from wrenchbook.service.files.durable import interrupted_writes
from wrenchbook.service.keys import Keyring, KeysError
from wrenchbook.service.ledger import Ledger
from wrenchbook.service.ledger.connection import RESTORING
from wrenchbook.service.ops.backup import LEDGER

COMMAND = "wrenchbook doctor --repair"
REPAIR = f"repair it with: {COMMAND}"
# Free space: a log of the ledger, a large table twice, some hundred attempts.
LITTLE_BYTES = 512 * 1024 * 1024
# Free space below which a commit's pages and an attempt's folder do not fit.
FULL_BYTES = 1024 * 1024
_ASIDE = (
    *("*.damaged-*", "*.orphan-*", "*.settled-*", "tables/*.damaged-*", ".before-restore-*"),
    "fields/**/*.damaged-*",
)
_MAX_NAMED = 5  # paths of one kind in a finding; the number of further ones follows


@dataclass(frozen=True)
class DataFinding:
    """One finding of a check."""

    kind: Literal["fault", "repaired", "note"]  # needs repair, was repaired, needs nothing
    problem: str
    remedy: str = ""


def move_aside(path: Path, why: str = "damaged") -> Path:
    """Rename a file within its folder to a name that no program reads; return the new path."""
    stamp = f"{time.strftime('%Y%m%dT%H%M%SZ', time.gmtime())}-{time.time_ns() % 10**6:06d}"
    return path.rename(path.with_name(f"{path.name}.{why}-{stamp}"))


def is_full(folder: Path) -> bool:
    """Return whether the disk has no room for another job; False if unknown."""
    try:
        return shutil.disk_usage(folder).free < FULL_BYTES
    except OSError:
        return False


def not_writable(folder: Path) -> list[Path]:
    """Return the files of a data directory that this user cannot read and write."""
    ledger = [folder / f"{LEDGER}{end}" for end in ("", "-wal", "-shm")]
    paths = (folder, *ledger, folder / "tables", folder / "components", folder / "jobs")
    return [path for path in paths if path.exists() and not os.access(path, os.R_OK | os.W_OK)]


def check_disk(folder: Path) -> Iterator[DataFinding]:
    """Report a nearly full disk, and files that cannot be read and written."""
    free = shutil.disk_usage(folder).free
    if free < LITTLE_BYTES:
        remedy = "make room; prune attempts' folders with serve --keep-days and --keep-count"
        yield DataFinding("fault", f"the disk has {free / 1e6:.0f} MB left", remedy)
    remedy = f"make it readable and writable for user {os.getuid()}, as the server runs"
    for path in not_writable(folder):
        yield DataFinding("fault", f"{path} cannot be read and written", remedy)


def check_side_files(folder: Path, *, repair: bool) -> Iterator[DataFinding]:
    """Report unusable keys and settings, which only the owner can repair, and surfaces.

    With `repair`, surfaces, which the server writes again by itself, are moved aside.
    """
    try:
        Keyring(folder)
    except KeysError as error:
        yield DataFinding("fault", f"nobody can log in: {error}")
    path = folder / "wrenchbook.toml"
    try:
        tomllib.loads(path.read_text(encoding="utf-8") if path.exists() else "")
    except (OSError, ValueError) as error:
        remedy = "correct the file, or move it away"
        yield DataFinding("fault", f"{path.name} cannot be read as TOML: {error}", remedy)
    surface = "its row still answers; its surface comes from the others until it is solved anew"
    geometry = "surfaces come back with further solves"
    for path in sorted(folder.glob("fields/*/*/*")):
        kinds = {".fields": (read_row, surface), ".geometry": (read_geometry, geometry)}
        read, remedy = kinds.get(path.suffix, (None, ""))
        try:
            if read is not None:
                read(path.read_bytes())
        except FileNotFoundError:
            continue  # a running server has removed it
        except (DamagedFieldsError, OSError, ValueError, TypeError, AttributeError) as error:
            problem = f"{path.relative_to(folder)} cannot be used: {error}"
            if repair:
                aside = move_aside(path).name
                yield DataFinding("repaired", problem, f"moved to {aside}; {remedy}")
            else:
                yield DataFinding("fault", problem, f"{remedy}, once it is moved away; {REPAIR}")


def find_leftovers(folder: Path, ledger: Ledger) -> Iterator[DataFinding]:
    """Report files of interrupted writes, copies moved aside, and attempts without a job."""
    unfinished = [
        *(folder / "tables").glob(".*.tmp"),
        *(folder / "components").glob(".incoming-*"),
        *folder.glob(RESTORING),
        *interrupted_writes(folder),
    ]
    jobs = folder / "jobs"
    numbers = [int(name) for name in os.listdir(jobs) if name.isdecimal()] if jobs.is_dir() else []  # noqa: PTH208
    known = ledger.attempts(numbers)
    orphans = [jobs / str(number) for number in sorted(numbers) if number not in known]
    aside = [path for pattern in _ASIDE for path in folder.glob(pattern)]
    removal = "left by an interrupted write; safe to remove while no server is running"
    gone = "they belong to a lost ledger; look for a result.json in them, then remove them"
    for subject, paths, remedy in (
        ("unfinished files", unfinished, removal),
        ("copies moved aside", aside, "remove them once you need nothing in them"),
        ("attempts of jobs that the ledger does not have", orphans, gone),
    ):
        names = ", ".join(str(path.relative_to(folder)) for path in paths[:_MAX_NAMED])
        more = f" and {len(paths) - _MAX_NAMED} more" if len(paths) > _MAX_NAMED else ""
        if paths:
            yield DataFinding("note", f"{subject}: {names}{more}", remedy)
