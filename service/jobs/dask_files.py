"""Files that are sent between server and Dask workers by value, limited in size."""

from __future__ import annotations

import contextlib
import os
import pickle
import shutil
import threading
from collections.abc import Iterable
from hashlib import blake2b
from pathlib import Path
from typing import TypedDict

from wrenchbook.service.jobs import attempt as attempts
from wrenchbook.service.jobs.attempt import LOCK, LOG, OUTCOME, PROGRESS, SPEC, Attempt

BUNDLE_BYTES = 512 * 1024 * 1024  # bytes: the limit of an uploaded bundle
OUTCOME_BYTES = 8 * 1024 * 1024  # bytes: a displacement, a compliance and a history are some kB
LOG_BYTES = 1024 * 1024  # bytes of the end of a log
FILES_BYTES = 32 * 1024 * 1024  # bytes: a failed solve's mesh, a deck's files
MAX_NAMES = 20  # names, in the log, of files that are too large to be sent

Files = dict[str, bytes]
"""The content of files by their names relative to a folder."""


class Payload(TypedDict):
    """The result of a task: a plain dictionary, as a scheduler lacks this program."""

    worker: str  # its address
    unfit: str | None  # why the worker could not run the attempt; the rest is then empty
    outcome: bytes | None  # content of result.json; None if the solver died
    files: Files  # the other files, limited in size
    seconds: float  # run time of the solver


class BadPayloadError(Exception):
    """A payload is damaged or too large."""


def read_files(folder: Path, limit: int, skip: Iterable[str] = ()) -> tuple[Files, list[str]]:
    """Return the files of a folder that are within a limit of bytes, and the names of others."""
    files = {}
    too_large = []
    for path in sorted(path for path in folder.rglob("*") if path.is_file()):
        name = path.relative_to(folder).as_posix()
        size = path.stat().st_size
        if name in skip:
            continue
        if size > limit:
            too_large.append(f"{name} ({size} bytes)")
            continue
        limit -= size
        files[name] = path.read_bytes()
    return files, too_large


def write_files(files: Files, folder: Path) -> None:
    """Write files into a folder.

    Raises BadPayloadError, before anything is written, if a name leads out of it.
    """
    for name in files:
        if not name or name.startswith("/") or "\\" in name or ".." in name.split("/"):
            raise BadPayloadError(
                f"the file name {name!r} leads out of the component's folder; rename the file"
            )
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)


def pack(folder: Path, limit: int) -> bytes:
    """Return the content of a folder, the same bytes for the same files.

    Raises FileNotFoundError without the folder, BadPayloadError for more than `limit` bytes.
    """
    if not folder.is_dir():
        raise FileNotFoundError(f"there is no folder {folder}")
    files, too_large = read_files(folder, limit)
    if too_large:
        raise BadPayloadError(
            f"the component's folder {folder} holds more than {limit >> 20} MiB, the limit for "
            f"Dask workers; the first file beyond it is {too_large[0]}"
        )
    return pickle.dumps(files)


def digest(content: bytes) -> str:
    """Return a digest of 32 hexadecimal digits."""
    return blake2b(content, digest_size=16).hexdigest()


def unpack(content: bytes, name: str, folder: Path) -> None:
    """Write the files of a packed folder with the digest `name` into ``folder/name``, all or none.

    Raises BadPayloadError if they were damaged in transit, OSError if they cannot be written.
    """
    if digest(content) != name:
        why = f"their digest is {digest(content)}, but was {name} when they were sent"
        raise BadPayloadError("the component's files were damaged on the way: " + why)
    partial = folder / f".{name}.{os.getpid()}.{threading.get_ident()}"
    try:
        write_files(pickle.loads(content), partial)
        partial.rename(folder / name)
    except OSError:
        if not (folder / name).is_dir():  # otherwise another worker wrote the same files
            raise
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def artifacts(attempt: Attempt) -> tuple[bytes | None, Files]:
    """Return the outcome of an ended attempt, and its log and other files, limited in size.

    The log names the files that are too large; an outcome that is too large becomes a failure. The
    notes on a log come first because its last line is the cause of a death.
    """
    outcome, log = (attempt.folder / name for name in (OUTCOME, LOG))
    if outcome.exists() and (size := outcome.stat().st_size) > OUTCOME_BYTES:
        failed = attempts.Outcome.failed(
            "answer_too_large",
            f"the solver's answer has {size} bytes, but at most {OUTCOME_BYTES} are accepted",
            "let the solver return only the displacement and write other results to files",
        )
        attempts.write_outcome(attempt, failed)
    names = [path.relative_to(attempt.folder).as_posix() for path in attempt.folder.rglob(".*")]
    files, too_large = read_files(
        attempt.folder, FILES_BYTES, (SPEC, LOCK, PROGRESS, LOG, OUTCOME, *names)
    )
    text = b""
    notes = ""
    with contextlib.suppress(FileNotFoundError), log.open("rb") as file:
        if (beyond := log.stat().st_size - LOG_BYTES) > 0:
            file.seek(beyond)
            notes = f"[{beyond} bytes of this log are left out here]\n"
        text = file.read(LOG_BYTES)
    if too_large:
        names = ", ".join(too_large[:MAX_NAMES]) + (", ..." if len(too_large) > MAX_NAMES else "")
        notes += f"[too large to be sent, left on the worker: {names}]\n"
    files[LOG] = notes.encode() + text
    return outcome.read_bytes() if outcome.exists() else None, files
