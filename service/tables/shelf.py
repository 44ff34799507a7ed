"""Built tables, and what their builder has to say, where other processes of the server find them.

One folder of the data directory: who holds its lock builds, all others look. Each version of a
table is a file of its own, whose name tells all that a look at the folder has to tell; it comes
with one rename and goes when the next one is there. Nothing here lasts: the ledger has it all.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import NamedTuple

from service.files.lock import is_held, take
from service.library.component import Component
from service.tables.image import read_image, write_image
from surrogate.build import AnyTable

FOLDER = "shared"  # in the data directory
_ENDING = ".table"
LOCK, _TOLD = "lock", "told.json"


class Shelved(NamedTuple):
    """One version of a table on the shelf.

    Attributes
    ----------
    number : int
        Larger than that of any version that was put there before.
    version : int
        The number of the ledger's newest change in it.
    setup : str
        What it was built for: see `setup_of`.
    path : path
    """

    number: int
    version: int
    setup: str
    path: Path


@dataclass(frozen=True)
class Told:
    """What the builder says of itself.

    Attributes
    ----------
    trouble : str or None
        Why no job runs.
    faults : dict of str to str
        Why a component's table is not what the ledger says, by its name.
    """

    trouble: str | None = None
    faults: dict[str, str] = field(default_factory=dict)


class Shelf:
    """The folder of one data directory.

    Parameters
    ----------
    folder : path
        Made if there is none.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._told = Told()
        self._lock: int | None = None
        folder.mkdir(parents=True, exist_ok=True)

    def take(self) -> bool:
        """Become the one who builds; False if another process is.

        Tables that the one before has left stay until newer ones are there: others answer by them.
        """
        self._lock = take(self._folder / LOCK)
        return self._lock is not None

    def is_tended(self) -> bool:
        """Tell whether anybody builds."""
        return is_held(self._folder / LOCK)

    def leave(self) -> None:
        """Build no longer, and take away what nobody will look at again."""
        if self._lock is not None:
            shutil.rmtree(self._folder, ignore_errors=True)
            os.close(self._lock)
            self._lock = None

    def put(self, component: Component, surrogate: AnyTable) -> AnyTable:
        """Put a built table there, and return the same one mapped from it.

        Raises
        ------
        OSError
            If it cannot be written; the version before stays.
        """
        before = self._all(component.name)
        number = 1 + max((one.number for one in before), default=0)
        words = component.name, str(number), str(surrogate.version), setup_of(component)
        path = self._folder / (".".join(words) + _ENDING)
        write_image(surrogate, path)
        for one in before:
            one.path.unlink(missing_ok=True)
        return read_image(path, checked=True)

    def newest(self) -> dict[str, Shelved]:
        """Return the newest version of each table that is there, by component."""
        found: dict[str, Shelved] = {}
        for name, one in self._entries():
            if name not in found or one.number > found[name].number:
                found[name] = one
        return found

    def stamp(self) -> int:
        """Return a number that differs once anything has come or gone; takes microseconds."""
        try:
            return os.stat(self._folder).st_mtime_ns  # noqa: PTH116 (fifty times a second)
        except OSError:
            return 0

    def tell(self, told: Told) -> None:
        """Say what the builder has to say, if it is anything new.

        Raises
        ------
        OSError
            If it cannot be written.
        """
        if told != self._told or not (self._folder / _TOLD).exists():
            partial = self._folder / f".{_TOLD}"
            partial.write_text(json.dumps(asdict(told)), encoding="utf-8")
            partial.replace(self._folder / _TOLD)
            self._told = told

    def told(self) -> Told:
        """Return what the builder said last; nothing if there is none or it was never said."""
        try:
            return Told(**json.loads((self._folder / _TOLD).read_bytes()))
        except (OSError, ValueError, TypeError):
            return Told()

    def _all(self, name: str) -> list[Shelved]:
        return [one for known, one in self._entries() if known == name]

    def _entries(self) -> list[tuple[str, Shelved]]:
        found = []
        try:
            names = os.listdir(self._folder)  # noqa: PTH208 (names are all that is looked at)
        except OSError:
            return []
        for file in names:
            words = file.split(".")
            if len(words) == 5 and file.endswith(_ENDING) and words[0]:
                shelved = Shelved(int(words[1]), int(words[2]), words[3], self._folder / file)
                found.append((words[0], shelved))
        return found


def setup_of(component: Component) -> str:
    """Return a mark of all but rows that a component's table is built from."""
    bounds, tolerance = component.load_range, component.tolerance
    told = (
        component.fingerprint,
        component.linear,
        bounds.low.tobytes(),
        bounds.high.tobytes(),
        tolerance and (tolerance.translation, tolerance.rotation),
    )
    return hashlib.sha256(repr(told).encode()).hexdigest()[:16]
