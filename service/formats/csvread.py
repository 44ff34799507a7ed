"""Read a CSV table: units in the header, every bad row named by line, field and reason.

A file may use ``,``, ``;`` or tab between fields, and with the last two a decimal comma. Where the
only marks in its numbers could part thousands as well (``1,234``), the sender is asked which it is,
because a guess would be wrong by a factor of 1000 without a word. Lines that begin with ``#`` are
comments; blank lines count in the numbering but hold no row. See `header` for the columns.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Literal

from service.formats.csvlines import (
    BrokenLineError,
    Lines,
    UnreadableFileError,
    delimiter_of,
    is_separator_line,
    lines_of_file,
    lines_of_text,
    records,
)
from service.formats.header import Header
from service.formats.mistakes import RowError
from service.formats.options import Options, Told
from service.formats.parsed import ParsedTable, joined
from service.formats.sheet import Mark, Record, decimal_mark, holds_rows, tables
from surrogate.table.rows import LoadRange


def read_csv(
    text: str | bytes,
    *,
    decimal: Literal[".", ","] | None = None,
    load_range: LoadRange | None = None,
    missing_loads: Literal["zero"] | None = None,
) -> ParsedTable:
    r"""Read a CSV table into SI arrays.

    Parameters
    ----------
    text : str or bytes
        The whole file.
    decimal : {".", ","}, optional
        The decimal mark; told from the numbers if not given.
    load_range : LoadRange, optional
        The component's, N and N·m: loads far beyond it are mistakes (see `limits`).
    missing_loads : {"zero"}, optional
        What the loads are that the file has no column for; without it such a file is refused.

    Returns
    -------
    ParsedTable
        The rows without a mistake, and all mistakes. `RowError.row` is the line of the file,
        from 1, `RowError.field` the column as the header writes it. A mistake in the header leaves
        no rows, because without it no number has a meaning.

    Examples
    --------
    >>> table = read_csv("fx [N],fy [N],fz [N],mx [N*m],my [N*m],mz [N*m],uz [mm]\n"
    ...                  "0,0,-100,0,0,0,-1.5\n")
    >>> table.displacement[0, 2]
    np.float64(-0.0015)
    """
    told = Told(format="csv")
    said = Options(decimal=decimal, load_range=load_range, missing_loads=missing_loads)
    return joined(list(csv_tables(lines_of_text(text), said, told)), told.mistakes)


def csv_file(path: Path, options: Options, told: Told) -> Iterator[ParsedTable]:
    """Yield the good rows of a CSV file piece by piece; `told` gets what is wrong."""
    return csv_tables(lines_of_file(path), options, told)


def csv_tables(lines: Lines, options: Options, told: Told) -> Iterator[ParsedTable]:
    """Yield the good rows of lines that can be read more than once."""
    try:
        delimiter = delimiter_of(lines())
    except UnreadableFileError as error:
        told.mistakes.ruin(RowError(0, "file", str(error)))
        return
    except BrokenLineError as error:
        told.mistakes.ruin(RowError(error.line, "line", str(error)))
        return

    def rows() -> Iterator[Record]:
        found = records(lines(), delimiter)
        for first in found:
            if not is_separator_line(first[1], delimiter):
                yield first
            break
        yield from found

    def check(fields: list[str], header: Header) -> str:
        return _problem(fields, header, delimiter)

    if options.decimal is not None or delimiter == ",":
        mark = Mark(options.decimal == ",")
    else:
        mark = decimal_mark(rows(), options)
    yield from tables(rows(), options, told, replace(mark, escaped=True), check)


def _problem(fields: list[str], header: Header, delimiter: str) -> str:
    """Say what is wrong with a record as a line of its file; an empty text if nothing is."""
    width, text = header.width, "".join(fields)
    broken = "\n" in text or "\r" in text
    if len(fields) != width:
        message = f"has {len(fields)} fields, the header {width}"
        if broken:
            message += "; is a quotation mark left open?"
        elif len(fields) > width and delimiter == ",":
            message += "; decimal commas need ; between the fields, a comma in a note needs quotes"
        return message
    if broken and holds_rows(fields, header, delimiter):
        return "a quoted text holds a whole row of the table; is a quotation mark left open?"
    return ""
