"""The readers there are, by name: those of this room, and those that installed packages offer.

A new one is a small class with the members of `fea.readers.reader.Reader`, offered under the entry
point group "wrenchbook.deck_readers":

    [project.entry-points."wrenchbook.deck_readers"]
    my-solver = "my_package:MyReader"

A bundle names it with ``output = {reader = "my-solver", ...}``. Often no reader is needed: let the
command be a script that runs the solver and writes six numbers, for the reader "numbers".
"""

from __future__ import annotations

from importlib.metadata import EntryPoints, entry_points

from wrenchbook.fea.readers.calculix_dat import CalculixDat
from wrenchbook.fea.readers.numbers import NumbersReader
from wrenchbook.fea.readers.reader import DeckReader

ENTRY_POINTS = "wrenchbook.deck_readers"
"""The group of entry points under which packages offer readers."""

_BUILT_IN: dict[str, type[DeckReader]] = {"calculix-dat": CalculixDat, "numbers": NumbersReader}


def reader_names() -> tuple[str, ...]:
    """Return the names of all readers there are."""
    return tuple(sorted({*_BUILT_IN, *(entry.name for entry in _offered())}))


def reader_named(name: str) -> DeckReader:
    """Return the reader of that name.

    Raises
    ------
    KeyError
        If there is none.
    """
    if name in _BUILT_IN:
        return _BUILT_IN[name]()
    for entry in _offered():
        if entry.name == name:
            return entry.load()()
    raise KeyError(name)


def _offered() -> EntryPoints:
    return entry_points(group=ENTRY_POINTS)
