"""Read a CSV table: units in the header, every bad row named by line, field and reason.

A file may use ``,``, ``;`` or tab between fields, and with the last two a decimal comma. Where the
only marks in its numbers could part thousands as well (``1,234``), the sender is asked which it is,
because a guess would be wrong by a factor of 1000 without a word. Lines that begin with ``#`` are
comments; blank lines count in the numbering but hold no row. See `header` for the columns.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field

from service.tablefile import header as head
from service.tablefile.csvcolumns import Columns
from service.tablefile.csvlines import (
    BrokenLineError,
    UnreadableFileError,
    decoded,
    delimiter_of,
    is_separator_line,
    records,
)
from service.tablefile.decimalmark import plain
from service.tablefile.header import Header
from service.tablefile.parsed import ParsedTable, RowError, refused
from surrogate.table.rows import LoadRange

_LINE_END = re.compile(r"\r\n|\r|\n")


@dataclass
class _Body:
    """The lines below the header that have the right number of fields."""

    line: list[int] = field(default_factory=list)
    fields: list[list[str]] = field(default_factory=list)
    errors: list[RowError] = field(default_factory=list)


def read_csv(
    text: str | bytes, *, decimal: str | None = None, load_range: LoadRange | None = None
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

    Returns
    -------
    ParsedTable
        The rows without a mistake, and all mistakes. `RowError.row` is the line of the file,
        from 1, `RowError.field` the column as the header writes it. A mistake in the header leaves
        no rows, because without it no number has a meaning.

    Examples
    --------
    >>> table = read_csv("fz [lbf],ux [mm],uy [mm],uz [mm],rx [deg],ry [deg],rz [deg]\n"
    ...                  "-100,0,0,-1.5,0,0,0\n")
    >>> table.displacement[0, 2]
    np.float64(-0.0015)
    """
    try:
        content = decoded(text)
    except UnreadableFileError as error:
        return refused([RowError(0, "file", str(error))])
    delimiter = delimiter_of(content)
    header, body = _split(content, delimiter)
    if header.errors:
        return refused(header.errors)
    if not body.line and not body.errors:
        body.errors.append(RowError(0, "file", "there is a header but no row below it"))
    columns = Columns(header, body.line, body.fields, body.errors)
    columns.take_decimal_mark(decimal, delimiter)
    return columns.table(load_range)


def _split(content: str, delimiter: str) -> tuple[Header, _Body]:
    """Part the text into its header and the rows below."""
    lines = records(content, delimiter)
    header, body = Header(0), _Body()
    try:
        for line, fields in lines:
            if not is_separator_line(fields, delimiter):
                header = _header(fields, line)
                break
        else:
            header.errors.append(RowError(0, "file", "the file is empty"))
        for line, fields in lines:
            _take(body, header, line, fields, delimiter)
    except BrokenLineError as error:
        body.errors.append(RowError(error.line, "line", str(error)))
    return header, body


def _header(fields: list[str], line: int) -> Header:
    """Read the header, or say that there is none."""
    if all(plain(cell.replace(",", "."), False) is not None for cell in fields if cell.strip()):
        message = (
            "there is no header; the first line must name the columns with units, such as "
            "fx [N], ux [mm] (a line that begins with # is a comment)"
        )
        return Header(0, errors=[RowError(line, "header", message)])
    return head.read_header(fields, line)


def _take(body: _Body, header: Header, line: int, fields: list[str], delimiter: str) -> None:
    """Add a line to the body if it has as many fields as the header, and is one line's."""
    width = header.width
    if len(fields) > width and not any(cell.strip() for cell in fields[width:]):
        fields = fields[:width]  # a spreadsheet's empty columns on the right
    message = ""
    if len(fields) != width:
        message = f"has {len(fields)} fields, the header {width}"
        if any("\n" in cell for cell in fields):
            message += "; is a quotation mark left open?"
        elif len(fields) > width and delimiter == ",":
            message += "; decimal commas need ; between the fields, a comma in a note needs quotes"
    elif any("\n" in cell or "\r" in cell for cell in fields) and _holds_rows(
        fields, header, delimiter
    ):
        message = "a quoted text holds a whole row of the table; is a quotation mark left open?"
    if message:
        body.errors.append(RowError(line, "line", message))
    else:
        body.line.append(line)
        body.fields.append(fields)


def _holds_rows(fields: list[str], header: Header, delimiter: str) -> bool:
    """Tell whether two lines of a record are rows by themselves: its quote has swallowed some.

    A text of several lines leaves one such line at most, the one that its numbers stand on.
    """
    places = [column.place for name, column in header.columns.items() if name in head.NUMBERS]
    rows = 0
    for line in _LINE_END.split(delimiter.join(fields)):
        cells = [cell.strip().replace(",", ".") for cell in line.split(delimiter)]
        if len(cells) >= header.width:
            numbers = [cells[place] for place in places if cells[place]]
            rows += bool(numbers) and all(plain(number, False) is not None for number in numbers)
    return rows > 1
