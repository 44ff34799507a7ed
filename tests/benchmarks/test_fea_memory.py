"""Peak memory of a solve and of CalculiX's: nonlinear thin plate, linear block of any size.

WRENCHBOOK_BENCH_UNKNOWNS is the block's size, 40,000 unless given: a compact part, whose factor is
large for its unknowns. Each solve is a process of its own with one thread.
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

import pytest

from tests.benchmarks.test_fea_order import PROGRAM, in_calculix, run
from tests.benchmarks.unstructured import part_of
from tests.validation import calculix
from wrenchbook.fea.solve import Solver

UNKNOWNS = int(os.environ.get("WRENCHBOOK_BENCH_UNKNOWNS", "40000"))
BLOCK = f"block{round((UNKNOWNS / 12.7) ** (1 / 3))}"  # 12.7 unknowns a hex20 at 11 cells each way

pytestmark = pytest.mark.skipif(not calculix.installed(), reason=calculix.ABSENT)


@pytest.mark.parametrize("name", ["plate_thin", BLOCK])
def test_a_solve_takes_at_most_1_3_times_calculix_memory_beyond_libraries(
    name: str, tmp_path: Path
) -> None:
    text, _, whole = run([sys.executable, PROGRAM, "solve", name, tmp_path], tmp_path)
    libraries = json.loads(text)["imported"]
    part = part_of(name, tmp_path)
    _, ccx = in_calculix(part, tmp_path)
    print(
        f"\n{name:<10} {Solver(part).unknowns:>7} unknowns: {whole:.0f} MB, {libraries:.0f} of it "
        f"Python and libraries; ccx {ccx:.0f} MB (ratio {whole / ccx:.2f}, without libraries "
        f"{(whole - libraries) / ccx:.2f})"
    )
    assert whole - libraries <= 1.3 * ccx
