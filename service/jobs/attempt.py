"""Attempts: one solve of a job, and its folder.

The folder is all that dispatcher, engine and solver share. ``spec.json`` is the attempt, ``lock``
is locked while the solver lives, ``log.txt`` is its output, ``progress.json`` its progress,
``result.json`` its outcome. Both JSON files of the solver appear complete or not at all.
"""

from __future__ import annotations

import json
import os
import shutil
import stat
import tempfile
import time
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from hashlib import blake2b
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, Final, Literal

from wrenchbook.service.files.durable import write_atomically
from wrenchbook.service.files.redact import cut_paths

if TYPE_CHECKING:  # solvers need no ledger
    from wrenchbook.service.ledger import JobRecord

SPEC, LOCK, LOG = "spec.json", "lock", "log.txt"
PROGRESS, OUTCOME = "progress.json", "result.json"
DECK = "deck"  # folder of an outside solver's input and output
# The death of a solver counts once its dispatcher, or its Dask worker, has outlived it by this
# time: if both die, by a kill of both or of the machine, the job is not the cause.
OUTLIVE_SECONDS = 1.0
_QUESTION: Final = ("job", "attempt", "component", "fingerprint", "wrench")
_SOLVE: Final = (*_QUESTION, "bundle", "estimate", "task", "priority", "deadline", "memory")


class BadOutcomeError(Exception):
    """The result.json cannot be read, or belongs to another question than this attempt's."""


@dataclass
class Outcome:
    """The end of an attempt: ``done`` with numbers, ``failed`` with an error, or ``cancelled``.

    All other reports of a solver are in `further`, and in result.json beside these fields.
    """

    status: Literal["done", "failed", "cancelled"]
    error: dict[str, str] | None = None  # kind, message and remedy
    displacement: Sequence[float] | None = None  # m and rad, six an interface
    compliance: Sequence[Sequence[float]] | None = None
    curvature: Sequence[Any] | None = None
    solver_error: Mapping[str, Any] | None = None  # the mesh's error, if the attempt estimates it
    notes: Sequence[str] | None = None
    program: str | None = None  # version and code digest of the solver
    further: dict[str, Any] = field(default_factory=dict)

    @classmethod
    def of(cls, fields: Mapping[str, Any]) -> Outcome:
        """Return the outcome of result.json's fields.

        Raises TypeError without a status.
        """
        known = {name: fields[name] for name in _OUTCOME if name in fields}
        return cls(**known, further={n: v for n, v in fields.items() if n not in known})

    @classmethod
    def failed(cls, kind: str, message: str, remedy: str) -> Outcome:
        """Return the outcome of an attempt without an answer."""
        return cls("failed", {"kind": kind, "message": message, "remedy": remedy})


_OUTCOME: Final = tuple(item.name for item in fields(Outcome) if item.name != "further")


@dataclass
class Attempt:
    """One attempt, from its claim to its solver: a wrench (N, N·m) on a component."""

    job: int
    attempt: int  # number of the attempt within the job
    component: str
    bundle: str  # the component's folder on this machine
    fingerprint: str
    wrench: tuple[float, ...]
    estimate: bool = False  # whether the solver also estimates its own error, once a setup
    folder: Path = Path()  # folder of the attempt on this machine, absolute
    # Unique to an attempt of a job of a data directory, and in the ledger before the engine gets
    # it. Two submissions with one key are one attempt.
    task: str = ""
    priority: int = 0  # an engine with a queue of its own starts higher ones first
    deadline: float | None = None  # s from the solver's first instruction until it fails
    # Memory of a solve of this component by the check's estimate (right to a factor of two); None
    # without a stored check.
    memory: int | None = None
    cores: int = 1  # cores of a solver; its libraries use as many threads
    # Fields of the dispatcher that owns it
    accepted: bool = field(default=False, compare=False)  # whether an engine has accepted it
    # Whether its solver lived during this dispatcher's time.
    witnessed: bool = field(default=True, compare=False)
    adopted: bool = field(default=False, compare=False)  # another dispatcher started it
    leaving: bool = field(default=False, compare=False)  # its answer is no longer needed
    began: bool = field(default=False, compare=False)  # a solver has reported its begin
    # When its death was first detected, monotonic s.
    died: float | None = field(default=None, compare=False)

    @classmethod
    def of(cls, job: JobRecord, folder: Path) -> Attempt:
        """Return the latest attempt of a job, with its folder; its bundle is not set."""
        task = job.task or f"{job.id}-{job.attempt}"
        question = job.id, job.attempt, job.component, "", job.fingerprint, job.wrench
        return cls(*question, folder=folder, task=task, priority=job.priority)

    @property
    def key(self) -> tuple[int, int]:
        """Job and attempt."""
        return self.job, self.attempt

    @property
    def question(self) -> dict[str, Any]:
        """The fields that identify an answer: without paths and the estimate flag."""
        return {name: getattr(self, name) for name in _QUESTION} | {"wrench": list(self.wrench)}


@dataclass(frozen=True)
class Progress:
    """The progress of a solver: a fraction 0..1 and its present step."""

    fraction: float
    message: str


def attempt_folder(jobs_folder: Path, job: int, attempt: int) -> Path:
    """Return the path of an attempt's folder."""
    return jobs_folder / str(job) / str(attempt)


def prepare(attempt: Attempt) -> None:
    """Make the attempt's folder with its spec.json.

    An existing folder of that number can only come from a lost ledger; it is moved aside.
    """
    folder = attempt.folder
    if folder.exists():
        folder.rename(folder.with_name(f"{folder.name}.old-{time.time_ns()}"))
    folder.mkdir(parents=True)
    write_json(folder / SPEC, {name: getattr(attempt, name) for name in _SOLVE})


def read_attempt(folder: Path) -> Attempt:
    """Return the attempt of a folder.

    Raises OSError, ValueError, TypeError or KeyError if its spec.json is missing or damaged.
    """
    fields = json.loads((folder / SPEC).read_bytes())
    return Attempt(**fields | {"wrench": tuple(fields["wrench"])}, folder=folder)


def read_progress(folder: Path) -> Progress | None:
    """Return the progress of the attempt's solver; None before its first report."""
    try:
        fields = json.loads((folder / PROGRESS).read_bytes())
        return Progress(fields["fraction"], fields["message"])
    except (OSError, ValueError, KeyError):
        return None


def solver_began(folder: Path) -> bool:
    """Return whether a solver came to its first instruction, which writes its pid into the lock.

    The lock alone proves nothing: an engine takes it before there is a process.
    """
    return solver_seconds(folder) is not None


def solver_seconds(folder: Path) -> float | None:
    """Return the run time of the attempt's solver until now or until its outcome, in seconds.

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


def last_output(folder: Path) -> str:
    """Return the last line of what the attempt's solver printed; empty if it printed nothing."""
    try:
        lines = (folder / LOG).read_text(errors="replace").strip().splitlines()
    except OSError:
        return ""
    return lines[-1] if lines else ""


def write_outcome(attempt: Attempt, outcome: Outcome, *, durable: bool = True) -> None:
    """Write result.json durably; its appearance means that the solver has ended.

    It repeats the question, so that it cannot be taken for the answer to another wrench.
    """
    known = {name: value for name in _OUTCOME if (value := getattr(outcome, name)) is not None}
    content = outcome.further | known | {"asked": attempt.question}
    write_json(attempt.folder / OUTCOME, {**content, "digest": _digest(content)}, durable=durable)


def read_outcome(attempt: Attempt) -> Outcome | None:
    """Return the outcome of an attempt; None if it has not ended.

    Raises BadOutcomeError if the file differs from the result of `write_outcome`, or belongs to
    another question.
    """
    path = attempt.folder / OUTCOME
    try:
        content = json.loads(path.read_bytes())
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as error:
        raise BadOutcomeError(f"{path} cannot be read as JSON ({error})") from error
    if not isinstance(content, dict) or not {"digest", "asked", "status"} <= content.keys():
        raise BadOutcomeError(f"{path} is not a solve's result: it lacks digest, asked or status")
    if content.pop("digest") != _digest(content):
        raise BadOutcomeError(f"{path} is damaged: its checksum is wrong")
    answered = content.pop("asked")
    asked = attempt.question
    if answered != asked:
        names = ", ".join(name for name in asked if answered.get(name) != asked[name])
        raise BadOutcomeError(f"{path} is the answer of another attempt: it differs in {names}")
    return Outcome.of(content)


def notes_of(attempt: Attempt) -> list[str]:
    """Return the solver's notes on its answer; often an empty list."""
    try:
        outcome = read_outcome(attempt)
    except BadOutcomeError:
        return []
    notes = outcome and outcome.notes
    return [str(note) for note in notes] if isinstance(notes, list) else []


def tidy(folder: Path) -> None:
    """Reduce a done attempt's folder to spec, log and outcome, and an outside solver's files."""
    for entry in folder.iterdir():
        if entry.name in (SPEC, LOCK, LOG, OUTCOME, DECK):
            continue
        if entry.is_dir() and not entry.is_symlink():
            shutil.rmtree(entry, ignore_errors=True)
        else:
            entry.unlink(missing_ok=True)


def write_json(path: Path, content: Mapping[str, Any], *, durable: bool = False) -> None:
    """Write JSON such that readers see its complete content or the earlier one; never NaN.

    With `durable` it also survives a power failure.
    """
    write_atomically(path, json.dumps(content, allow_nan=False).encode(), durable=durable)


def _digest(content: Mapping[str, Any]) -> str:
    """Return a digest that does not change by writing JSON and reading it again."""
    text = json.dumps(content, sort_keys=True)  # a damaged number may be infinite
    return blake2b(text.encode(), digest_size=16).hexdigest()


MAX_BYTES: Final = 1 << 30  # bytes of all files together; a deck's solver may write any number
_MAX_TEXT: Final = 8 << 20  # bytes of a text that is searched for paths, and of a zip in memory
_PIECE: Final = 1 << 18  # bytes of a file in memory at once
_TEXTS: Final = (".txt", ".json", ".log")


def zipped(folder: Path) -> IO[bytes]:
    """Return a file with the zip of a folder; its texts lose the paths of this machine.

    Links and other special files are left out: a deck's command may have linked to any file of the
    machine.
    """
    file: Any = tempfile.SpooledTemporaryFile(_MAX_TEXT)  # noqa: SIM115 (closed by the reader)
    room = MAX_BYTES
    missing = []
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for path in sorted(folder.rglob("*")):  # rglob does not follow links
            if path.is_dir() and not path.is_symlink():
                continue
            name = path.relative_to(folder).as_posix()
            try:
                # Opened first and checked afterwards: between check and opening it could become a
                # link.
                descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
            except OSError:
                missing.append(name)
                continue
            with open(descriptor, "rb") as content:  # noqa: PTH123 (a descriptor)
                status = os.fstat(descriptor)
                if not stat.S_ISREG(status.st_mode) or status.st_size > room:
                    missing.append(name)
                elif path.suffix in _TEXTS and status.st_size <= _MAX_TEXT:
                    archive.writestr(name, cut_paths(content.read().decode(errors="replace")))
                    room -= status.st_size
                else:
                    with archive.open(name, "w", force_zip64=True) as target:
                        while room > 0 and (piece := content.read(_PIECE)):
                            target.write(piece)
                            room -= len(piece)
        if missing:
            header = "links, files that are gone, or too large to be sent:"
            archive.writestr("LEFT_OUT.txt", "\n".join([header, *sorted(missing)]))
    file.seek(0)
    return file


def pieces_of(file: IO[bytes]) -> Iterator[bytes]:
    """Yield a file's content, and close it."""
    with file:
        while piece := file.read(_PIECE):
            yield piece


# A solver's messages over its socket: it has begun an attempt, it waits for work, it ends.
BEGUN, FREE, ENDS = b"t", b"e", b"r"
State = Literal["submitted", "running", "finished", "lost"]
ALIVE: tuple[State, ...] = ("submitted", "running")

Listener = Callable[[str], None]
"""Called with the task key of an attempt whose state may have changed; in any thread."""


class EngineError(Exception):
    """The engine cannot accept an attempt now; the job waits and is tried again."""


class Listeners:
    """The listeners of an engine, called with the task key of an attempt that may have changed."""

    _listeners: tuple[Listener, ...] = ()

    def listen(self, listener: Listener) -> Callable[[], None]:
        """Call the listener when an attempt may have changed; return a function that ends this."""
        self._listeners = (*self._listeners, listener)

        def stop() -> None:
            self._listeners = tuple(each for each in self._listeners if each is not listener)

        return stop

    def _report(self, task: str) -> None:
        for listener in self._listeners:
            listener(task)
