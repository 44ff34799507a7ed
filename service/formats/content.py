"""Which form a table file has, by what is in it; and what a gzipped one unpacks to."""

from __future__ import annotations

import codecs
import gzip
import zipfile
import zlib
from pathlib import Path

from service.formats.options import Format

MOST_BYTES = 512 * 1024 * 1024
"""Of a file, packed or not: two million rows of 12 numbers, or a million with 17 digits each."""

_BLOCK = 1 << 20
_HDF5 = b"\x89HDF\r\n\x1a\n"
_HDF5_PLACES = (0, 512, 1024, 2048)  # behind a user block
_WHAT = {
    b"%PDF": "a PDF; export the table as CSV or XLSX",
    b"\xd0\xcf\x11\xe0": "an old .xls workbook; save it as .xlsx",
    b"\x89PNG": "a picture",
    b"Rar!": "a RAR archive; unpack it first",
    b"7z\xbc\xaf": "a 7z archive; unpack it first",
    b"BZh": "packed by bzip2; pack it by gzip, or not at all",
    b"\xfd7zXZ": "packed by xz; pack it by gzip, or not at all",
    b"\x28\xb5\x2f\xfd": "packed by zstd; pack it by gzip, or not at all",
}


class ContentError(ValueError):
    """The file is no table that can be read; the message says what it seems to be."""


def is_gzip(path: Path) -> bool:
    """Tell whether a file is gzipped."""
    with path.open("rb") as file:
        return file.read(2) == b"\x1f\x8b"


def unpack(path: Path, target: Path, most: int = MOST_BYTES) -> None:
    """Write what a gzipped file unpacks to, and no more than `most` bytes of it.

    Raises
    ------
    ContentError
        If it is more, damaged, or gzipped twice.
    """
    written = 0
    try:
        with gzip.open(path) as content, target.open("wb") as unpacked:
            while block := content.read(_BLOCK):
                written += len(block)
                if written > most:
                    raise ContentError(f"unpacks to more than {most >> 20} MiB; send parts")
                unpacked.write(block)
    except (OSError, EOFError, zlib.error) as error:
        raise ContentError(f"is a damaged gzip file ({error}); send it again") from error
    if is_gzip(target):
        raise ContentError("is gzipped twice; send it gzipped once, or not at all")


def format_of(path: Path) -> Format:
    """Return the form of a file, told from its content.

    Raises
    ------
    ContentError
        If it is none of a table's.
    """
    with path.open("rb") as file:
        head = file.read(4096)
    if head.startswith(b"PAR1"):
        return "parquet"
    if any(head[place : place + 8] == _HDF5 for place in _HDF5_PLACES):
        return "hdf5"
    if head.startswith(b"PK\x03\x04"):
        return _of_zip(path)
    for magic, what in _WHAT.items():
        if head.startswith(magic):
            raise ContentError(f"is {what}")
    utf16 = head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    if _is_wide_text(head, utf16):
        raise ContentError(
            "is text in UTF-32, or in UTF-16 without the mark at its beginning; save it as UTF-8"
        )
    if b"\0" in head and not utf16:
        raise ContentError(
            "is no table: it holds zero bytes. Send CSV, XLSX, Parquet, JSON or the HDF5 of an "
            "export, each gzipped if you like"
        )
    text = head.removeprefix(codecs.BOM_UTF8).lstrip()
    return "json" if text[:1] in (b"{", b"[") else "csv"


def _is_wide_text(head: bytes, utf16: bool) -> bool:
    """Tell whether a file is of characters wider than a byte, in a form that is not read.

    A header in Latin letters has a zero byte in every second place, or in three of four.
    """
    start = head[: len(head) // 4 * 4]
    zeros = [start[place::4].count(0) * 4 / max(len(start), 1) for place in range(4)]
    wide = [share > 0.8 for share in zeros]
    return sum(wide) == 3 or (not utf16 and wide in ([True, False] * 2, [False, True] * 2))


def _of_zip(path: Path) -> Format:
    try:
        with zipfile.ZipFile(path) as archive:
            names = {name for name in archive.namelist() if len(name) < 100}
    except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError) as error:
        raise ContentError(f"is a damaged zip file or workbook ({error})") from error
    if "[Content_Types].xml" in names and any(name.startswith("xl/") for name in names):
        return "xlsx"
    raise ContentError("is a zip file and no XLSX workbook; unpack it and send the table")
