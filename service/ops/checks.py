"""Checks of a data directory's files apart from ledger and tables, and what all checks return."""

from __future__ import annotations

import os
import shutil
import time
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from wrenchbook.service.fields.codec import DamagedFieldsError
from wrenchbook.service.fields.record import read_geometry, read_row
from wrenchbook.service.keys import Keyring, KeysError
from wrenchbook.service.ledger import Ledger
from wrenchbook.service.ops.backup import LEDGER

REPAIR = "mend it with: wrenchbook doctor --mend"
LITTLE_BYTES = 512 * 1024 * 1024  # a log of the ledger, a large table twice, some hundred attempts
FULL_BYTES = 1024 * 1024  # a commit's pages and an attempt's folder no longer fit
_ASIDE = (
    *("*.damaged-*", "*.orphan-*", "*.settled-*", "tables/*.damaged-*", ".before-restore-*"),
    "fields/**/*.damaged-*",
)
_MOST_NAMED = 5  # paths of one kind in a finding; the number of further ones follows


@dataclass(frozen=True)
class DataFinding:
    """One finding of a check."""

    kind: Literal["fault", "mended", "note"]  # needs repair, was repaired, needs nothing
    what: str
    remedy: str = ""


def move_aside(path: Path, why: str = "damaged") -> Path:
    """Rename a file within its folder to a name that nothing reads; return the new path."""
    stamp = f"{time.strftime('%Y%m%dT%H%M%SZ', time.gmtime())}-{time.time_ns() % 10**6:06d}"
    return path.rename(path.with_name(f"{path.name}.{why}-{stamp}"))


def is_full(folder: Path) -> bool:
    """Return whether the disk has no room for another job; False if that is unknown."""
    try:
        return shutil.disk_usage(folder).free < FULL_BYTES
    except OSError:
        return False


def not_writable(folder: Path) -> list[Path]:
    """Return what of a data directory this user cannot read and write."""
    ledger = [folder / f"{LEDGER}{end}" for end in ("", "-wal", "-shm")]
    paths = (folder, *ledger, folder / "tables", folder / "components", folder / "jobs")
    return [path for path in paths if path.exists() and not os.access(path, os.R_OK | os.W_OK)]


def check_disk(folder: Path) -> list[DataFinding]:
    """Find a disk that is nearly full, and files that cannot be read and written."""
    found = []
    free = shutil.disk_usage(folder).free
    if free < LITTLE_BYTES:
        remedy = "make room; prune attempts' folders with serve --keep-days and --keep-count"
        found.append(DataFinding("fault", f"the disk has {free / 1e6:.0f} MB left", remedy))
    remedy = f"make it readable and writable for user {os.getuid()}, as the server runs"
    return found + [
        DataFinding("fault", f"{path} cannot be read and written", remedy)
        for path in not_writable(folder)
    ]


def check_side_files(folder: Path, *, mend: bool) -> list[DataFinding]:
    """Find unusable keys, settings, statistics, solver errors and surfaces.

    With `mend`, files that the server writes again by itself are moved aside.
    """
    found = list(_keys_and_settings(folder))
    for path, remedy, error in _damaged(folder):
        what = f"{path.relative_to(folder)} cannot be used: {error}"
        if mend:
            aside = move_aside(path).name
            found.append(DataFinding("mended", what, f"moved to {aside}; {remedy}"))
        else:
            found.append(DataFinding("fault", what, f"{remedy}, once it is moved away; {REPAIR}"))
    return found


def _keys_and_settings(folder: Path) -> Iterator[DataFinding]:
    """Find unusable keys and settings, which only the owner can repair."""
    try:
        Keyring(folder)
    except KeysError as error:
        yield DataFinding("fault", f"nobody is let in: {error}")
    path = folder / "wrenchbook.toml"
    try:
        tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return
    except (OSError, ValueError) as error:
        yield DataFinding("fault", f"{path.name} cannot be read as TOML: {error}", "mend it")


def _damaged(folder: Path) -> Iterator[tuple[Path, str, Exception]]:
    """Yield each damaged file with what follows from that, and the error."""
    surface = "its row answers as before; its surface comes from the others until it is solved anew"
    kinds = [
        ("fields/*/*/*.fields", read_row, surface),
        ("fields/*/*/*.geometry", read_geometry, "surfaces come back with further solves"),
    ]
    for pattern, read, remedy in kinds:
        for path in sorted(folder.glob(pattern)):
            try:
                read(path.read_bytes())
            except FileNotFoundError:
                continue  # a running server has removed it
            except (DamagedFieldsError, OSError, ValueError, TypeError, AttributeError) as error:
                yield path, remedy, error


def find_leftovers(folder: Path, ledger: Ledger) -> list[DataFinding]:
    """Find files of interrupted writes, copies moved aside, and attempts without a job."""
    drafts = [
        *(folder / "tables").glob(".*.tmp"),
        *(folder / "components").glob(".incoming-*"),
        *folder.glob(".restoring"),
        *_partial(folder),
    ]
    aside = [path for pattern in _ASIDE for path in folder.glob(pattern)]
    kinds = [
        (
            "unfinished files",
            drafts,
            "left by an interrupted write; safe to remove while no server is running",
        ),
        ("copies moved aside", aside, "remove them once nothing in them is missed"),
        (
            "attempts of jobs that the ledger does not have",
            list(_orphans(folder / "jobs", ledger)),
            "they are of a ledger that is gone; a result.json in them may be worth a look",
        ),
    ]
    return [
        DataFinding("note", f"{what}: {_named(folder, paths)}", remedy)
        for what, paths, remedy in kinds
        if paths
    ]


def _partial(folder: Path) -> Iterator[Path]:
    """Yield files of interrupted `write_whole_bytes`: ``.name.process.thread``."""
    for path in folder.glob(".*.*.*"):
        process = path.name.split(".")[-2]
        if process.isdecimal() and not Path(f"/proc/{process}").exists():
            yield path


def _orphans(jobs: Path, ledger: Ledger) -> Iterator[Path]:
    numbers = [int(name) for name in os.listdir(jobs) if name.isdecimal()] if jobs.is_dir() else []  # noqa: PTH208
    known = ledger.attempts(numbers)
    for number in sorted(numbers):
        if number not in known:
            yield jobs / str(number)


def _named(folder: Path, paths: list[Path]) -> str:
    names = ", ".join(str(path.relative_to(folder)) for path in paths[:_MOST_NAMED])
    more = len(paths) - _MOST_NAMED
    return f"{names} and {more} more" if more > 0 else names
