"""State that release 0.3 kept in files beside the ledger: read once, then removed."""

from __future__ import annotations

import json
import logging
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

_log = logging.getLogger(__name__)

CATALOGUE, DEMAND, SOLVER_ERRORS = "library.json", "demand.json", "solver_errors"


Entry = tuple[str, tuple]  # a table and the values of a row


def read_files(folder: Path) -> tuple[list[Entry], list[Path]]:
    """Return the entries of all files of a data directory, and the files that could be read."""
    paths = [path for name in (CATALOGUE, DEMAND) if (path := folder / name).is_file()]
    paths += sorted((folder / SOLVER_ERRORS).glob("*/*.json"))
    entries: list[Entry] = []
    read: list[Path] = []
    for path in paths:
        try:
            entries += list(_entries(path, json.loads(path.read_bytes())))
            read.append(path)
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            _log.warning("%s of an earlier version cannot be read and is left: %s", path, error)
    return entries, read


def remove_files(folder: Path, read: list[Path]) -> None:
    """Remove files whose entries the ledger has."""
    for path in read:
        path.unlink(missing_ok=True)
    (folder / ".demand.lock").unlink(missing_ok=True)
    if not list((folder / SOLVER_ERRORS).glob("*/*.json")):
        shutil.rmtree(folder / SOLVER_ERRORS, ignore_errors=True)


def _entries(path: Path, content: Any) -> Iterator[Entry]:
    """Yield the entries of a file."""
    if path.name == CATALOGUE:
        for name, card in content.items():
            noted = card.get("notes", ""), int(card.get("archived", False))
            yield "catalogue", (name, *noted, card.get("renamed_to"), card.get("copied_from"))
    elif path.name == DEMAND:
        for name, counts in content.items():
            _ = counts["cells"], counts["elsewhere"], float(counts["since"])
            yield "demand", (name, json.dumps(counts))
    else:
        _ = content["mesh"]
        yield "solver_errors", (path.parent.name, path.stem, json.dumps(content))
