"""What the check tells of time and memory beside what a solve takes: `make bench NAME=check`.

Each solve is a process of its own on one thread; processor seconds, without imports. The flange is
a STEP file, drawn here; its mesh is made in the same process.
"""

import itertools
import json
import os
import subprocess
import sys

import pytest

from tests.benchmarks.test_mesh_error import STEPS, bundle_of

ONE = """
import json, resource, sys, time
from dataclasses import replace
from wrenchbook.fea.bundle.read import read_bundle
from wrenchbook.fea.bundle.shipped import SHIPPED
from wrenchbook.fea.check.cost import estimate
from wrenchbook.fea.component import build
from wrenchbook.fea.mesh.refine import refined
from wrenchbook.fea.solve import Solver
folder, factor, nonlinear = json.loads(sys.argv[1])
bundle = refined(read_bundle(SHIPPED / folder), factor)  # a whole path stays one
part = build(bundle)
part = replace(part, analysis=replace(part.analysis, nonlinear=nonlinear))
told = estimate(part)
started = time.process_time()
Solver(part).solve(0.5 * bundle.range.high)
took = time.process_time() - started
peak = 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
seconds = told["nonlinear_seconds" if nonlinear else "linear_seconds"]
print(json.dumps([told["unknowns"], seconds, took, told["memory_bytes"], peak]))
"""
CASES = [
    ("bar", 1.0, False),
    ("plate", 1.0, True),
    ("plate_thin", 1.0, True),
    ("spring", 1.0, True),
    ("plate", 1.5, False),
    ("plate", 2.0, False),
    ("plate", 1.5, True),
    ("flange", 1.0, False),
    ("flange", 1.8, False),
    ("flange", 1.0, True),
]


def in_a_process(program, text):
    """Return the last line of what a program prints, on one thread."""
    one_thread = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    run = subprocess.run(
        [sys.executable, "-c", program, json.dumps(text)],
        capture_output=True,
        text=True,
        check=True,
        timeout=600,
        env=os.environ | one_thread,
    )
    return run.stdout.splitlines()[-1]


@pytest.mark.parametrize("case", CASES)
def test_time_and_memory_are_told_within_one_and_a_half(case, tmp_path):
    name, *how = case
    if name in STEPS:
        bundle_of(name, tmp_path)
        name = str(tmp_path)
    text = in_a_process(ONE, [name, *how])
    unknowns, seconds, took, memory, peak = json.loads(text)
    print(
        f"\n{case}: {unknowns} unknowns, told {seconds:g} s, took {took:.2g} s "
        f"({seconds / took:.2f}); told {memory / 1e6:.0f} MB, took {peak / 1e6:.0f} MB "
        f"({memory / peak:.2f})"
    )
    assert 1 / 1.5 <= seconds / took <= 1.5
    assert 1 / 1.5 <= memory / peak <= 1.5


ESTIMATE = """
import json, sys, time
from dataclasses import replace
from wrenchbook.fea.accuracy.estimate import accuracy_of
from wrenchbook.fea.bundle.read import read_bundle
from wrenchbook.fea.solve import Solver
folder, nonlinear = json.loads(sys.argv[1])
bundle = read_bundle(folder)
bundle = replace(bundle, analysis=replace(bundle.analysis, nonlinear=nonlinear))
times = [time.process_time()]
solver = Solver(bundle)
times.append(time.process_time())
solver.linear
times.append(time.process_time())
accuracy_of(solver)
times.append(time.process_time())
print(json.dumps([solver.unknowns, *times]))
"""


@pytest.mark.parametrize("nonlinear", [True, False], ids=["nonlinear", "linear"])
@pytest.mark.parametrize("name", ["bracket", "flange", "cheese"])
def test_the_estimate_of_a_step_part_takes_no_longer_than_mesh_and_linear_solve(
    name, nonlinear, tmp_path, monkeypatch
):
    draw, _, *ends = STEPS[name]
    monkeypatch.setitem(STEPS, name, (draw, "4e-3", *ends))
    bundle_of(name, tmp_path)
    text = in_a_process(ESTIMATE, [str(tmp_path), nonlinear])
    unknowns, *times = json.loads(text)
    mesh, linear, estimate = (b - a for a, b in itertools.pairwise(times))
    print(
        f"\n{name}: {unknowns} unknowns, mesh {mesh:.2f} s, linear solve {linear:.2f} s, estimate "
        f"{estimate:.2f} s ({estimate / linear:.2f} of the solve, "
        f"{estimate / (mesh + linear):.2f} with the mesh)"
    )
    assert estimate <= 1.1 * (mesh + linear)
