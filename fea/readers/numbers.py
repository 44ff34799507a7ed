"""Reader "numbers": six numbers in a text file."""

from __future__ import annotations

from collections.abc import Mapping

from wrenchbook.fea.readers.reader import Complaint, DeckRun, OutputError, Reading, number
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
            words = (run.folder / name).read_text(encoding="utf-8").replace(",", " ").split()
        except (OSError, UnicodeDecodeError):
            raise OutputError(f"There is no text file {name}.") from None
        if len(words) != 6:
            raise OutputError(f"{name} has {len(words)} numbers; it must have six.")
        return Reading(tuple(number(word, name) for word in words))

    def complaint(self, run: DeckRun) -> Complaint | None:
        """Return None: the exit code tells."""
        return None

    def stage(self, run: DeckRun) -> tuple[float, str] | None:
        """Return None: nothing is known of the command."""
        return None

    def mistakes(self, text: str, deck: Deck) -> list[str]:
        """Return nothing: the deck's language is not known."""
        return []
