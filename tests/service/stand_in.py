"""Solvers that stand in for finite elements, named to runjob by WRENCHBOOK_SOLVE."""

import os
import signal
import subprocess
import threading
import time
from pathlib import Path

from tests.until import until
from wrenchbook.service.jobs.attempt import Outcome, write_outcome


def displacement(wrench):
    """The answer every stand-in gives: a millionth of the wrench."""
    return [load * 1e-6 for load in wrench]


def quick(spec, report):
    report(0.5, "half way")
    return {"displacement": displacement(spec.wrench), "seconds": 0.0}


def doubtful(spec, report):
    return {**quick(spec, report), "notes": ["mesh: 3 cells are strongly distorted"]}


def slow(spec, report):
    """Takes 0.3 s, long enough to be killed in the middle."""
    for step in range(15):
        report(step / 15, f"step {step}")
        time.sleep(0.02)
    return {"displacement": displacement(spec.wrench)}


def endless(spec, report):
    """Outlasts every test, but not by much: a failed one must leave nothing behind for good."""
    report(0.25, "still going")
    threading.Event().wait(120)


def deaf(spec, report):
    """Does not end on SIGTERM, as a factorisation in C would not."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    endless(spec, report)


def dies(spec, report):
    os.kill(os.getpid(), signal.SIGKILL)


def dies_twice(spec, report):
    if spec.attempt <= 2:
        dies(spec, report)
    return quick(spec, report)


class NotConvergedError(Exception):
    kind = "not_converged"
    remedy = "use smaller load steps"


def diverges(spec, report):
    raise NotConvergedError("no equilibrium at load factor 0.5")


def describe(spec, report):
    """Tells in what surroundings solvers run."""
    seen = {
        "threads": os.environ["OPENBLAS_NUM_THREADS"],
        "niceness": os.getpriority(os.PRIO_PROCESS, 0),
        "session": os.getsid(0),
        "pid": os.getpid(),
        "folder": str(Path.cwd()),
    }
    return {"displacement": displacement(spec.wrench), "seen": seen}


def leaves_a_child(spec, report):
    """Starts another program, as a deck's solver is, and writes down its pid."""
    child = subprocess.Popen(["sleep", "60"], close_fds=False)
    Path("child").write_text(str(child.pid))
    endless(spec, report)


_answered = 0
_hoard = []


def counts(spec, report):
    """Tells how many attempts its process has answered, which process that is, and when."""
    global _answered
    _answered += 1
    print(f"answered {_answered}")
    seen = {"answered": _answered, "pid": os.getpid(), "folder": str(Path.cwd())}
    seen["at"] = time.monotonic_ns()
    return {"displacement": displacement(spec.wrench), "seen": seen}


def leaks(spec, report):
    """Keeps 300 MB of each attempt but the first."""
    if _answered:
        _hoard.append(b"x" * 300_000_000)
    return counts(spec, report)


def answers_and_dies(spec, report):
    """Dies after its outcome is on the disk and before it has told anybody."""
    write_outcome(spec, Outcome("done", displacement=displacement(spec.wrench)))
    dies(spec, report)


def slow_first(spec, report):
    """The first attempt of a job is endless, another one quick."""
    if spec.attempt == 1:
        endless(spec, report)
    return counts(spec, report)


def waits_for_a_word(spec, report):
    """Ends when a file `go` appears in its folder."""
    until(Path("go").exists)
    return {"displacement": displacement(spec.wrench)}


def reports_until_go(spec, report):
    """Tells how far it is, and ends when a file `go` appears in its folder."""
    report(0.25, "still going")
    return waits_for_a_word(spec, report)


def count_start(spec):
    """Count a start in the file that stands for the fingerprint."""
    with Path(spec.fingerprint).open("a") as starts:
        starts.write("start\n")


def counted_until_go(spec, report):
    """Counts its starts, and ends when a file `go` appears in its folder."""
    count_start(spec)
    return waits_for_a_word(spec, report)


def reads_its_bundle(spec, report):
    bundle = Path(spec.bundle)
    files = {path.name: path.read_text() for path in bundle.rglob("*") if path.is_file()}
    return {"displacement": displacement(spec.wrench), "seen": files}


def leaves_files(spec, report):
    Path("deck").mkdir()
    Path("deck", "part.dat").write_text("a number: 7")
    Path("failed.vtu").write_bytes(bytes(range(256)))
    diverges(spec, report)


def leaves_100_mb(spec, report):
    Path("huge.bin").write_bytes(bytes(100_000_000))
    print("x" * 3_000_000)
    print("the last line")
    return quick(spec, report)


def answers_100_mb(spec, report):
    return {**quick(spec, report), "notes": ["n" * 1_000_000] * 100}


def sleeps(spec, report):
    """Takes 10 ms, the shortest solve there is."""
    time.sleep(0.01)
    return {"displacement": displacement(spec.wrench)}


def by_component(spec, report):
    """Solve as the component's name says: one cluster's workers then solve in every way."""
    return globals()[spec.component](spec, report)
