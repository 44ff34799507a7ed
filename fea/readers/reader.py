"""Protocol of a reader: it finds the interface's motion in the files an outside solver leaves.

How to add one is in `fea.readers.registry`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from wrenchbook.fea.spec.schema import Deck


class OutputError(ValueError):
    """The interface's motion is not in the output; the message says what is missing where."""


@dataclass(frozen=True)
class DeckRun:
    """Where one run of a deck left its files."""

    folder: Path  # all of them
    job: str  # the deck's name without its ending
    printed: Path  # the file with the program's standard output and errors


@dataclass(frozen=True)
class Reading:
    """The motion read from an output."""

    # Six finite numbers: translation (in the deck's length unit) and rotation vector (rad)
    displacement: tuple[float, ...]
    unknowns: int = 0  # degrees of freedom solved for; 0 where the solver does not print them


@dataclass(frozen=True)
class Complaint:
    """An error that a solver reports: its own words, and whether it found no equilibrium."""

    quoted: str
    not_converged: bool = False


class DeckReader(Protocol):
    """A reader of an outside solver's output; made without arguments."""

    moment: str
    """The usual moment of this solver: see `fea.spec.schema.Deck`."""
    keys: tuple[str, ...]
    """The keys of ``[deck] output`` it needs besides ``reader``."""

    def read(self, run: DeckRun, options: Mapping[str, str]) -> Reading:
        """Return the motion that the run found; raise `OutputError` if it cannot be read."""
        ...

    def complaint(self, run: DeckRun) -> Complaint | None:
        """Return the errors the solver reported, None if it reported none."""
        ...

    def stage(self, run: DeckRun) -> tuple[float, str] | None:
        """Return how far a run is, 0 to 1 and a message; None if that is unknown."""
        ...

    def mistakes(self, text: str, deck: Deck) -> list[str]:
        """Return mistakes in the text of a deck and its files that show without a run."""
        ...


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
