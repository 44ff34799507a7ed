"""Solve the wrench of an attempt's folder.

Every solver runs this (`service.jobs.warm_solver`); it connects the finite elements and the
service. ``result.json`` then has the end: ``done`` with the numbers, ``failed`` with kind, message
and remedy, or ``cancelled``. Only a solver that was killed leaves none.

``WRENCHBOOK_SOLVE="package.module:function"`` names another solver than the embedded one: a
function of a `Spec` and a progress callback that returns a mapping with at least
``displacement`` (6 numbers, m and rad), or raises. An exception with the attributes ``kind``
and ``remedy`` is reported with them.
"""

import contextlib
import errno
import functools
import importlib
import math
import os
import signal
import sys
import time
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from wrenchbook.service.fields.record import leave
from wrenchbook.service.files.program import solver_version
from wrenchbook.service.jobs.attempt import (
    PROGRESS,
    Progress,
    Spec,
    read_spec,
    write_outcome,
    write_whole,
)

SOLVE_VARIABLE = "WRENCHBOOK_SOLVE"
DONE, FAILED, CANCELLED = 0, 1, 143

# An outcome waits so long for room on a full disk: until an operator notices and makes some.
FULL_DISK_SECONDS = 3600.0
_AGAIN_SECONDS = 1.0

Report = Callable[[float, str], None]
Solve = Callable[[Spec, Report], Mapping[str, Any]]


class SolveRefusedError(Exception):
    """The attempt cannot be solved, for a reason that is not the solver's."""

    def __init__(self, kind: str, message: str, remedy: str) -> None:
        super().__init__(message)
        self.kind = kind
        self.remedy = remedy


class Cancelled(BaseException):
    """The solver received SIGTERM."""


def main(folder: str | Path, solve: Solve | None = None) -> int:
    """Solve the attempt in `folder`, write its result.json, return DONE, FAILED or CANCELLED.

    Parameters
    ----------
    folder : path
        The attempt's folder with its spec.json.
    solve : callable, optional
        Solver to use; by default the one that ``WRENCHBOOK_SOLVE`` names, or the embedded one.
    """
    folder = Path(folder)
    spec = read_spec(folder)
    try:
        with _hearing_sigterm():
            numbers = (solve or _chosen_solve(folder))(spec, _Reporter(folder))
        _write_patiently(
            folder, spec, {"status": "done", **_checked(numbers), "program": solver_version()}
        )
        return DONE
    except Cancelled:
        # Not durable: a slow disk must not outlast the engine's grace, and no number is lost.
        write_outcome(folder, spec, {"status": "cancelled"}, durable=False)
        return CANCELLED
    except Exception as error:
        with contextlib.suppress(OSError):
            traceback.print_exc()
        _write_patiently(folder, spec, {"status": "failed", "error": _named(error)})
        return FAILED


def _write_patiently(folder: Path, spec: Spec, outcome: Mapping[str, Any]) -> None:
    """Write the outcome once there is room for it: on a full disk it is all there is of hours."""
    for _ in range(round(FULL_DISK_SECONDS / _AGAIN_SECONDS)):
        try:
            write_outcome(folder, spec, outcome)
            return
        except OSError as error:
            if error.errno not in (errno.ENOSPC, errno.EDQUOT):
                raise
        time.sleep(_AGAIN_SECONDS)
    write_outcome(folder, spec, outcome)


def solve_embedded(spec: Spec, report: Report, folder: Path | None = None) -> Mapping[str, Any]:
    """Solve with the finite elements of this project, or a deck's solver in `folder`."""
    from wrenchbook.fea.bundle.read import read_bundle

    bundle = read_bundle(Path(spec.bundle))
    require_same(spec, bundle.fingerprint)
    return solve_ready(bundle, spec, report, folder)


def require_same(spec: Spec, fingerprint: str) -> None:
    """Refuse to solve a component that is not the one the job was accepted for."""
    if fingerprint != spec.fingerprint:
        raise SolveRefusedError(
            "component_changed",
            f"component {spec.component} has changed since the job was accepted "
            f"(fingerprint {spec.fingerprint} then, {fingerprint} now)",
            "ask for the wrench again: that makes a job for the component as it is now",
        )


def solve_ready(
    ready: Any, spec: Spec, report: Report, folder: Path | None = None
) -> dict[str, Any]:
    """Solve a bundle, or the solver made ready for it, and return the numbers of the outcome."""
    from wrenchbook.fea.solve import solve

    keep = None if folder is None else functools.partial(_leave_fields, folder, spec)
    solution = solve(ready, spec.wrench, progress=report, folder=folder, on_fields=keep)
    with contextlib.suppress(OSError):  # a full disk; the outcome holds them too
        for note in solution.notes:
            print(note)
    tensors = ("displacement", "compliance", "curvature")
    numbers = ("strain_energy", "work", "seconds", "unknowns", "history", "notes")
    result = {name: getattr(solution, name) for name in (*tensors, *numbers)}
    if spec.estimate:
        report(1.0, "estimating the error of the mesh")
        result["solver_error"] = _own_error(ready)
    return result


def _own_error(ready: Any) -> dict[str, Any]:
    """Return what the solver's answers may be wrong by, or why that is not known.

    An answer is worth having without it, so an error here is returned and not raised.
    """
    from wrenchbook.fea.accuracy.estimate import accuracy_or_why, unknown_of_deck
    from wrenchbook.fea.solve import Solver
    from wrenchbook.fea.spec.schema import Bundle

    if not isinstance(ready, Bundle):
        return accuracy_or_why(ready)
    return accuracy_or_why(Solver(ready)) if ready.deck is None else unknown_of_deck(ready)


def begin(lock: int) -> None:
    """Write this process's id into an attempt's lock, which it has: the solver has begun."""
    os.pwrite(lock, str(os.getpid()).encode(), 0)


def _leave_fields(folder: Path, spec: Spec, fields: Any) -> None:
    """Leave surface and stresses next to the outcome; an answer is worth having without them."""
    try:
        leave(folder, spec.wrench, fields)
    except (OSError, ValueError, MemoryError) as error:
        with contextlib.suppress(OSError):  # on a full disk the log has no room either
            print(f"the deformed surface was not kept: {error}", file=sys.stderr)


class _Reporter:
    """Writes progress.json, at most five times a second."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / PROGRESS
        self._next = 0.0

    def __call__(self, fraction: float, message: str) -> None:
        now = time.monotonic()
        if now < self._next:
            return
        self._next = now + 0.2
        fraction = min(max(float(fraction), 0.0), 1.0) if math.isfinite(fraction) else 0.0
        try:
            write_whole(self._path, asdict(Progress(fraction, str(message))))
        except OSError as error:
            print(f"progress not written: {error}", file=sys.stderr)


def _chosen_solve(folder: Path) -> Solve:
    name = os.environ.get(SOLVE_VARIABLE)
    if not name:
        return functools.partial(solve_embedded, folder=folder)
    try:
        module, function = name.split(":")
        return getattr(importlib.import_module(module), function)
    except (ValueError, ImportError, AttributeError) as error:
        raise SolveRefusedError(
            "no_solver",
            f"{SOLVE_VARIABLE}={name!r} names no function: {error}",
            "set it to package.module:function, importable by the solvers, or unset it",
        ) from error


def _checked(numbers: Mapping[str, Any]) -> dict[str, Any]:
    outcome = {name: _plain(value) for name, value in numbers.items()}
    displacement = outcome.get("displacement")
    if not isinstance(displacement, list) or len(displacement) < 6 or None in displacement:
        raise SolveRefusedError(
            "bad_answer",
            f"the solver gave no 6 finite numbers or more but {numbers.get('displacement')!r}",
            "look at the component's mesh and supports; see log.txt",
        )
    compliance = outcome.get("compliance")
    if compliance is not None and any(None in line for line in compliance):
        outcome["compliance"] = None
    if None in (outcome.get("curvature") or ()):
        outcome["curvature"] = None
    return outcome


def _plain(value: Any) -> Any:
    """Return a value as JSON has it: arrays as lists, numbers that are not finite as null."""
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, Mapping):
        return {str(name): _plain(entry) for name, entry in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [_plain(entry) for entry in value]
    return value


def _named(error: Exception) -> dict[str, str]:
    kind = getattr(error, "kind", None)
    remedy = getattr(error, "remedy", None)
    if kind is None and hasattr(error, "problems"):
        kind, remedy = "bad_component", "correct the component's bundle and ask again"
    if isinstance(error, MemoryError):
        kind, remedy = "out_of_memory", "use fewer solvers at a time or a coarser mesh"
    # A solver's own failure as text begins with its kind and ends in its remedy: each stands once.
    message = str(getattr(error, "message", "") or error) or type(error).__name__
    return {
        "kind": str(kind or "internal_error"),
        "message": message if kind else f"{type(error).__name__}: {message}",
        "remedy": str(remedy or "see log.txt in the attempt's folder"),
    }


def keep_sigterm_waiting() -> None:
    """Block SIGTERM until `main` unblocks it; it then raises `Cancelled`."""
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM})
    signal.signal(signal.SIGTERM, _raise_cancelled)


def _raise_cancelled(signum: int, frame: object) -> None:
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    raise Cancelled


@contextlib.contextmanager
def _hearing_sigterm() -> Iterator[None]:
    """Let SIGTERM interrupt what is inside, if the command line has kept it waiting so far.

    Outside it is blocked, so that it can neither come before it is caught nor tear the
    writing of the outcome.
    """
    before = signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGTERM})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
