"""An attempt's folder as a zip: what lies in it, and nothing that it points to."""

from __future__ import annotations

import os
import stat
import tempfile
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Final

from wrenchbook.service.files.redact import redact

MOST_BYTES: Final = 1 << 30  # of all files together; a deck's solver may leave any number
_MOST_TEXT: Final = 8 << 20
_PIECE: Final = 1 << 18
_TEXTS: Final = (".txt", ".json", ".log")
_LEFT_OUT: Final = "LEFT_OUT.txt"


def zipped(folder: Path) -> IO[bytes]:
    """Return a file that holds the zip of a folder.

    Links and whatever else is no plain file are left out: a deck's command may have made them, to
    anything on the machine. Texts lose the paths of the machine.
    """
    file = tempfile.SpooledTemporaryFile(_MOST_TEXT)  # noqa: SIM115 (closed by the reader)
    left, missing = MOST_BYTES, []
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for path in _files(folder):
            inside = path.relative_to(folder).as_posix()
            size = _put(archive, path, inside, left)
            if size is None:
                missing.append(inside)
            else:
                left -= size
        if missing:
            header = "links, files that are gone, or too large to be sent:"
            archive.writestr(_LEFT_OUT, "\n".join([header, *sorted(missing)]))
    file.seek(0)
    return file  # pyright: ignore[reportReturnType]


def pieces_of(file: IO[bytes]) -> Iterator[bytes]:
    """Yield a file's content, and close it."""
    with file:
        while piece := file.read(_PIECE):
            yield piece


def _files(folder: Path) -> list[Path]:
    """Return all that is in a folder and no folder; links to folders are not followed."""
    found = []
    for where, folders, names in os.walk(folder, followlinks=False):
        links = [name for name in folders if (Path(where) / name).is_symlink()]
        found += [Path(where) / name for name in (*names, *links)]
    return sorted(found)


def _put(archive: zipfile.ZipFile, path: Path, inside: str, left: int) -> int | None:
    """Put a file into the zip and return its size; None if it is left out."""
    try:
        # Opened first and looked at then: between the two it could become a link.
        descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
    except OSError:
        return None
    with open(descriptor, "rb") as file:  # noqa: PTH123 (a descriptor)
        found = os.fstat(descriptor)
        if not stat.S_ISREG(found.st_mode) or found.st_size > left:
            return None
        if path.suffix in _TEXTS and found.st_size <= _MOST_TEXT:
            archive.writestr(inside, redact(file.read().decode(errors="replace")))
            return found.st_size
        with archive.open(inside, "w", force_zip64=True) as target:
            size = 0
            while (piece := file.read(_PIECE)) and size <= left:
                target.write(piece)
                size += len(piece)
        return size
