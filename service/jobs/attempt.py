"""The folder of one attempt: the only thing dispatcher, engine and solver share.

``spec.json`` is what to solve, ``lock`` is locked by the solver as long as it lives, ``log.txt``
is what it printed, ``progress.json`` how far it is, ``result.json`` how it ended. Both JSON
files of the solver appear whole or not at all.
"""

from __future__ import annotations

import json
import os
import shutil
import stat
import tempfile
import time
import zipfile
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from hashlib import blake2b
from pathlib import Path
from typing import IO, Any, Final

from wrenchbook.service.files.durable import write_whole_bytes
from wrenchbook.service.files.redact import redact

SPEC, LOCK, LOG = "spec.json", "lock", "log.txt"
PROGRESS, OUTCOME = "progress.json", "result.json"
DECK = "deck"  # what an outside solver was given and wrote
_KEPT = {SPEC, LOCK, LOG, OUTCOME, DECK}


class BadOutcomeError(Exception):
    """The result.json cannot be read, or answers another question than this attempt's."""


@dataclass(frozen=True)
class Spec:
    """What one attempt solves: a wrench (N, N·m) on the component in the folder `bundle`.

    With `estimate` the solver also estimates its own error, once a set-up.
    """

    job: int
    attempt: int
    component: str
    bundle: str
    fingerprint: str
    wrench: tuple[float, ...]
    estimate: bool = False


@dataclass(frozen=True)
class Progress:
    """How far a solver is: a fraction 0..1 and what it is at."""

    fraction: float
    message: str


def attempt_folder(jobs_folder: Path, job: int, attempt: int) -> Path:
    """Return where an attempt's folder is."""
    return jobs_folder / str(job) / str(attempt)


def prepare(folder: Path, spec: Spec) -> None:
    """Make the attempt's folder with its spec.json.

    A folder of that number can only be left over from a ledger that is gone; it is moved aside.
    """
    if folder.exists():
        folder.rename(folder.with_name(f"{folder.name}.old-{time.time_ns()}"))
    folder.mkdir(parents=True)
    write_whole(folder / SPEC, asdict(spec))


def read_spec(folder: Path) -> Spec:
    """Return the spec of an attempt."""
    fields = json.loads((folder / SPEC).read_bytes())
    fields["wrench"] = tuple(fields["wrench"])
    return Spec(**fields)


def read_progress(folder: Path) -> Progress | None:
    """Return the progress of the attempt's solver; None before its first report."""
    try:
        fields = json.loads((folder / PROGRESS).read_bytes())
        return Progress(fields["fraction"], fields["message"])
    except (OSError, ValueError, KeyError):
        return None


def solver_began(folder: Path) -> bool:
    """Return whether a solver came to its first instruction: it writes its pid into the lock.

    The lock alone proves nothing: an engine takes it before there is a process.
    """
    return solver_seconds(folder) is not None


def solver_seconds(folder: Path) -> float | None:
    """Return how long the attempt's solver has run, or ran until its outcome, in seconds.

    None before its first instruction.
    """
    try:
        lock = (folder / LOCK).stat()
    except OSError:
        return None
    try:
        end = (folder / OUTCOME).stat().st_mtime
    except OSError:
        end = time.time()
    return max(0.0, end - lock.st_mtime) if lock.st_size else None


def last_words(folder: Path) -> str:
    """Return the last line of what the attempt's solver printed; empty if it printed nothing."""
    try:
        lines = (folder / LOG).read_text(errors="replace").strip().splitlines()
    except OSError:
        return ""
    return lines[-1] if lines else ""


def write_outcome(
    folder: Path, spec: Spec, outcome: Mapping[str, Any], *, durable: bool = True
) -> None:
    """Write result.json to disk for good; its appearance means that the solver has ended.

    It repeats the question, so that it is not taken for the answer to another wrench.
    """
    whole = {**outcome, "asked": _question(spec)}
    write_whole(folder / OUTCOME, {**whole, "digest": _digest(whole)}, durable=durable)


def read_outcome(folder: Path, spec: Spec) -> dict[str, Any] | None:
    """Return how the attempt of this spec ended; None if it has not.

    Raises
    ------
    BadOutcomeError
        If the file is not byte for byte what `write_outcome` wrote, or answers another spec.
    """
    try:
        outcome = json.loads((folder / OUTCOME).read_bytes())
        digest = outcome.pop("digest")
        if digest != _digest(outcome):
            raise ValueError("its checksum is wrong: the file is damaged")
        answered = outcome.pop("asked")
    except FileNotFoundError:
        return None
    except (OSError, ValueError, KeyError, AttributeError, TypeError) as error:
        raise BadOutcomeError(f"{folder / OUTCOME} cannot be read: {error!r}") from error
    if answered != _question(spec):
        raise BadOutcomeError(f"{folder / OUTCOME} answers {answered}, not {_question(spec)}")
    return outcome


def tidy(folder: Path) -> None:
    """Leave of a done attempt only its spec, log and outcome, and an outside solver's files."""
    for entry in folder.iterdir():
        if entry.name in _KEPT:
            continue
        if entry.is_dir() and not entry.is_symlink():
            shutil.rmtree(entry, ignore_errors=True)
        else:
            entry.unlink(missing_ok=True)


def write_whole(path: Path, content: Mapping[str, Any], *, durable: bool = False) -> None:
    """Write JSON such that readers see all of it or the file before; never NaN.

    With `durable` it also survives a power cut.
    """
    write_whole_bytes(path, json.dumps(content, allow_nan=False).encode(), durable=durable)


def _digest(content: Mapping[str, Any]) -> str:
    """Return a digest that survives writing as JSON and reading again: floats come back whole."""
    text = json.dumps(content, allow_nan=False, sort_keys=True)
    return blake2b(text.encode(), digest_size=16).hexdigest()


def _question(spec: Spec) -> dict[str, Any]:
    """Return the fields that identify an answer: not paths, nor the estimate flag."""
    fields = asdict(spec) | {"wrench": list(spec.wrench)}
    del fields["bundle"], fields["estimate"]
    return fields


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
