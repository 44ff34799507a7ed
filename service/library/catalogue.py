"""Notes on components, and which components are archived. One small file."""

from __future__ import annotations

import json
import threading
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from wrenchbook.service.files.durable import write_whole_bytes


@dataclass(frozen=True)
class CatalogueCard:
    """The entry of one component.

    Attributes
    ----------
    notes : str
    archived : bool
        Left out of the library's list; it answers all the same.
    renamed_to : str or None
    copied_from : str or None
    """

    notes: str = ""
    archived: bool = False
    renamed_to: str | None = None
    copied_from: str | None = None


class CatalogueError(OSError):
    """The file could not be written; nothing was changed."""


class Catalogue:
    """The cards of a data directory, by component.

    Parameters
    ----------
    path : path
        The file; another process' changes are seen.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._lock = threading.Lock()
        self._stamp: tuple[int, int] | None = None
        self._cards: dict[str, CatalogueCard] = {}

    def __getitem__(self, name: str) -> CatalogueCard:
        with self._lock:
            self._look()
            return self._cards.get(name, CatalogueCard())

    def change(self, name: str, **fields: Any) -> CatalogueCard:
        """Change a component's entry, on disk for good.

        Raises
        ------
        CatalogueError
            If it cannot be written.
        """
        with self._lock:
            self._look()
            card = replace(self._cards.get(name, CatalogueCard()), **fields)
            cards = {**self._cards, name: card}
            content = json.dumps({name: asdict(one) for name, one in cards.items()})
            try:
                self._path.parent.mkdir(parents=True, exist_ok=True)
                write_whole_bytes(self._path, content.encode())
            except OSError as error:
                raise CatalogueError(
                    f"The library's notes cannot be written: {error.strerror or error}. Nothing "
                    "was changed; make room on the disk, then ask again."
                ) from error
            self._cards = cards
            return card

    def _look(self) -> None:
        """Read the file if it has changed; a damaged one is ignored."""
        try:
            found = self._path.stat()
        except OSError:
            return
        stamp = found.st_mtime_ns, found.st_size
        if stamp == self._stamp:
            return
        self._stamp = stamp
        try:
            read = json.loads(self._path.read_bytes())
            self._cards = {str(name): CatalogueCard(**fields) for name, fields in read.items()}
        except (OSError, ValueError, TypeError, AttributeError):
            return
