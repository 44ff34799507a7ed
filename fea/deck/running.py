"""One run of a deck: fill in the loads, run the command within a timeout, read the motion."""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import signal
import subprocess
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np

from wrenchbook.fea.deck import failures
from wrenchbook.fea.readers.reader import DeckReader, DeckRun, OutputError, Reading
from wrenchbook.fea.readers.registry import reader_named
from wrenchbook.fea.solution import Progress
from wrenchbook.fea.spec.schema import UNITS, Deck

Array = np.ndarray

LOADS = ("FX", "FY", "FZ", "MX", "MY", "MZ")
"""The placeholders, each with a $ before it, in the order of the wrench contract."""

PRINTED = "printed.txt"
"""What the program wrote to its standard output and errors."""

_PLACEHOLDER = re.compile(rb"\$([FM][XYZ])\b")
_MOST_QUOTED = 400  # characters


def missing_placeholders(deck: bytes) -> list[str]:
    """Return the placeholders that a deck's text does not have."""
    there = {found.decode() for found in _PLACEHOLDER.findall(deck)}
    return [f"${load}" for load in LOADS if load not in there]


def filled(deck: bytes, loads: Sequence[float]) -> bytes:
    """Return a deck's text with six numbers in place of the placeholders.

    A number has 20 characters at the most, which is all that CalculiX reads of one.

    Raises
    ------
    SolveFailed
        ``bad_deck`` if a placeholder is missing: its load would have no effect.
    """
    missing = missing_placeholders(deck)
    if missing:
        raise failures.bad_deck(
            f"The deck has no {', '.join(missing)}, so that load would be lost.",
            "Put each placeholder where its load goes; where a guide takes the load, into a "
            "comment line that says so.",
        )
    pairs = zip(LOADS, loads, strict=True)
    values = {load.encode(): f"{value:.12e}".encode() for load, value in pairs}
    return _PLACEHOLDER.sub(lambda found: values[found[1]], deck)


def run_deck(deck: Deck, wrench: Array, folder: Path, progress: Progress) -> tuple[Array, int]:
    """Run a deck once, in a folder made for it.

    Parameters
    ----------
    deck
        What to run.
    wrench
        Shape (6,), N and N·m, with the moment that the deck takes.
    folder
        Where its files are put and stay; must not exist yet.
    progress
        Called while it runs, as far as the reader can tell.

    Returns
    -------
    displacement, unknowns
        Shape (6,), m and rad; degrees of freedom, 0 if unknown.

    Raises
    ------
    SolveFailed
        ``bad_deck``, ``no_solver``, ``timed_out``, ``solver_failed``, ``not_converged`` or
        ``bad_output``.
    """
    metres = UNITS[deck.unit]
    loads = np.concatenate([wrench[:3], wrench[3:] / metres])
    text = filled(deck.file.read_bytes(), loads.tolist())
    folder.mkdir(parents=True)
    for file in deck.files:
        shutil.copy(file, folder / file.name)
    (folder / deck.file.name).write_bytes(text)
    run = DeckRun(folder, deck.file.stem, folder / PRINTED)
    reading = _run(deck, run, reader_named(deck.output["reader"]), progress)
    displacement = np.array(reading.displacement, dtype=float)
    if displacement.shape != (6,) or not np.isfinite(displacement).all():
        message = f"The reader gave no six finite numbers but {reading.displacement}."
        raise failures.bad_output(message, folder)
    return np.concatenate([displacement[:3] * metres, displacement[3:]]), reading.unknowns


def _run(deck: Deck, run: DeckRun, reader: DeckReader, progress: Progress) -> Reading:
    command = [word.replace("{job}", run.job) for word in deck.command]

    def watch() -> None:
        stage = reader.stage(run)
        if stage is not None:
            progress(*stage)

    try:
        code = run_command(command, run.folder, run.printed, deck.timeout, watch)
    except OutOfTime:
        raise failures.timed_out(command[0], deck.timeout) from None
    except OSError as error:
        raise failures.no_solver(command[0], error.strerror or str(error)) from None
    program = command[0]
    complaint = reader.complaint(run)
    if complaint is not None and complaint.not_converged:
        raise failures.not_converged(program, complaint.quoted)
    if complaint is not None:
        raise failures.solver_failed(program, _how(code), complaint.quoted, run.folder)
    if code != 0:
        text = run.printed.read_text(encoding="utf-8", errors="replace").strip()
        raise failures.solver_failed(
            program, _how(code), text[-_MOST_QUOTED:] or "nothing", run.folder
        )
    try:
        return reader.read(run, deck.output)
    except OutputError as error:
        raise failures.bad_output(str(error), run.folder) from None


def _how(code: int) -> str:
    if code == 0:
        return "reported an error"
    if code > 0:
        return f"ended with exit code {code}"
    try:
        name = signal.Signals(-code).name
    except ValueError:
        name = f"signal {-code}"
    memory = " (out of memory?)" if -code == signal.SIGKILL else ""
    return f"was ended by {name}{memory}"


_GRACE = 2.0  # seconds between asking to end and killing; engines wait 5 s for us
_LOOK_EVERY = 0.25  # seconds
# Reads until this program writes a line (all is well) or is gone, even by SIGKILL.
_GUARD = 'read -r _ || kill -s KILL -- "-$0"'


class OutOfTime(Exception):  # noqa: N818 - an outcome, named as what happened
    """The program did not end in time and has been ended."""


def run_command(
    command: Sequence[str],
    folder: Path,
    printed: Path,
    timeout: float,
    watch: Callable[[], None] | None = None,
) -> int:
    """Run a program in `folder` and return its exit code, minus the signal if one ended it.

    The environment (OMP_NUM_THREADS and the like) is passed on as it is. When this returns or
    raises, whatever it raises, the program and all that it started in its process group are gone;
    they are also gone soon after this program is killed.

    Parameters
    ----------
    command
        The program and its arguments.
    printed
        File for its standard output and errors.
    timeout
        Seconds.
    watch
        Called a few times a second while it runs.

    Raises
    ------
    OSError
        If the program cannot be started.
    OutOfTime
        If `timeout` is over.
    """
    deadline = time.monotonic() + timeout
    child = _start(command, folder, printed)
    try:
        with _guarded(child.pid):
            while True:
                left = deadline - time.monotonic()
                if left <= 0.0:
                    raise OutOfTime
                with contextlib.suppress(subprocess.TimeoutExpired):
                    return child.wait(min(left, _LOOK_EVERY))
                if watch is not None:
                    watch()
    finally:
        # End what is left of the child's process group.
        if child.poll() is None:
            _signal(child.pid, signal.SIGTERM)
            with contextlib.suppress(subprocess.TimeoutExpired):
                child.wait(_GRACE)
        _signal(child.pid, signal.SIGKILL)
        child.wait()


def _start(command: Sequence[str], folder: Path, printed: Path) -> subprocess.Popen[bytes]:
    with printed.open("wb") as file:
        return subprocess.Popen(
            command,
            cwd=folder,
            stdin=subprocess.DEVNULL,
            stdout=file,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )


@contextlib.contextmanager
def _guarded(group: int) -> Iterator[None]:
    """Kill a process group if this program is gone before the block ends."""
    guard = subprocess.Popen(
        ["/bin/sh", "-c", _GUARD, str(group)],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,  # what ends our own process group must not end the guard
    )
    try:
        yield
    finally:
        with contextlib.suppress(BrokenPipeError):
            guard.communicate(b"\n")


def _signal(group: int, number: int) -> None:
    # Nobody left in it: gone; macOS says "not permitted" of a group of zombies.
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(group, number)
