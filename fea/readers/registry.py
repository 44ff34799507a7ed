"""The readers by name: CalculiX, six numbers in a file, and those that installed packages offer.

A new one is a small class with the members of `fea.readers.reader.DeckReader`, offered under the
entry point group "wrenchbook.deck_readers":

    [project.entry-points."wrenchbook.deck_readers"]
    my-solver = "my_package:MyReader"

A bundle names it with ``output = {reader = "my-solver", ...}``. Often no reader is needed: let the
command be a script that runs the solver and writes six numbers, for the reader "numbers".
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib.metadata import EntryPoints, entry_points

from wrenchbook.fea.readers.calculix_dat import CalculixDat
from wrenchbook.fea.readers.reader import (
    Complaint,
    DeckReader,
    DeckRun,
    OutputError,
    Reading,
    number,
)
from wrenchbook.fea.spec.schema import Deck


class NumbersReader:
    """Reader "numbers": a text file of six numbers, written by the command itself.

    ``file`` names it; ``{job}`` stands for the deck's name without its ending. The numbers are the
    translation and the rotation vector, separated by blanks, commas or ends of line.
    """

    moment = "spatial"
    keys: tuple[str, ...] = ("file",)

    def read(self, run: DeckRun, options: Mapping[str, str]) -> Reading:
        """Return the six numbers."""
        name = options["file"].replace("{job}", run.job)
        try:
            texts = (run.folder / name).read_text(encoding="utf-8").replace(",", " ").split()
        except (OSError, UnicodeDecodeError):
            raise OutputError(f"There is no text file {name}.") from None
        if len(texts) != 6:
            raise OutputError(f"{name} has {len(texts)} numbers; it must have six.")
        return Reading(tuple(number(word, name) for word in texts))

    def complaint(self, run: DeckRun) -> Complaint | None:
        """Return None: the exit code shows a failure."""
        return None

    def stage(self, run: DeckRun) -> tuple[float, str] | None:
        """Return None: nothing is known of the command."""
        return None

    def mistakes(self, text: str, deck: Deck) -> list[str]:
        """Return nothing: the deck's language is not known."""
        return []


ENTRY_POINTS = "wrenchbook.deck_readers"
"""The group of entry points under which packages offer readers."""

_BUILT_IN: dict[str, type[DeckReader]] = {"calculix-dat": CalculixDat, "numbers": NumbersReader}


def reader_names() -> tuple[str, ...]:
    """Return the names of all readers there are."""
    return tuple(sorted({*_BUILT_IN, *(entry.name for entry in _offered())}))


def reader_named(name: str) -> DeckReader:
    """Return the reader of that name.

    Raises KeyError if there is none.
    """
    if name in _BUILT_IN:
        return _BUILT_IN[name]()
    for entry in _offered():
        if entry.name == name:
            return entry.load()()
    raise KeyError(name)


def _offered() -> EntryPoints:
    return entry_points(group=ENTRY_POINTS)
