"""Readers: what finds the interface's motion in the files an outside solver leaves.

A new one is a small class with the members of `Reader`, offered by an installed package under the
entry point group "wrenchbook.deck_readers":

    [project.entry-points."wrenchbook.deck_readers"]
    my-solver = "my_package:MyReader"

A bundle names it with ``output = {reader = "my-solver", ...}``. Often no reader is needed: let the
command be a script that runs the solver and writes six numbers, for the reader "numbers".
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import EntryPoints, entry_points
from pathlib import Path
from typing import Protocol

from fea.spec.schema import Deck

ENTRY_POINTS = "wrenchbook.deck_readers"


class OutputError(ValueError):
    """The interface's motion is not in the output; the message says what is missing where."""


@dataclass(frozen=True)
class Run:
    """Where one run of a deck left its files.

    Attributes
    ----------
    folder
        All of them.
    job
        The deck's name without its ending.
    printed
        The file with the program's standard output and errors.
    """

    folder: Path
    job: str
    printed: Path


@dataclass(frozen=True)
class Reading:
    """What was read.

    Attributes
    ----------
    displacement
        Six finite numbers: translation (in the deck's length unit) and rotation vector (rad).
    unknowns
        Degrees of freedom solved for; 0 where the solver does not tell.
    """

    displacement: tuple[float, ...]
    unknowns: int = 0


@dataclass(frozen=True)
class Complaint:
    """What a solver said went wrong: its own words, and whether it found no equilibrium."""

    quoted: str
    not_converged: bool = False


class Reader(Protocol):
    """What a deck asks of a reader; made without arguments."""

    moment: str
    """What this solver usually takes as moment: see `fea.spec.schema.Deck`."""
    keys: tuple[str, ...]
    """The keys of ``[deck] output`` it needs besides ``reader``."""

    def read(self, run: Run, told: Mapping[str, str]) -> Reading:
        """Return what the run found; raise `OutputError` if it cannot be read."""
        ...

    def complaint(self, run: Run) -> Complaint | None:
        """Return the errors the solver reported, None if it reported none."""
        ...

    def stage(self, run: Run) -> tuple[float, str] | None:
        """Return how far a run is, 0 to 1 and a message; None if that cannot be told."""
        ...

    def mistakes(self, text: str, deck: Deck) -> list[str]:
        """Return what is wrong with the text of a deck and its files, as far as can be told."""
        ...


class Numbers:
    """Reader "numbers": a text file of six numbers, written by the command itself.

    ``file`` names it; ``{job}`` stands for the deck's name without its ending. The numbers are the
    translation and the rotation vector, separated by blanks, commas or ends of line.
    """

    moment = "spatial"
    keys: tuple[str, ...] = ("file",)

    def read(self, run: Run, told: Mapping[str, str]) -> Reading:
        """Return the six numbers."""
        name = told["file"].replace("{job}", run.job)
        try:
            words = (run.folder / name).read_text(encoding="utf-8").replace(",", " ").split()
        except (OSError, UnicodeDecodeError):
            raise OutputError(f"There is no text file {name}.") from None
        if len(words) != 6:
            raise OutputError(f"{name} has {len(words)} numbers; it must have six.")
        return Reading(tuple(number(word, name) for word in words))

    def complaint(self, run: Run) -> Complaint | None:
        """Return None: the exit code tells."""
        return None

    def stage(self, run: Run) -> tuple[float, str] | None:
        """Return None: nothing is known of the command."""
        return None

    def mistakes(self, text: str, deck: Deck) -> list[str]:
        """Return nothing: the deck's language is not known."""
        return []


def number(word: str, where: str) -> float:
    """Return a word of a solver's output as a finite number.

    Fortran drops the letter of an exponent that has three digits: 0.1234567-101.

    Raises
    ------
    OutputError
        If it is none.
    """
    text = word
    for sign in "+-":
        head, found, digits = word.rpartition(sign)
        if found and head[-1:].isdigit() and digits.isdigit():
            text = f"{head}e{sign}{digits}"
    try:
        value = float(text)
    except ValueError:
        raise OutputError(f'{where} has "{word}" where a number should be.') from None
    if not math.isfinite(value):
        raise OutputError(f'{where} has "{word}": the solver came to no number.')
    return value


def reader_names() -> tuple[str, ...]:
    """Return the names of all readers there are."""
    return tuple(sorted({*_built_in(), *(entry.name for entry in _offered())}))


def reader_named(name: str) -> Reader:
    """Return the reader of that name.

    Raises
    ------
    KeyError
        If there is none.
    """
    if name in _built_in():
        return _built_in()[name]()
    for entry in _offered():
        if entry.name == name:
            return entry.load()()
    raise KeyError(name)


def _built_in() -> dict[str, type[Reader]]:
    from fea.readers.calculix_dat import CalculixDat  # which needs this module

    return {"calculix-dat": CalculixDat, "numbers": Numbers}


def _offered() -> EntryPoints:
    return entry_points(group=ENTRY_POINTS)
