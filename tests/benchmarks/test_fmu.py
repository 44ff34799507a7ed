"""Evaluations a second of an FMU from C, in processor time, and from Python: FMPy and the table."""

import subprocess
import time
from pathlib import Path

import numpy as np
import pytest

from tests.service.fmu.made import answers, need_compiler, opened, packed, solved, wrenches_of

DRIVER = Path(__file__).parents[1] / "service" / "fmu" / "rate.c"
TARGET = 100_000  # a second


@pytest.mark.parametrize("method", ["kriging", "griddata"])
@pytest.mark.parametrize("name", ["plate", "plate_thin"])
def test_an_fmu_makes_a_hundred_thousand_evaluations_a_second(tmp_path, name, method):
    table = solved(name, 18, 20)
    fmu = opened(table, tmp_path, method)
    program, wrenches = tmp_path / "rate", tmp_path / "wrenches.bin"
    wrenches_of(table, 10_000).astype("<f8").tofile(wrenches)
    headers = f"-I{fmu.folder / 'sources'}"
    command = [*need_compiler(), "-O2", headers, "-o", str(program), str(DRIVER), "-ldl"]
    subprocess.run(command, check=True, timeout=60)
    resources = (fmu.folder / "resources").as_uri()
    words = [str(program), str(fmu.library), resources, fmu.guid, str(wrenches), "1"]
    rates = []
    for _ in range(3):
        reported = subprocess.run(
            words, check=True, capture_output=True, text=True, timeout=60
        ).stdout
        count, seconds, _ = map(float, reported.split())
        rates.append(count / seconds)
    print(f"\n{name}, {len(table.rows)} rows, {method}: {max(rates):,.0f} evaluations a second")
    assert max(rates) > TARGET


def test_the_same_table_by_fmpy_and_in_process(tmp_path):
    table = solved("plate_thin", 18, 20)
    wrenches, here, seconds = wrenches_of(table, 5_000), packed(table), []
    with opened(table, tmp_path).running() as fmu:
        for _ in range(5):
            started = time.process_time()
            by_fmpy = answers(fmu, wrenches)
            between = time.process_time()
            by_table = [here.answer(wrench).outputs for wrench in wrenches.tolist()]
            seconds.append((between - started, time.process_time() - between))
    fmpy, own = 1e6 * np.min(seconds, axis=0) / len(wrenches)
    print(f"\nby FMPy {fmpy:.1f} us, by Table.answer's kernel {own:.1f} us: {fmpy / own:.1f} times")
    assert (by_fmpy[0] == np.array(by_table)).all()
