"""Evaluations a second of an FMU, measured from C through its FMI functions, in processor time."""

import subprocess
from pathlib import Path

import pytest

from tests.service.fmu.made import need_compiler, opened, solved, wrenches_of

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
        told = subprocess.run(words, check=True, capture_output=True, text=True, timeout=60).stdout
        count, seconds, _ = map(float, told.split())
        rates.append(count / seconds)
    print(f"\n{name}, {len(table.rows)} rows, {method}: {max(rates):,.0f} evaluations a second")
    assert max(rates) > TARGET
