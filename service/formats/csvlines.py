"""CSV text as numbered lines of fields: encodings, delimiters, comments, spreadsheet leftovers."""

from __future__ import annotations

import codecs
import csv
import io
import re
from collections.abc import Callable, Iterator
from functools import partial
from itertools import chain, islice
from pathlib import Path
from typing import BinaryIO

from service.formats.preamble import Preamble
from service.formats.titles import delimiter_in

MOST_LINE = 1 << 20  # characters; a table's widest row, 54 numbers and three texts, has a few 1000
MOST_RECORD = 4 * MOST_LINE  # a quoted text may go on over many lines
MOST_BLANK = 1 << 20  # lines one after the other: a spreadsheet has no more in all
_BLOCK = 1 << 20  # bytes at once
_MOST_LOOKED_AT = 200  # lines for a header below titles, blank ones and comments among them

_SEPARATOR_LINE = re.compile(r'"?sep=(?P<mark>[,;\t|])"?[,;\t]*\s*', re.IGNORECASE)
# A line may begin with a spreadsheet's error value; it is a broken row, not a comment.
_SHEET_ERROR = re.compile(
    r"#(N/A|DIV/0!|REF!|VALUE!|NAME\?|NUM!|NULL!|NV|WERT!|BEZUG!|ZAHL!)", re.I
)
# As io.StringIO parts lines, which holds four bytes a character while it does.
_LINE = re.compile(r"[^\r\n]*(?:\r\n|\r|\n)|[^\r\n]+")
_IN_BRACKETS = re.compile(r"\[[^\]]*\]|\([^)]*\)|\"[^\"]*\"")

_NO_CSV = (
    "cannot be read as CSV ({}); is a quotation mark left open? Within a quoted text a quotation "
    "mark is written twice"
)


class UnreadableFileError(ValueError):
    """The bytes are no CSV text; the message says how to save the file."""


class BrokenLineError(ValueError):
    """A record that is no CSV, so that what follows it means nothing; `line` is where it begins."""

    def __init__(self, line: int, message: str) -> None:
        super().__init__(message)
        self.line = line


Lines = Callable[[], Iterator[str]]
"""The lines of a file with their ends, LF, CR or both, from its beginning at each call."""


def lines_of_text(text: str | bytes) -> Lines:
    """Return the lines of a text as a spreadsheet or a logger saves it."""
    if isinstance(text, bytes):
        return partial(_read_lines, partial(io.BytesIO, text))
    content = text.removeprefix("\ufeff")
    return lambda: (_short(found[0]) for found in _LINE.finditer(content))


def lines_of_file(path: Path) -> Lines:
    """Return the lines of a file; only some of it is in memory at a time."""
    return partial(_read_lines, partial(path.open, "rb"))


def _read_lines(opened: Callable[[], BinaryIO]) -> Iterator[str]:
    """Yield the lines of a file of bytes.

    Raises
    ------
    UnreadableFileError
        If it is a spreadsheet file itself, or in no encoding that can be told.
    BrokenLineError
        If a line is longer than any of a table.
    """
    with opened() as content:
        encoding = _encoding(content)
        content.seek(0)
        text = io.TextIOWrapper(content, encoding=encoding, newline="")
        number = 0
        while line := text.readline(MOST_LINE):
            number += 1
            yield _short(line, number)


def _encoding(content: BinaryIO) -> str:
    """Tell UTF-8 with or without mark, UTF-16 with mark, and Windows-1252."""
    head = content.read(4)
    if head.startswith(b"PK\x03\x04"):
        raise UnreadableFileError("this is a spreadsheet or zip file; save it as CSV first")
    utf16 = head.startswith((b"\xff\xfe", b"\xfe\xff"))
    for encoding in ("utf-16",) if utf16 else ("utf-8-sig", "cp1252"):
        content.seek(0)
        decoder = codecs.getincrementaldecoder(encoding)()
        try:
            while block := content.read(_BLOCK):
                decoder.decode(block)
            decoder.decode(b"", final=True)
        except UnicodeDecodeError:
            continue
        return encoding
    raise UnreadableFileError("the text encoding cannot be told; save the file as UTF-8")


def _short(line: str, number: int = 0) -> str:
    if len(line) >= MOST_LINE:
        message = f"is longer than {MOST_LINE:,} characters; is it a table at all?"
        raise BrokenLineError(number, message)
    return line


def delimiter_of(lines: Iterator[str]) -> str:
    """Return the delimiter: told by a ``sep=`` line, else by the header (see `delimiter_in`)."""
    for number, line in enumerate(lines, 1):
        _refuse_blank(number, number)
        told = _SEPARATOR_LINE.fullmatch(line)
        if told:
            return told["mark"]
        if _may_be_header(line):
            rest = (below for below in islice(lines, _MOST_LOOKED_AT) if _may_be_header(below))
            return delimiter_in(chain([line], rest), lambda text: _IN_BRACKETS.sub("", text))
    return ","


def _may_be_header(line: str) -> bool:
    return bool(line.strip()) and not is_comment(line) and not _is_preamble(line)


def _is_preamble(line: str) -> bool:
    try:
        return Preamble().take([line.strip().strip('"')])
    except ValueError:
        return True


def _refuse_blank(count: int, line: int) -> None:
    """Refuse a file of line ends: half a megabyte gzipped would keep its reader for minutes."""
    if count > MOST_BLANK:
        raise BrokenLineError(
            line, f"comes after {MOST_BLANK:,} lines without a row; is it a table at all?"
        )


def is_comment(line: str) -> bool:
    """Tell whether a line is a comment: ``#`` first, and not a spreadsheet's error value."""
    return line.startswith("#") and not _SHEET_ERROR.match(line)


def records(content: Iterator[str], delimiter: str) -> Iterator[tuple[int, list[str]]]:
    """Yield the line number, from 1, and the fields of each line that holds any.

    Parameters
    ----------
    content : iterator of str
        The lines. A quoted field may hold line ends; its record has its first line's number.
    delimiter : str
        One character.

    Raises
    ------
    BrokenLineError
        If a quotation mark stays open or stands within a quoted field, or a field is longer than
        131,072 characters.
    """
    fresh, length = True, 0

    def lines() -> Iterator[str]:
        # A comment is only one where a record begins, not inside a quoted note.
        nonlocal fresh, length
        for line in content:
            begins, fresh = fresh, False
            length = len(line) if begins else length + len(line)
            if length > MOST_RECORD:
                raise csv.Error(f"a record longer than {MOST_RECORD:,} characters")
            yield "\n" if begins and is_comment(line) else line

    # Strict: without it a quotation mark left open takes the lines below it into its field, and
    # ends with the file or the next mark, without a word.
    reader = csv.reader(lines(), delimiter=delimiter, skipinitialspace=True, strict=True)
    before = row = 0
    try:
        for fields in reader:
            fresh = True
            line, before = before + 1, reader.line_num
            if fields and (fields[0].strip() or any(field.strip() for field in fields)):
                row = before
                yield line, fields
            else:
                _refuse_blank(before - row, line)
    except csv.Error as error:
        raise BrokenLineError(before + 1, _NO_CSV.format(error)) from error


def is_separator_line(fields: list[str], delimiter: str) -> bool:
    """Tell whether a record is the ``sep=;`` line that spreadsheets put first."""
    return bool(_SEPARATOR_LINE.fullmatch(delimiter.join(fields))) or (
        len(fields) > 1 and fields[0].lower() in ("sep=", '"sep=') and not any(fields[1:])
    )
