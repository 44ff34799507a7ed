"""CSV text as numbered lines of fields: encodings, delimiters, comments, spreadsheet leftovers."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator

_SEPARATOR_LINE = re.compile(r'"?sep=(?P<mark>[,;\t|])"?[,;\t]*\s*', re.IGNORECASE)
# A line may begin with a spreadsheet's error value; it is a broken row, not a comment.
_SHEET_ERROR = re.compile(
    r"#(N/A|DIV/0!|REF!|VALUE!|NAME\?|NUM!|NULL!|NV|WERT!|BEZUG!|ZAHL!)", re.I
)
# As io.StringIO parts lines, which holds four bytes a character while it does.
_LINE = re.compile(r"[^\r\n]*(?:\r\n|\r|\n)|[^\r\n]+")
_IN_BRACKETS = re.compile(r"\[[^\]]*\]|\([^)]*\)|\"[^\"]*\"")


class UnreadableFileError(ValueError):
    """The bytes are no CSV text; the message says how to save the file."""


class BrokenLineError(ValueError):
    """A record that is no CSV, so that what follows it means nothing; `line` is where it begins."""

    def __init__(self, line: int, message: str) -> None:
        super().__init__(message)
        self.line = line


def decoded(text: str | bytes) -> str:
    """Return the text of a CSV file as a spreadsheet or a logger saves it.

    Parameters
    ----------
    text : str or bytes
        UTF-8 with or without mark, UTF-16 with mark, or Windows-1252.

    Raises
    ------
    UnreadableFileError
        If it is a spreadsheet file itself, or in none of these encodings.
    """
    if isinstance(text, str):
        return text.removeprefix("\ufeff")
    if text.startswith(b"PK\x03\x04"):
        raise UnreadableFileError("this is a spreadsheet or zip file; save it as CSV first")
    if text.startswith((b"\xff\xfe", b"\xfe\xff")):
        encodings = ("utf-16",)
    else:
        encodings = ("utf-8-sig", "cp1252")
    for encoding in encodings:
        try:
            return text.decode(encoding)
        except UnicodeDecodeError:
            continue
    raise UnreadableFileError("the text encoding cannot be told; save the file as UTF-8")


def delimiter_of(text: str) -> str:
    """Return the delimiter: told by a ``sep=`` line, else the header's ``;``, tab or ``,``."""
    for line in _lines(text):
        told = _SEPARATOR_LINE.fullmatch(line)
        if told:
            return told["mark"]
        if line.strip() and not is_comment(line):
            bare = _IN_BRACKETS.sub("", line)
            return next((mark for mark in ";\t" if mark in bare), ",")
    return ","


def _lines(text: str) -> Iterator[str]:
    """Yield the lines of a text with their ends: LF, CR or both."""
    return (found[0] for found in _LINE.finditer(text))


def is_comment(line: str) -> bool:
    """Tell whether a line is a comment: ``#`` first, and not a spreadsheet's error value."""
    return line.startswith("#") and not _SHEET_ERROR.match(line)


def records(text: str, delimiter: str) -> Iterator[tuple[int, list[str]]]:
    """Yield the line number, from 1, and the fields of each line that holds any.

    Parameters
    ----------
    text : str
        The whole file. A quoted field may hold line ends; its record has its first line's number.
    delimiter : str
        One character.

    Raises
    ------
    BrokenLineError
        If a quotation mark stays open or stands within a quoted field, or a field is longer than
        131,072 characters.
    """
    fresh = True

    def lines() -> Iterator[str]:
        # A comment is only one where a record begins, not inside a quoted note.
        nonlocal fresh
        for line in _lines(text):
            begins, fresh = fresh, False
            yield "\n" if begins and is_comment(line) else line

    # Strict: without it a quotation mark left open takes the lines below it into its field, and
    # ends with the file or the next mark, without a word.
    reader = csv.reader(lines(), delimiter=delimiter, skipinitialspace=True, strict=True)
    before = 0
    try:
        for fields in reader:
            fresh = True
            line, before = before + 1, reader.line_num
            if fields and (fields[0].strip() or any(field.strip() for field in fields)):
                yield line, fields
    except csv.Error as error:
        message = (
            f"cannot be read as CSV ({error}); is a quotation mark left open? Within a quoted "
            "text a quotation mark is written twice"
        )
        raise BrokenLineError(before + 1, message) from error


def is_separator_line(fields: list[str], delimiter: str) -> bool:
    """Tell whether a record is the ``sep=;`` line that spreadsheets put first."""
    return bool(_SEPARATOR_LINE.fullmatch(delimiter.join(fields))) or (
        len(fields) > 1 and fields[0].lower() in ("sep=", '"sep=') and not any(fields[1:])
    )
