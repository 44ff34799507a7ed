"""Processor time and memory of an import of a million rows of CSV, beside pandas.read_csv.

pandas is no dependency: with PYTHONPATH it may be in a folder of its own.
"""

from __future__ import annotations

import importlib
import os
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest

from tests.benchmarks.test_live import as_csv, made_up
from wrenchbook.service.formats.options import Options
from wrenchbook.service.ledger import ImportOrigin, Ledger
from wrenchbook.service.library.component import Component
from wrenchbook.service.tables.importing import import_files
from wrenchbook.surrogate.table.rows import LoadRange

ROWS = 1_000_000


def load(path: Path, folder: Path) -> None:
    """Import the file into a new ledger, and once more."""
    bound = np.full(6, 1000.0)
    span = LoadRange(-bound, bound)
    rig = Component("rig", "rig", folder, "", False, False, span, None, False)
    ledger = Ledger(folder / "ledger.sqlite")
    for turn in range(1 + int(os.environ.get("AGAIN", "0"))):
        began = time.process_time()
        reply = import_files(ledger, rig, [path], Options(), ImportOrigin())
        print(
            f"  import {turn + 1}: {reply['inserted']:,} new, {reply['existing']:,} known, "
            f"{time.process_time() - began:.1f} s of this process",
            flush=True,
        )
    ledger.close()
    size = (folder / "ledger.sqlite").stat().st_size
    print(f"  ledger {size >> 20} MB", flush=True)


def used(*arguments: str) -> tuple[float, float]:
    """Run this module as a program; return its processor time, s, and largest memory, MB."""
    command = [sys.executable, "-m", "tests.benchmarks.test_import_cpu", *arguments]
    pid = os.posix_spawn(sys.executable, command, os.environ)
    _, status, usage = os.wait4(pid, 0)
    assert status == 0
    return usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024


def test_an_import_takes_a_few_times_the_processor_time_of_pandas(tmp_path):
    pytest.importorskip("pandas")
    path = tmp_path / "rows.csv"
    path.write_text(as_csv(*made_up(ROWS)))
    print()
    used("pandas", "")  # compiles its modules
    idle, _ = used("pandas", "")
    pandas = min(used("pandas", str(path))[0] for _ in range(2)) - idle
    start, _ = used("import", "")
    ours, memory = used("import", str(path))
    ours -= start
    print(
        f"pandas.read_csv {pandas:.2f} s, import {ours:.2f} s = {ours / pandas:.1f} x, largest "
        f"process {memory:.0f} MB"
    )


if __name__ == "__main__":
    if sys.argv[2] and sys.argv[1] == "pandas":
        import pandas

        pandas.read_csv(sys.argv[2])
    elif sys.argv[1] == "pandas":
        importlib.import_module("pandas")
    elif sys.argv[2]:
        with TemporaryDirectory() as directory:
            load(Path(sys.argv[2]), Path(directory))
