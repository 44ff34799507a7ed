"""What was begun and never ended, and folders that belong to nothing."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

from service.ledger import Ledger
from service.ops.findings import Finding

_MOST_NAMED = 5  # of things of one kind; the rest is told as a number


def find_leftovers(folder: Path, ledger: Ledger) -> list[Finding]:
    """Tell drafts of what was killed, copies moved aside, and attempts that no job knows."""
    found = []
    drafts = [
        *(folder / "tables").glob(".*.tmp"),
        *(folder / "components").glob(".incoming-*"),
        *folder.glob(".restoring"),
        *_partial(folder),
    ]
    aside = [*folder.glob("*.damaged-*"), *folder.glob("*.orphan-*"), *folder.glob("*.settled-*")]
    aside += [*(folder / "tables").glob("*.damaged-*"), *folder.glob(".before-restore-*")]
    aside += [
        path
        for room in ("fields", "solver_errors")
        for path in folder.glob(f"{room}/**/*.damaged-*")
    ]
    if drafts:
        remedy = "a kill left them; remove them if no server is at work"
        found.append(Finding("note", f"unfinished files: {_named(folder, drafts)}", remedy))
    if aside:
        remedy = "remove them once nothing in them is missed"
        found.append(Finding("note", f"copies moved aside: {_named(folder, aside)}", remedy))
    if orphans := list(_orphans(folder / "jobs", ledger)):
        remedy = "they are of a ledger that is gone; a result.json in them may be worth a look"
        what = f"attempts of jobs that the ledger does not have: {_named(folder, orphans)}"
        found.append(Finding("note", what, remedy))
    losses = [Finding("fault", one, "settle it with: --mend") for one in ledger.losses()]
    return found + losses


def _partial(folder: Path) -> Iterator[Path]:
    """Give what `write_whole_bytes` was at when it was killed: ``.name.process.thread``."""
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
