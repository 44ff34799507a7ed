"""One run of a deck: insert loads, run a command with a timeout, read the motion."""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from wrenchbook.fea.failure import SolveFailed, exit_text
from wrenchbook.fea.readers import (
    MAX_QUOTED,
    DeckReader,
    DeckRun,
    OutputError,
    Reading,
    reader_named,
)
from wrenchbook.fea.solution import Progress
from wrenchbook.fea.spec.mesh_source import UNITS
from wrenchbook.fea.spec.problems import BundleError, BundleProblem
from wrenchbook.fea.spec.schema import PLACEHOLDERS, Deck

PRINTED = "printed.txt"
"""File of the program's standard output and errors."""

_PLACEHOLDER = re.compile(rb"\$[FM][XYZ]\b")
_PACKAGES = {"ccx": "CalculiX: on Debian and Ubuntu, apt-get install calculix-ccx"}


def missing_placeholders(deck: bytes) -> list[str]:
    """Return the placeholders that a deck's text lacks."""
    there = {word.decode() for word in _PLACEHOLDER.findall(deck)}
    return [placeholder for placeholder in PLACEHOLDERS if placeholder not in there]


def insert_loads(deck: bytes, loads: Sequence[float]) -> bytes:
    """Return a deck's text with six numbers in place of the placeholders.

    A number has at most 20 characters, the most that CalculiX reads.

    Raises SolveFailed of kind ``bad_deck`` if a placeholder is missing: its load would have no
    effect.
    """
    missing = missing_placeholders(deck)
    if missing:
        raise SolveFailed(
            "bad_deck",
            f"The deck has no {', '.join(missing)}, so that load would be lost.",
            "Write each placeholder where its load acts; if a guide takes the load, write it in a "
            "comment line.",
        )
    pairs = zip(PLACEHOLDERS, loads, strict=True)
    values = {word.encode(): f"{value:.12e}".encode() for word, value in pairs}
    return _PLACEHOLDER.sub(lambda match: values[match[0]], deck)


def run_deck(
    deck: Deck, wrench: np.ndarray, folder: Path, progress: Progress
) -> tuple[np.ndarray, int]:
    """Run a deck once, in a folder made for it.

    wrench: shape (6,), N and N·m, with the kind of moment that the deck needs.
    folder: a new folder for its files, which stay.
    progress: called during the run if the reader knows the progress.
    Returns displacement, unknowns: shape (6,), m and rad; degrees of freedom, 0 if unknown.

    Raises SolveFailed of kind ``bad_deck``, ``no_solver``, ``timed_out``, ``solver_failed``,
    ``not_converged`` or ``bad_output`` if the run has no motion.
    """
    metres = UNITS[deck.unit]
    loads = np.concatenate([wrench[:3], wrench[3:] / metres])
    text = insert_loads(deck.file.read_bytes(), loads.tolist())
    folder.mkdir(parents=True)
    for file in deck.files:
        shutil.copy(file, folder / file.name)
    (folder / deck.file.name).write_bytes(text)
    run = DeckRun(folder, deck.file.stem, folder / PRINTED)
    result = _run(deck, run, reader_named(deck.output["reader"]), progress)
    displacement = np.array(result.displacement, dtype=float)
    if displacement.shape != (6,) or not np.isfinite(displacement).all():
        message = f"The reader returned {result.displacement}, which is not six finite numbers."
        raise _bad_output(message, folder)
    return np.concatenate([displacement[:3] * metres, displacement[3:]]), result.unknowns


def _run(deck: Deck, run: DeckRun, reader: DeckReader, progress: Progress) -> Reading:
    """Run the command of a deck and read its output; raise SolveFailed as `run_deck`."""
    program = deck.command[0].replace("{job}", run.job)
    code = _exit_code(deck, run, reader, progress)
    complaint = reader.complaint(run)
    if complaint is not None and complaint.not_converged:
        raise SolveFailed(
            "not_converged",
            f'"{program}" found no equilibrium. It printed: {complaint.quoted}',
            "Check that the part can carry the load and that its supports hold it; then try "
            "smaller increments in the deck.",
        )
    if complaint is not None:
        raise _solver_failed(program, exit_text(code), complaint.quoted, run.folder)
    if code != 0:
        text = run.printed.read_text(encoding="utf-8", errors="replace").strip()
        raise _solver_failed(program, exit_text(code), text[-MAX_QUOTED:] or "nothing", run.folder)
    try:
        return reader.read(run, deck.output)
    except OutputError as error:
        raise _bad_output(str(error), run.folder) from None


def _exit_code(deck: Deck, run: DeckRun, reader: DeckReader, progress: Progress) -> int:
    """Run the command of a deck and return its exit code, or minus its signal.

    Raises SolveFailed of kind ``no_solver`` if it cannot be started, ``timed_out`` if it takes too
    long.
    """
    command = [word.replace("{job}", run.job) for word in deck.command]
    program = command[0]

    def watch() -> None:
        stage = reader.stage(run)
        if stage is not None:
            progress(*stage)

    try:
        return run_command(command, run.folder, run.printed, deck.timeout, watch)
    except OutOfTime:
        raise SolveFailed(
            "timed_out",
            f'"{program}" had not finished after {deck.timeout:g} s and was stopped.',
            "Write a larger timeout (seconds) under [deck], or make the deck smaller.",
        ) from None
    except CannotStartError as error:
        package = f" ({_PACKAGES[program]})" if program in _PACKAGES else ""
        raise SolveFailed(
            "no_solver",
            f'The program "{program}" of command under [deck] cannot be started: {error}.',
            f"Install it{package} where solves run, so that it is on the PATH there, or correct "
            "the command.",
        ) from None


# Seconds between asking a program to end and killing it; engines wait 5 s for this process.
_GRACE = 2.0
_POLL_EVERY = 0.25  # seconds between two looks at the program's progress
# Waits until this program writes a line (all is well) or is gone, even by SIGKILL.
_GUARD = 'read -r _ || kill -s KILL -- "-$0"'


class OutOfTime(Exception):  # noqa: N818 - an outcome, named as what happened
    """The program did not end in time and was killed."""


class CannotStartError(Exception):
    """The system cannot start the program; the message is the system's reason."""


def run_command(
    command: Sequence[str],
    folder: Path,
    printed: Path,
    timeout: float,
    watch: Callable[[], None] | None = None,
) -> int:
    """Run a program in `folder` and return its exit code, or minus its signal.

    The environment (OMP_NUM_THREADS and the like) is passed on unchanged. After a return or an
    exception the program and all processes in its process group are gone; they also end soon after
    this program is killed.

    printed: file for its standard output and errors.
    timeout: seconds.
    watch: called a few times a second during the run.

    Raises CannotStartError if the program cannot be started, OutOfTime if it takes longer than
    `timeout`.
    """
    deadline = time.monotonic() + timeout
    child = None
    try:
        with printed.open("wb") as file, _defer_signal(signal.SIGTERM):
            try:
                child = subprocess.Popen(
                    command,
                    cwd=folder,
                    stdin=subprocess.DEVNULL,
                    stdout=file,
                    stderr=subprocess.STDOUT,
                    start_new_session=True,
                )
            except OSError as error:
                raise CannotStartError(error.strerror or str(error)) from None
        with _guard_group(child.pid):
            while True:
                remaining = deadline - time.monotonic()
                if remaining <= 0.0:
                    raise OutOfTime
                with contextlib.suppress(subprocess.TimeoutExpired):
                    return child.wait(min(remaining, _POLL_EVERY))
                if watch is not None:
                    watch()
    finally:
        if child is not None:  # end the remaining processes of its group
            if child.poll() is None:
                _signal(child.pid, signal.SIGTERM)
                with contextlib.suppress(subprocess.TimeoutExpired):
                    child.wait(_GRACE)
            _signal(child.pid, signal.SIGKILL)
            child.wait()


@contextlib.contextmanager
def _defer_signal(number: int) -> Iterator[None]:
    """Call a signal's handler after the block: it may raise before the child's pid is known."""
    handler = signal.getsignal(number)
    if not callable(handler) or threading.current_thread() is not threading.main_thread():
        yield
        return
    late: list[int] = []
    signal.signal(number, lambda *_: late.append(number))
    try:
        yield
    finally:
        signal.signal(number, handler)
        if late:
            signal.raise_signal(number)


@contextlib.contextmanager
def _guard_group(group: int) -> Iterator[None]:
    """Kill a process group if this program is gone before the block ends."""
    guard = subprocess.Popen(
        ["/bin/sh", "-c", _GUARD, str(group)],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,  # a signal to this process group must not end the guard
    )
    try:
        yield
    finally:
        with contextlib.suppress(BrokenPipeError):
            guard.communicate(b"\n")


def _signal(group: int, number: int) -> None:
    """Send a signal to a process group; one without processes is no error."""
    # macOS refuses the signal ("not permitted") to a group of zombies.
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(group, number)


def deck_report(deck: Deck) -> tuple[dict[str, Any], list[BundleProblem]]:
    """Return a summary of a deck, and warnings about conditions that may prevent a solve.

    The summary: ``file``, ``program`` (its path, None if not found), ``reader``, ``moment``,
    ``unit`` and ``timeout`` (s). A program that is not installed here is a warning, not an error,
    because solves may run elsewhere.

    Raises BundleError if the deck lacks a placeholder, or a content that its reader needs.
    """
    content = deck.file.read_bytes()
    where = "write it where that load acts, or in a comment that says what takes the load instead"
    problems = [
        BundleProblem("deck.file", f"has no {name}; {where}")
        for name in missing_placeholders(content)
    ]
    text = "\n".join(
        file.read_text(encoding="utf-8", errors="replace") for file in (deck.file, *deck.files)
    )
    mistakes = reader_named(deck.output["reader"]).mistakes(text, deck)
    problems += [BundleProblem("deck.file", f"{deck.file.name} {mistake}") for mistake in mistakes]
    if problems:
        raise BundleError(problems)

    name = deck.command[0].replace("{job}", deck.file.stem)
    # A name without a slash is sought on the PATH alone, even if a file of the bundle has it.
    is_in_bundle = "/" in name and any(Path(name) == Path(file.name) for file in deck.files)
    program = name if is_in_bundle else shutil.which(name)
    summary = {
        "file": deck.file.name,
        "program": program,
        "reader": deck.output["reader"],
        "moment": deck.moment,
        "unit": deck.unit,
        "timeout": deck.timeout,
    }
    if program:
        return summary, []
    message = (
        f'the program "{name}" is not on the PATH of this machine; install it where solves run'
    )
    return summary, [BundleProblem("deck.command", message)]


def _solver_failed(program: str, ending: str, quoted: str, folder: Path) -> SolveFailed:
    """Return the failure that a program reports, by its exit code or in its output."""
    return SolveFailed(
        "solver_failed", f'"{program}" {ending}. It printed: {quoted}', _files_hint(folder)
    )


def _bad_output(message: str, folder: Path) -> SolveFailed:
    """Return the failure of output in which the interface's motion cannot be found."""
    return SolveFailed("bad_output", message, _files_hint(folder))


def _files_hint(folder: Path) -> str:
    # Not the full path: clients must not learn the server's folders.
    return (
        "The deck as it was run and all that the solver wrote are in "
        f"{folder.parent.name}/{folder.name} of the attempt's files."
    )
