"""What people write above the header of a table, and which line is the header.

A sheet is often headed by its title, a date, the name of a rig. A line is a header by what it
names: where the first line does not name several columns and one shortly below does, that is the
header, and what stands above it is told and left out. Nothing else is guessed: where no line
names columns, or a row of numbers comes first, the first line is taken for a header and refused for
what is wrong with it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import chain, islice

from service.formats.decimalmark import plain
from service.formats.spelling import NUMBERS, TEXTS, TIME_COLUMN, readings
from service.formats.units import UnitError

MOST_LINES = 30  # of titles: what a page of a report has above its table, or less
MOST_COLUMNS = 256  # a name nobody knows is compared with all that are known: 0.3 ms each
_SURE_MARKS, _OTHER_MARKS = ";\t", ",|"  # what parts fields: the former stand in no label
_SEVERAL = 2  # one word in a title may be a column's name ("Fx test, 3 mm")
_MOST_LABEL = 200  # characters; a title is no label

Record = tuple[int, list[str]]


def named_columns(cells: Sequence[str], mapping: Mapping[str, str] | None = None) -> int:
    """Return how many cells name a column of a table, or one that the sender has named."""
    told = {" ".join(name.split()).lower() for name in mapping or ()}
    return sum(_names(" ".join(cell.split()), told) for cell in cells[:MOST_COLUMNS])


def _names(label: str, told: set[str]) -> bool:
    if not label or len(label) > _MOST_LABEL:
        return False
    if label.lower() in told:
        return True
    try:
        return any(name in (*NUMBERS, *TEXTS, TIME_COLUMN) for name, _, _ in readings(label))
    except UnitError:
        return False


def is_number(cell: str) -> bool:
    """Tell whether a cell holds a number, whatever its decimal mark."""
    return plain(cell.replace(",", "."), False) is not None


def below_titles(
    first: Record, rest: Iterator[Record], mapping: Mapping[str, str]
) -> tuple[list[str], Record, Iterator[Record]]:
    """Return the lines above the header as text, the header, and the records below it.

    Parameters
    ----------
    first : (int, list of str)
        The first record of the file that holds anything.
    rest : iterator of (int, list of str)
        Those below it.
    mapping : mapping of str to str
        Columns that the sender has named.
    """
    if named_columns(first[1], mapping) >= _SEVERAL or _is_row(first[1]):
        return [], first, rest
    above = [first]
    for record in islice(rest, MOST_LINES):
        if _is_row(record[1]):
            rest = chain([record], rest)
            break
        if named_columns(record[1], mapping) >= _SEVERAL:
            return [_text(cells) for _, cells in above], record, rest
        above.append(record)
    return [], first, chain(above[1:], rest)


def delimiter_in(lines: Iterator[str], bare: Callable[[str], str]) -> str:
    """Return what parts the fields of the header, of the first line where none names columns.

    ``;`` or tab if it has one, else what of the comma and ``|`` parts more columns' names.

    Parameters
    ----------
    lines : iterator of str
        From the first that may be a header on.
    bare : callable
        Returns a line without what stands in brackets, where units may hold such marks.
    """
    found = [bare(line) for line in islice(lines, MOST_LINES + 1)]
    header = next((line for line in found if _names_several(line)), found[0])
    sure = next((mark for mark in _SURE_MARKS if mark in header), "")
    return sure or max(_OTHER_MARKS, key=lambda mark: named_columns(header.split(mark)))


def _names_several(line: str) -> bool:
    marks = _SURE_MARKS + _OTHER_MARKS
    return any(named_columns(line.split(mark, MOST_COLUMNS)) >= _SEVERAL for mark in marks)


def _is_row(cells: list[str]) -> bool:
    """Tell whether all cells that hold anything hold numbers, and there are several."""
    held = [cell for cell in cells if cell.strip()]
    return len(held) >= _SEVERAL and all(is_number(cell) for cell in held)


def _text(cells: list[str]) -> str:
    return " ".join(cell.strip() for cell in cells if cell.strip())[:_MOST_LABEL]
