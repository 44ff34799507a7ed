"""Folders that travel by value: named files as bytes, under the digest of what they hold."""

import os
import shutil
import threading
from collections.abc import Mapping
from hashlib import blake2b
from pathlib import Path, PurePosixPath

from service.files.durable import write_whole_bytes

Files = dict[str, bytes]
"""What is in a folder: each file's path in it, with forward slashes, and its bytes."""

BUNDLE_BYTES = 512 * 1024 * 1024  # as much as an uploaded bundle may be


class BadParcelError(Exception):
    """A parcel is not what was sent, holds a name that leads out of its folder, or is too large."""


def pack(folder: Path, limit: int = BUNDLE_BYTES) -> Files:
    """Return the files of a folder and of those in it.

    Raises
    ------
    OSError
        If the folder is not there or cannot be read.
    BadParcelError
        If they are more than `limit` bytes.
    """
    files: Files = {}
    left = limit
    for path in _files_in(folder):
        content = path.read_bytes()
        left -= len(content)
        if left < 0:
            raise BadParcelError(f"{folder} holds more than {limit} bytes")
        files[path.relative_to(folder).as_posix()] = content
    return files


def digest(files: Mapping[str, bytes]) -> str:
    """Return what names these files with this content and no others, 32 hexadecimal digits."""
    told = blake2b(digest_size=16)
    for name, content in sorted(files.items()):
        told.update(f"{len(name.encode())} {len(content)} ".encode() + name.encode())
        told.update(content)
    return told.hexdigest()


def unpack(files: Mapping[str, bytes], folder: Path) -> None:
    """Write files into a folder, each whole or not at all; what is there otherwise stays.

    Raises
    ------
    BadParcelError
        If a name leads out of the folder; nothing is written then.
    """
    for name in files:
        _refuse_way_out(name)
    for name, content in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole_bytes(path, content, durable=False)


def place(files: Mapping[str, bytes], name: str, shelf: Path) -> Path:
    """Put files whose digest is `name` into the folder of that name on a shelf; whole or not.

    Raises
    ------
    BadParcelError
        If they are not what that digest names: something was lost on the way.
    OSError
        If the disk does not take them.
    """
    found = digest(files)
    if found != name:
        raise BadParcelError(f"the files came as {found}, not as {name}, which was sent")
    target = shelf / name
    partial = shelf / f".{name}.{os.getpid()}.{threading.get_ident()}"
    try:
        unpack(files, partial)
        partial.rename(target)
    except OSError:
        if not target.is_dir():  # else somebody else has placed the same
            raise
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    return target


def _files_in(folder: Path) -> list[Path]:
    if not folder.is_dir():
        raise FileNotFoundError(f"there is no folder {folder}")
    return sorted(path for path in folder.rglob("*") if path.is_file())


def _refuse_way_out(name: str) -> None:
    path = PurePosixPath(name)
    if not name or path.is_absolute() or ".." in path.parts or "\0" in name or "\\" in name:
        raise BadParcelError(f"the file name {name!r} leads out of its folder")
