"""Files sent by value: a component's bundle to a worker, an attempt's artifacts back."""

import contextlib
import os
import shutil
import threading
from collections.abc import Mapping
from hashlib import blake2b
from pathlib import Path, PurePosixPath

from wrenchbook.service.files.durable import write_whole_bytes
from wrenchbook.service.jobs.attempt import LOCK, LOG, OUTCOME, PROGRESS, SPEC, Spec, write_outcome

Files = dict[str, bytes]
"""Path of each file in its folder, with forward slashes, and its bytes."""

BUNDLE_BYTES = 512 * 1024 * 1024  # the limit of an uploaded bundle
OUTCOME_BYTES = 8 * 1024 * 1024  # a displacement, a compliance and a history are some kB
LOG_BYTES = 1024 * 1024  # of the end of a log
FILES_BYTES = 32 * 1024 * 1024  # a failed solve's mesh, a deck's files
NAMES = 20  # of the files that stayed behind, in the log
_STAY = {SPEC, LOCK, PROGRESS, LOG}


class BadPayloadError(Exception):
    """A payload is damaged, too large, or has a file name that leads out of its folder."""


def pack(folder: Path, limit: int = BUNDLE_BYTES) -> Files:
    """Return the files of a folder and its subfolders.

    Raises
    ------
    OSError
        If the folder is missing or unreadable.
    BadPayloadError
        If the files have more than `limit` bytes.
    """
    if not folder.is_dir():
        raise FileNotFoundError(f"there is no folder {folder}")
    files: Files = {}
    left = limit
    for path in sorted(path for path in folder.rglob("*") if path.is_file()):
        content = files[path.relative_to(folder).as_posix()] = path.read_bytes()
        left -= len(content)
        if left < 0:
            raise BadPayloadError(f"{folder} holds more than {limit} bytes")
    return files


def digest(files: Mapping[str, bytes]) -> str:
    """Return a digest of names and contents, 32 hexadecimal digits."""
    hashed = blake2b(digest_size=16)
    for name, content in sorted(files.items()):
        hashed.update(f"{len(name.encode())} {len(content)} ".encode() + name.encode())
        hashed.update(content)
    return hashed.hexdigest()


def unpack(files: Mapping[str, bytes], folder: Path) -> None:
    """Write each file into the folder, whole or not at all; other files stay.

    Raises
    ------
    BadPayloadError
        If a name leads out of the folder; nothing is written then.
    """
    for name in files:
        _check_name(name)
    for name, content in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole_bytes(path, content, durable=False)


def place(files: Mapping[str, bytes], name: str, folder: Path) -> Path:
    """Write files with the digest `name` into ``folder/name``, all of them or none.

    Raises
    ------
    BadPayloadError
        If the files have another digest: they were damaged in transit.
    OSError
        If they cannot be written.
    """
    found = digest(files)
    if found != name:
        raise BadPayloadError(f"the files came as {found}, not as {name}, which was sent")
    target = folder / name
    partial = folder / f".{name}.{os.getpid()}.{threading.get_ident()}"
    try:
        unpack(files, partial)
        partial.rename(target)
    except OSError:
        if not target.is_dir():  # else another worker wrote the same files
            raise
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    return target


def artifacts(folder: Path, spec: Spec) -> Files:
    """Return outcome, log and other files of an ended attempt, bounded in size.

    The log names the files that are too large; an outcome that is too large becomes a failure.
    """
    if _size(folder / OUTCOME) > OUTCOME_BYTES:
        write_outcome(folder, spec, _too_large(_size(folder / OUTCOME)))
    files: Files = {}
    room, stayed = FILES_BYTES, []
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if not path.is_file() or path.name.startswith(".") or name in _STAY:
            continue
        if _size(path) > room:
            stayed.append(f"{name} ({_size(path)} bytes)")
            continue
        files[name] = path.read_bytes()
        room -= len(files[name])
    files[LOG] = _log(folder / LOG, stayed)
    return files


def _log(path: Path, stayed: list[str]) -> bytes:
    """Return the end of the log; notes come first because its last line is a cause of death."""
    size, end = _size(path), b""
    with contextlib.suppress(FileNotFoundError), path.open("rb") as file:
        file.seek(max(0, size - LOG_BYTES))
        end = file.read(LOG_BYTES)
    notes = [f"[{size - LOG_BYTES} bytes of this log are left out here]"] * (size > LOG_BYTES)
    if stayed:
        names = ", ".join(stayed[:NAMES]) + (", ..." if len(stayed) > NAMES else "")
        notes.append(f"[too large to be sent, left on the worker: {names}]")
    return "".join(f"{note}\n" for note in notes).encode() + end


def _size(path: Path) -> int:
    try:
        return path.stat().st_size
    except OSError:
        return 0


def _too_large(size: int) -> dict[str, object]:
    error = {
        "kind": "answer_too_large",
        "message": f"the solver's answer is {size} bytes; at most {OUTCOME_BYTES} are taken",
        "remedy": "have the solver give the displacement and write other results to files",
    }
    return {"status": "failed", "error": error}


def _check_name(name: str) -> None:
    path = PurePosixPath(name)
    if not name or path.is_absolute() or ".." in path.parts or "\0" in name or "\\" in name:
        raise BadPayloadError(f"the file name {name!r} leads out of its folder")
