"""Solvers that stand in for finite elements, named to runjob by WRENCHBOOK_SOLVE."""

import os
import signal
import subprocess
import time
from pathlib import Path


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
    for _ in range(6000):
        time.sleep(0.02)


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
