"""Components whose deck is solved by a small Python script, for tests."""

from __future__ import annotations

import sys

from wrenchbook.fea.bundle.read import bundle_of

READ = """
import sys, os, time, signal, subprocess
job = sys.argv[1]
w = [float(word) for word in open(job + ".inp").read().split()]
def answer(*numbers):
    open(job + ".out", "w").write(" ".join(repr(float(n)) for n in numbers))
"""
SOFT = "answer(*(1e-6 * load for load in w))"
WRENCH = [1.0, -2.0, 3.0, 10.0, 20.0, -30.0]


def component(folder, script=SOFT, *, nonlinear=True, **deck):
    """A bundle in `folder` whose solver is `script`, after `READ`."""
    (folder / "job.inp").write_text("$FX $FY $FZ\n$MX $MY $MZ\n")
    (folder / "solver.py").write_text(READ + script)
    table = {
        "name": "scripted",
        "title": "Solved by a script",
        "analysis": {"nonlinear": nonlinear},
        "range": {"force": [10, 10, 10], "moment": [50, 50, 50]},
        "deck": {
            "file": "job.inp",
            "files": ["solver.py"],
            "command": [sys.executable, "solver.py", "{job}"],
            "output": {"reader": "numbers", "file": "{job}.out"},
            **deck,
        },
    }
    return bundle_of(table, folder)
