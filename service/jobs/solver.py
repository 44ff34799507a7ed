"""The solver: ``python -m wrenchbook.service.jobs.solver --channel DESCRIPTOR``.

The engine `local` starts it with one end of a socket pair, over which attempts come one by one
(`service.jobs.solver_pool`). Imports and the component are reused for the next attempt. The process
ends if the socket is closed, if an attempt was cancelled or ran out of memory, if its memory has
grown, and after a number of attempts.

An attempt's ``result.json`` has its outcome: ``done`` with the numbers, ``failed`` with kind,
message and remedy, or ``cancelled``. Only a killed solver writes none.

``WRENCHBOOK_SOLVE="package.module:function"`` replaces the embedded solver by a function of an
`Attempt` and a progress callback. It returns a mapping with at least ``displacement`` (6 numbers, m
and rad), or raises an exception, whose attributes ``kind`` and ``remedy`` are reported if present.
"""

from __future__ import annotations

import argparse
import contextlib
import errno
import hashlib
import importlib
import math
import os
import resource
import select
import signal
import socket
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from wrenchbook.service.fields.record import write_files
from wrenchbook.service.files.program import solver_version
from wrenchbook.service.jobs.attempt import (
    BEGUN,
    ENDS,
    FREE,
    PROGRESS,
    Attempt,
    Outcome,
    Progress,
    read_attempt,
    write_json,
    write_outcome,
)

if TYPE_CHECKING:  # imported by the first solve: it takes half a second
    from wrenchbook.fea.recovery.fields import SolveFields
    from wrenchbook.fea.solve import Solver
    from wrenchbook.fea.spec.schema import Bundle

SOLVE_VARIABLE = "WRENCHBOOK_SOLVE"
MARGIN_VARIABLE = "WRENCHBOOK_MEMORY_MARGIN"
# Ratio of the memory limit to the estimate of `wrenchbook check`: a factor of two for the estimate,
# which is right to that, and of two for address space, which the limit counts and of which a part
# is never used. Shipped components take 0.2 GB of it, by an estimate of 0.25 to 0.31 GB.
MEMORY_MARGIN = 4.0
# Growth of memory, bytes, that is no leak: it varies by 30 MB from one attempt to the next.
MIN_GROWTH = 256 << 20

DONE, FAILED, CANCELLED = 0, 1, 143  # of `run_attempt`: an exit status, 128 + SIGTERM

# Time without work after which the process ends, to free its memory; a new start takes a second.
IDLE_SECONDS = 300.0
_MAX_PATH_BYTES = 1 << 16  # longest folder name of a message; Linux allows paths of 4 kB
_PROCESS_PAGES = Path("/proc/self/statm")  # proc(5): size, resident and more, in pages

REPORT_SECONDS = 0.2  # pause between two writes of progress.json: a page shows it once a second

# Time for which an outcome waits for room on a full disk, so that an operator can make some.
FULL_DISK_SECONDS = 3600.0
_AGAIN_SECONDS = 1.0  # pause between two attempts to write it

Report = Callable[[float, str], None]
Solve = Callable[[Attempt, Report], Mapping[str, Any]]


class SolveRefusedError(Exception):
    """The attempt cannot be solved, for a reason that is not the solver's."""

    def __init__(self, kind: str, message: str, remedy: str) -> None:
        super().__init__(message)
        self.kind = kind
        self.remedy = remedy


class Cancelled(BaseException):
    """The solver received SIGTERM."""


class ComponentSolver:
    """Solves attempts with the finite elements of this project, or with a deck's solver.

    The last component is cached with its mesh, order of elimination, first factor and linear
    response. Every attempt reads the bundle again and compares the hash of its files with that of
    the cached one. A failed attempt clears the cache, as it may have left it in any state.

    `ready`: the cached `fea.solve.Solver`, or None.
    `estimated`: bytes that a solve with it takes by the check's estimate; 0 without a component.
    `spoiled`: whether memory ran out, which leaves the solver in an undefined state.
    """

    def __init__(self) -> None:
        self.spoiled = False
        self.ready: Solver | None = None
        self.estimated = 0
        self._key: tuple[str, str, bytes] | None = None
        self._limited: tuple[int | None, int | None] = None, None
        self._measured: object = object()  # `ready` at the time of `_first_bytes`
        self._first_bytes = 0  # memory after the first attempt with it

    def solve(self, attempt: Attempt, report: Report) -> Mapping[str, Any]:
        """Return the numbers of the outcome; earlier attempts do not change their bits.

        Raises SolveRefusedError if the component has changed, or memory ran out.
        """
        from wrenchbook.fea.bundle.read import read_bundle

        bundle = read_bundle(Path(attempt.bundle))
        _require_same(attempt, bundle.fingerprint)
        if bundle.deck is not None:
            limit_memory(None)  # the deck's solver, whose memory is unknown, would inherit it
            return _solve(bundle, attempt, report)
        try:
            solver = self._solver_of(bundle, attempt)
            self._limit(self.estimated)
            return _solve(solver, attempt, report)
        except MemoryError as error:
            self.spoiled = True
            estimated, limit = self._limited
            message = "the machine has no memory left for this solve"
            remedy = "use fewer solvers at a time or a coarser mesh"
            if estimated and limit:
                margin = f"{limit / estimated:.2g}"
                message = (
                    f"the solve needs more than the {limit / 1e9:.2g} GB allowed, which are "
                    f"{margin} times its estimate of {estimated / 1e9:.2g} GB"
                )
                remedy = (
                    "use a coarser mesh; or, if the machine has the memory, serve with a larger "
                    f"{MARGIN_VARIABLE} (now {margin})"
                )
            raise SolveRefusedError("out_of_memory", message, remedy) from error
        except BaseException:
            self._drop()
            raise

    def has_grown(self) -> bool:
        """Return whether memory has grown by a leak since the first attempt with the component."""
        _, memory = _process_bytes()
        if self.ready is not self._measured:
            self._measured = self.ready
            self._first_bytes = memory
        return memory > self._first_bytes + max(self.estimated, MIN_GROWTH)

    def _solver_of(self, bundle: Bundle, attempt: Attempt) -> Solver:
        """Return the solver of a bundle, cached or built."""
        from wrenchbook.fea.bundle.read import FILE_NAME, read_bundle
        from wrenchbook.fea.check.cost import estimate
        from wrenchbook.fea.component import build
        from wrenchbook.fea.export.failure_record import write_failure
        from wrenchbook.fea.failure import SolveFailed
        from wrenchbook.fea.solve import Solver

        # The fingerprint leaves out the load range, which changes notes but no answer.
        text = hashlib.sha256((bundle.folder / FILE_NAME).read_bytes()).digest()
        key = str(bundle.folder), bundle.fingerprint, text
        if self.ready is not None and key == self._key:
            return self.ready
        self._drop()
        self._limit(attempt.memory)
        component = build(bundle)
        # `build` has read the files again: an edit since the first hash must not be cached.
        _require_same(attempt, read_bundle(bundle.folder).fingerprint)
        self.estimated = estimate(component)["memory_bytes"]
        self._limit(self.estimated)
        try:
            self.ready = Solver(component)
            self._key = key
            return self.ready
        except SolveFailed as failure:
            write_failure(attempt.folder, failure, component)
            raise

    def _limit(self, estimated: int | None) -> None:
        self._limited = estimated, limit_memory(estimated)

    def _drop(self) -> None:
        self._key = None
        self.ready = None
        self.estimated = 0


def _require_same(attempt: Attempt, fingerprint: str) -> None:
    """Raise SolveRefusedError if the component has changed since the job was accepted."""
    if fingerprint != attempt.fingerprint:
        raise SolveRefusedError(
            "component_changed",
            f"component {attempt.component} has changed since the job was accepted "
            f"(fingerprint {attempt.fingerprint} then, {fingerprint} now)",
            "ask for the wrench again, which queues a job for the present component",
        )


def _solve(ready: Solver | Bundle, attempt: Attempt, report: Report) -> dict[str, Any]:
    """Solve an attempt and return the numbers of the outcome.

    `ready`: a solver, or the bundle of a deck.
    """
    from wrenchbook.fea.solve import solve

    def write_fields(fields: SolveFields) -> None:
        """Write surface and stresses beside the outcome, which is useful without them too."""
        try:
            write_files(attempt.folder, attempt.wrench, fields)
        except (OSError, ValueError, MemoryError) as error:
            with contextlib.suppress(OSError):  # on a full disk the log has no room either
                print(f"the deformed surface was not kept: {error}", file=sys.stderr)

    solution = solve(ready, attempt.wrench, report, attempt.folder, write_fields)
    with contextlib.suppress(OSError):  # a full disk: the outcome has the notes too
        for note in solution.notes:
            print(note)
    tensors = ("displacement", "compliance", "curvature")
    numbers = ("strain_energy", "work", "seconds", "unknowns", "history", "notes")
    result = {name: getattr(solution, name) for name in (*tensors, *numbers)}
    if attempt.estimate:
        from wrenchbook.fea.accuracy.estimate import accuracy_or_why, unknown_of_deck
        from wrenchbook.fea.spec.schema import Bundle

        report(1.0, "estimating the error of the mesh")
        # An answer is useful without the estimate, so an error is a value and no exception here.
        is_deck = isinstance(ready, Bundle)
        result["solver_error"] = unknown_of_deck(ready) if is_deck else accuracy_or_why(ready)
    return result


def limit_memory(estimated: int | None) -> int | None:
    """Limit this process to its present address space and the margin times an estimate, bytes.

    None removes the limit. Return the bytes allowed beyond the present ones; None without a limit.

    Raises SolveRefusedError if the environment's `MARGIN_VARIABLE` is no finite number above 0.
    """
    hard = resource.getrlimit(resource.RLIMIT_AS)[1]
    soft = hard
    allowed = None
    if estimated and sys.platform == "linux":  # other systems ignore or refuse the limit
        text = os.environ.get(MARGIN_VARIABLE, str(MEMORY_MARGIN))
        try:
            margin = float(text)
        except ValueError:
            margin = 0.0
        if not 0.0 < margin < math.inf:
            message = f"{MARGIN_VARIABLE} must be a finite number above 0, not {text!r}"
            remedy = f"set {MARGIN_VARIABLE}={MEMORY_MARGIN:g} where the server starts, or unset it"
            raise SolveRefusedError("bad_setting", message, remedy)
        allowed = int(estimated * margin)
        address_space, _ = _process_bytes()
        soft = address_space + allowed
        if hard != resource.RLIM_INFINITY:
            soft = min(soft, hard)
    resource.setrlimit(resource.RLIMIT_AS, (soft, hard))
    return allowed


def _process_bytes() -> tuple[int, int]:
    """Return the address space and the memory of this process; zeros except on Linux."""
    if sys.platform != "linux":
        return 0, 0
    size, resident, *_ = map(int, _PROCESS_PAGES.read_text().split())
    return size * resource.getpagesize(), resident * resource.getpagesize()


def run_attempt(folder: str | Path, solve: Solve | None = None) -> int:
    """Solve the attempt in `folder`, write its result.json, return DONE, FAILED or CANCELLED.

    `solve`: by default the solver that ``WRENCHBOOK_SOLVE`` names, else the embedded one.
    """
    attempt = read_attempt(Path(folder))
    try:
        with _unblocked_sigterm():
            solver = solve or _named_solver() or ComponentSolver().solve
            numbers = solver(attempt, _Reporter(attempt.folder))
            outcome = _outcome_of(numbers, loads=len(attempt.wrench))
        _write_patiently(attempt, outcome)
        return DONE
    except Cancelled:
        # Not durable: a slow disk may take longer than the engine's grace, and no number is lost.
        write_outcome(attempt, Outcome("cancelled"), durable=False)
        return CANCELLED
    except Exception as error:
        with contextlib.suppress(OSError):  # a full disk
            traceback.print_exc()
        _write_patiently(attempt, _failed_outcome(error))
        return FAILED


def _write_patiently(attempt: Attempt, outcome: Outcome) -> None:
    """Write the outcome, which may be the result of hours; on a full disk wait for room."""
    for _ in range(round(FULL_DISK_SECONDS / _AGAIN_SECONDS)):
        try:
            write_outcome(attempt, outcome)
            return
        except OSError as error:
            if error.errno not in (errno.ENOSPC, errno.EDQUOT):
                raise
        time.sleep(_AGAIN_SECONDS)
    write_outcome(attempt, outcome)


class _Reporter:
    """Writes progress.json, at most once in `REPORT_SECONDS`."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / PROGRESS
        self._next = 0.0

    def __call__(self, fraction: float, message: str) -> None:
        now = time.monotonic()
        if now < self._next:
            return
        self._next = now + REPORT_SECONDS
        fraction = min(max(float(fraction), 0.0), 1.0) if math.isfinite(fraction) else 0.0
        try:
            write_json(self._path, asdict(Progress(fraction, str(message))))
        except OSError as error:
            with contextlib.suppress(OSError):  # on a full disk the log has no room either
                print(f"progress not written: {error}", file=sys.stderr)


def _named_solver() -> Solve | None:
    """Return the solver of ``WRENCHBOOK_SOLVE``; None if it is not set.

    Raises SolveRefusedError if it names no function.
    """
    name = os.environ.get(SOLVE_VARIABLE)
    if not name:
        return None
    module, separator, function = name.partition(":")
    why = "it does not have the form package.module:function"
    if separator and module:
        try:
            imported = importlib.import_module(module)
        except Exception as error:  # any error of the module's own code
            why = f"the module {module} cannot be imported: {type(error).__name__}: {error}"
        else:
            solve: Solve | None = getattr(imported, function, None)
            if callable(solve):
                return solve
            why = f"the module {module} has no function {function!r}"
    remedy = "set it to package.module:function, importable by the solvers, or unset it"
    raise SolveRefusedError("no_solver", f"{SOLVE_VARIABLE}={name!r}: {why}", remedy)


def _outcome_of(numbers: Mapping[str, Any], loads: int) -> Outcome:
    """Return the outcome of a solver's report.

    A displacement has 6 numbers an interface, a compliance as many lines of `loads` numbers, a
    curvature loads (loads + 1) (loads + 2) / 6 numbers. The last two are dropped if not finite.

    Raises SolveRefusedError if the report has no displacement, or other numbers.
    """
    plain = {name: _plain(value) for name, value in numbers.items()}
    outcome = Outcome.of(plain | {"status": "done", "program": solver_version()})
    displacement = outcome.displacement
    interfaces = len(displacement) // 6 if isinstance(displacement, list) else 1
    outputs = 6 * max(interfaces, 1)
    _require_form("displacement", displacement, outputs)
    if None in (displacement or ()):
        raise SolveRefusedError(
            "bad_answer",
            "the solver's displacement has numbers that are not finite: "
            f"{numbers['displacement']!s:.200}",
            "check mesh and supports of the component with: wrenchbook check FOLDER",
        )
    if outcome.compliance is not None:
        _require_form("compliance", outcome.compliance, outputs, loads)
        if any(None in line for line in outcome.compliance):
            outcome.compliance = None
    if outcome.curvature is not None:
        _require_form("curvature", outcome.curvature, loads * (loads + 1) * (loads + 2) // 6)
        if None in outcome.curvature:
            outcome.curvature = None
    return outcome


def _require_form(name: str, values: Any, *shape: int) -> None:
    """Raise SolveRefusedError unless values are nested lists of numbers or None of a shape."""
    if not _has_form(values, *shape):
        form = " x ".join(map(str, shape))
        message = f"the solver's {name} must be a list of {form} numbers, not {values!s:.200}"
        remedy = f"correct the function that the variable {SOLVE_VARIABLE} names"
        raise SolveRefusedError("bad_answer", message, remedy)


def _has_form(values: Any, *shape: int) -> bool:
    """Return whether values are nested lists of numbers or None of a shape."""
    if not shape:
        is_number = type(values) in (int, float) and abs(values) <= sys.float_info.max
        return values is None or is_number
    is_list = isinstance(values, list) and len(values) == shape[0]
    return is_list and all(_has_form(value, *shape[1:]) for value in values)


def _plain(value: Any) -> Any:
    """Return a value for JSON: arrays as lists, numbers that are not finite as None."""
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, Mapping):
        return {str(name): _plain(entry) for name, entry in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [_plain(entry) for entry in value]
    return value


def _failed_outcome(error: Exception) -> Outcome:
    """Return the outcome of an attempt that raised an error."""
    kind = getattr(error, "kind", None)
    remedy = getattr(error, "remedy", None)
    if kind is None and hasattr(error, "problems"):
        kind, remedy = "bad_component", "correct the component's bundle and ask again"
    if isinstance(error, MemoryError):
        kind, remedy = "out_of_memory", "use fewer solvers at a time or a coarser mesh"
    # The text of a `SolveFailed` repeats kind and remedy; its message does not.
    message = str(getattr(error, "message", "") or error) or type(error).__name__
    return Outcome.failed(
        str(kind or "internal_error"),
        message if kind else f"{type(error).__name__}: {message}",
        str(remedy or "see its log (GET /v1/jobs/NUMBER/log), remove the cause, and retry the job"),
    )


def _block_sigterm() -> None:
    """Block SIGTERM until `run_attempt` unblocks it; the signal then raises `Cancelled`.

    A pending signal was sent to the attempt before, and is discarded.
    """

    def cancel(signum: int, frame: object) -> None:
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        raise Cancelled

    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM})
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # discards a pending signal
    signal.signal(signal.SIGTERM, cancel)


@contextlib.contextmanager
def _unblocked_sigterm() -> Iterator[None]:
    """Unblock SIGTERM during a solve: it must not interrupt the writing of an outcome."""
    before = signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGTERM})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def serve(channel: socket.socket, attempts: int) -> None:
    """Solve the attempts that come over the channel, at most a number of `attempts`.

    End earlier after a long time without work, without a server, after a cancelled attempt, and if
    memory has run out or grown.
    """
    channel.settimeout(IDLE_SECONDS)
    solver = ComponentSolver()
    stays = True
    while stays and (received := _receive(channel)) is not None:
        folder, lock, log = received
        _print_to(log)
        os.chdir(folder)
        _block_sigterm()
        os.pwrite(lock, str(os.getpid()).encode(), 0)  # the solver has begun
        is_connected = _send(channel, BEGUN)
        code = run_attempt(folder, None if os.environ.get(SOLVE_VARIABLE) else solver.solve)
        attempts -= 1
        is_usable = not (solver.has_grown() or solver.spoiled)
        stays = is_connected and is_usable and code != CANCELLED and attempts > 0
        _leave_attempt(lock)
        stays = _send(channel, FREE if stays else ENDS) and stays


def _receive(channel: socket.socket) -> tuple[Path, int, int] | None:
    """Return the next attempt's folder, lock and log; None if no further one will come."""
    try:
        path, files, _, _ = socket.recv_fds(channel, _MAX_PATH_BYTES, 2)
    except OSError:  # a long time without work, or the server is gone
        return None
    if not path or len(files) != 2:
        return None
    for file in files:
        # Children of the solver must not hold the lock after its end.
        os.set_inheritable(file, False)
    lock, log = files
    return Path(os.fsdecode(path)), lock, log


def _send(channel: socket.socket, message: bytes) -> bool:
    """Send a message to the server; return False if it is gone."""
    try:
        channel.sendall(message)
    except OSError:
        return False
    return True


def _leave_attempt(lock: int) -> None:
    """Release an attempt's log, folder and memory limit, and last its lock."""
    with contextlib.suppress(OSError):  # a full disk
        sys.stdout.flush()
    _print_to(os.open(os.devnull, os.O_WRONLY))
    os.chdir("/")
    limit_memory(None)
    os.close(lock)


def _print_to(file: int) -> None:
    """Redirect stdout and stderr to an open file, and close its descriptor."""
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    for descriptor in (1, 2):
        os.dup2(file, descriptor)
    os.close(file)


def _end_with(channel: int) -> None:
    """Kill this process and its children once the other end of the channel is closed."""
    closed = select.poll()
    closed.register(channel, 0)  # a hang-up is always reported
    closed.poll()
    os.killpg(0, signal.SIGKILL)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the solver process by its command line."""
    _block_sigterm()
    parser = argparse.ArgumentParser(prog="python -m wrenchbook.service.jobs.solver")
    parser.add_argument("--channel", type=int, required=True, help="open socket, the solver's end")
    parser.add_argument("--attempts", type=int, required=True, help="attempts before it ends")
    parser.add_argument("--niceness", type=int, default=0)
    parser.add_argument("--end-with-engine", action="store_true", help="even in an attempt")
    options = parser.parse_args(arguments)
    os.set_inheritable(options.channel, False)
    os.nice(options.niceness)
    if options.end_with_engine:
        threading.Thread(target=_end_with, args=(options.channel,), daemon=True).start()
    with socket.socket(fileno=options.channel) as channel:
        serve(channel, options.attempts)


if __name__ == "__main__":
    main()
