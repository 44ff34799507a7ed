"""Write a table as CSV text that `read_csv` reads back to the same numbers and texts."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Iterator, Mapping

from service.formats.layout import Layout, layout_of
from service.formats.parsed import TableRows
from service.formats.sheettext import guarded


def write_csv(table: TableRows, units: Mapping[str, str] | None = None) -> str:
    """Write rows as CSV with units in the header.

    Parameters
    ----------
    table : TableRows
        Rows in SI. Uncertainty and tangent columns are there only if one is known (NaN is left
        empty), source, note and fingerprint only if one is not empty.
    units : mapping, optional
        Any of ``force``, ``moment``, ``translation``, ``rotation`` to the unit to write in, such as
        ``{"force": "lbf", "translation": "mm"}``; SI otherwise. In every unit a number is written
        with the digits that `read_csv` turns into the same float.

    Returns
    -------
    str
        Lines end in a line feed.

    Raises
    ------
    UnitError
        If a unit does not measure its quantity.
    """
    return "".join(csv_text([table], layout_of(table, units)))


def csv_text(
    pieces: Iterable[TableRows], layout: Layout, comments: Iterable[str] = ()
) -> Iterator[str]:
    """Yield the text of a CSV: comments, header, and the rows of each piece.

    A text that a spreadsheet would take for a formula has a ``'`` before it, which an import takes
    off.
    """
    for comment in comments:
        yield "# " + " ".join(comment.split()) + "\n"
    out = _Lines()
    writer = csv.writer(out, lineterminator="\r\n")
    writer.writerow(layout.labels())
    yield out.taken()
    for piece in pieces:
        numbers = [column.digits(piece) for column in layout.numbers]
        texts = [[guarded(word) for word in words] for words in layout.words(piece)]
        writer.writerows(zip(*numbers, *texts, strict=True))
        yield out.taken()


class _Lines(list[str]):
    r"""Collects lines that end in ``\n``, from a writer that ends them in ``\r\n``.

    Python's writer quotes a text with a carriage return only if the line end has one.
    """

    def write(self, line: str) -> None:
        self.append(line.removesuffix("\r\n") + "\n")

    def taken(self) -> str:
        """Return what there is, and forget it."""
        text = "".join(self)
        self.clear()
        return text
