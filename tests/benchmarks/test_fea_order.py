"""The order of elimination on parts of any shape: the factor beside PARDISO's, memory beside ccx's.

One thread each, in turn, each in a process of its own; processor seconds. PARDISO is run if the
variable WRENCHBOOK_PARDISO names a Python that has pypardiso (a gigabyte of packages, so no
dependency); CalculiX's time is that of its whole run, whose solver is SPOOLES.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from statistics import median

import numpy as np
import pytest
import scipy.sparse as sparse

from tests.benchmarks.unstructured import NAMES, part_of
from tests.validation import calculix
from wrenchbook.fea.export.calculix import deck_of
from wrenchbook.fea.linalg.nested_dissection import unknowns_of
from wrenchbook.fea.solve import Solver
from wrenchbook.fea.spec.schema import PLACEHOLDERS

ROUNDS = int(os.environ.get("WRENCHBOOK_BENCH_ROUNDS", "3"))
PARDISO = os.environ.get("WRENCHBOOK_PARDISO")
WRENCH = (300.0, -200.0, 900.0, 3.0, -2.0, 1.0)
THREADS = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "CCX_NPROC_EQUATION_SOLVER"), "1"
)
LAUNCH = """
import os, sys
child = os.fork()
if not child:
    os.execvp(sys.argv[1], sys.argv[1:])
_, status, usage = os.wait4(child, 0)
print("\\n%d %r %r" % (status, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024))
"""
PROGRAM = Path(__file__).with_name("order_of_elimination.py")
ROOT = Path(__file__).parents[2]

pytestmark = pytest.mark.skipif(not calculix.installed(), reason=calculix.ABSENT)


def run(texts, folder) -> tuple[str, float, float]:
    """Return what a process printed, its processor seconds and its peak memory, MB.

    By way of a small process: Linux counts in a child's peak what its parent held when it forked.
    """
    done = subprocess.run(
        [sys.executable, "-S", "-c", LAUNCH, *map(str, texts)],
        cwd=folder,
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, **THREADS, "PYTHONPATH": str(ROOT)},
    )
    text, _, last = done.stdout.rstrip().rpartition("\n")
    status, seconds, megabytes = map(float, last.split())
    assert status == 0, text[-2000:] + done.stderr[-2000:]
    return text, seconds, megabytes


def in_calculix(part, folder) -> tuple[float, float]:
    deck = deck_of(part)
    for placeholder, load in zip(PLACEHOLDERS, WRENCH, strict=True):
        deck = deck.replace(placeholder, f"{load:.12e}")
    (folder / "job.inp").write_text(deck, encoding="utf-8")
    _, seconds, megabytes = run([calculix.PROGRAM, "job"], folder)
    return seconds, megabytes


def written_matrix(part, folder) -> Path:
    """Write the upper triangle of the free unknowns' matrix, in the mesh's own order."""
    body = Solver(part)._system.body
    number = np.full(body.size, -1)
    number[body.free] = np.arange(body.free.sum())
    size = 3 * int(body.free.sum())
    total = sparse.csr_matrix((size, size))
    for nodes, matrices in zip(body.cells, body.tangent(None).matrices, strict=True):
        rows = np.moveaxis(unknowns_of(number[nodes]), 2, 1).reshape(len(nodes), -1)
        i, j = np.broadcast_arrays(rows[:, :, None], rows[:, None, :])
        kept = (i >= 0) & (j >= i)
        entries = (matrices[kept], (i[kept], j[kept]))
        total += sparse.coo_matrix(entries, shape=(size, size)).tocsr()
    path = folder / "matrix.npz"
    sparse.save_npz(path, total)
    return path


def medians(rows: list[dict[str, float]]) -> dict[str, float]:
    return {key: median(row[key] for row in rows) for key in rows[0]}


@pytest.mark.parametrize("name", NAMES)
def test_the_factor_and_its_memory_beside_pardiso_and_calculix(name: str, tmp_path: Path) -> None:
    part = part_of(name, tmp_path)
    matrix = written_matrix(part, tmp_path) if PARDISO else None
    own, ccx, pardiso = [], [], []
    for _ in range(ROUNDS):
        timed, _, _ = run([sys.executable, PROGRAM, "own", name, tmp_path], tmp_path)
        text, _, megabytes = run([sys.executable, PROGRAM, "solve", name, tmp_path], tmp_path)
        own.append(json.loads(timed) | json.loads(text) | {"megabytes": megabytes})
        ccx.append(in_calculix(part, tmp_path))
        if PARDISO:
            pardiso.append(json.loads(run([PARDISO, PROGRAM, "pardiso", matrix], tmp_path)[0]))
    ours, (seconds, megabytes) = medians(own), (median(column) for column in zip(*ccx, strict=True))
    both, best = ours["order"] + ours["factor"], seconds
    line = (
        f"\n{name:<7} {ours['unknowns']:>6.0f} unknowns: order {ours['order']:.2f} s, factor "
        f"{ours['factor']:.2f} s, cell matrices {ours['cells']:.2f} s; ccx, whole "
        f"run {seconds:.2f} s; memory {ours['megabytes']:.0f} MB"
        f" ({ours['imported']:.0f} of it Python's), ccx {megabytes:.0f} MB (ratio "
        f"{ours['megabytes'] / megabytes:.2f})"
    )
    if pardiso:
        theirs = medians(pardiso)
        peer = theirs["order"] + theirs["factor"]
        best = min(best, peer)
        line += (
            f"; PARDISO order {theirs['order']:.2f} s, factor {theirs['factor']:.2f} s (ratio "
            f"{both / peer:.2f})"
        )
    print(line)
    assert both <= 1.5 * best
    # Python and its libraries take some 85 MB before anything is read.
    assert ours["megabytes"] - ours["imported"] <= 1.5 * megabytes
