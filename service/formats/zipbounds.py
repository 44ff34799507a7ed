"""Zip files from outside: what they unpack to, measured before anybody else unpacks them."""

from __future__ import annotations

import zipfile
import zlib
from pathlib import Path

MOST_MEMBERS = 1000
_BLOCK = 1 << 20
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)


class ZipBoundsError(ValueError):
    """The archive is damaged, or unpacks to more than it may; the message says which."""


def members_of(path: Path, most: int) -> dict[str, int]:
    """Return the members of a zip file, with their bytes, that unpacks to at most `most` of them.

    Every member is unpacked once, to nowhere: what the directory says of sizes can be a lie.

    Raises
    ------
    ZipBoundsError
        If it is not so.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
            _check_directory(members, most)
            sizes: dict[str, int] = {}
            for member in members:
                room = most - sum(sizes.values())
                sizes[member.filename] = _size(archive, member, room)
            return sizes
    except (zipfile.BadZipFile, zlib.error, EOFError, OSError, ValueError, RuntimeError) as error:
        if isinstance(error, ZipBoundsError):
            raise
        raise ZipBoundsError(f"is a damaged zip file ({error})") from error


def _check_directory(members: list[zipfile.ZipInfo], most: int) -> None:
    if len(members) > MOST_MEMBERS:
        raise ZipBoundsError(f"has {len(members)} members; at most {MOST_MEMBERS} are read")
    names = [member.filename for member in members]
    if len(set(names)) < len(names):
        raise ZipBoundsError("has two members of one name")
    if any(member.compress_type not in _METHODS or member.flag_bits & 1 for member in members):
        raise ZipBoundsError("is encrypted or packed in a way no spreadsheet is; save it plainly")
    if sum(member.file_size for member in members) > most:
        raise _too_large(most)


def _size(archive: zipfile.ZipFile, member: zipfile.ZipInfo, room: int) -> int:
    """Return what a member unpacks to."""
    size = 0
    with archive.open(member) as content:
        while block := content.read(_BLOCK):
            size += len(block)
            if size > room:
                raise _too_large(room)
    return size


def _too_large(most: int) -> ZipBoundsError:
    return ZipBoundsError(f"unpacks to more than {most >> 20} MiB; send the table in parts")
