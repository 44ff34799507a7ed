"""Run times of the kernel, processor time on one core, beside scipy's own calls in one run."""

from __future__ import annotations

import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import LinearNDInterpolator

from tests.service.fmu.made import solved, wrenches_of
from tests.surrogate.energies import PARTS, part
from tests.surrogate.law import build
from tests.surrogate.responses import HIGH, RANGE, clean_wrenches, full_wrenches, smooth, table
from wrenchbook.surrogate.build import Group, Table
from wrenchbook.surrogate.kernel.binding import PackedTable
from wrenchbook.surrogate.kernel.build import compiler_command, ready_library
from wrenchbook.surrogate.packed.writer import pack
from wrenchbook.surrogate.table.rows import LoadRange

DRIVER = Path(__file__).parent / "kernel_rate.c"
SINGLE = 20_000


def spent(call: Callable[[], object], repeats: int = 5) -> float:
    """Return the least processor time of one call, s: other programs do not count."""
    best = float("inf")
    for _ in range(repeats):
        start = time.process_time()
        call()
        best = min(best, time.process_time() - start)
    return best


def rates(surrogate: Table, wrenches: np.ndarray, folder: Path) -> tuple[float, ...]:
    """Return us of a single answer and of one of a batch in C, then of both from Python."""
    content = b"".join(pack(surrogate))
    (folder / "table.wbt").write_bytes(content)
    wrenches.astype("<f8").tofile(folder / "wrenches.bin")
    library, program = ready_library(), folder / "rate"
    include = ["-O2", f"-I{library.parent}", "-o", str(program), str(DRIVER), str(library)]
    subprocess.run([*compiler_command(), *include, f"-Wl,-rpath,{library.parent}"], check=True)
    command = [program, folder / "table.wbt", folder / "wrenches.bin"]
    ran = subprocess.run(command, check=True, capture_output=True, text=True)
    packed, asked = PackedTable.from_bytes(content), wrenches[:SINGLE].tolist()
    single = spent(lambda: [packed.answer(wrench) for wrench in asked]) / SINGLE
    batch = spent(lambda: packed.batch(wrenches)) / len(wrenches)
    return (*map(float, ran.stdout.split()), 1e6 * single, 1e6 * batch)


def test_a_kriging_of_40_solves_answers_in_microseconds(tmp_path: Path) -> None:
    surrogate = solved("plate_thin", 20, 20)
    assert surrogate.groups[0].default == "kriging"
    single, batch, python, _ = rates(surrogate, wrenches_of(surrogate, 100_000, 0.95), tmp_path)
    print(
        f"\nkriging of 40 solves: in C {single:.2f} us (at most 4), from Python {python:.2f} us "
        f"(at most 9), in a batch {batch:.2f} us (at most 2.5)"
    )
    assert single <= 4
    assert python <= 9
    assert batch <= 2.5


def test_second_derivatives_of_60_solves_cost_microseconds(tmp_path: Path) -> None:
    own, at = part(PARTS["stiffening"], 1), full_wrenches(60, 3)
    created = [
        build(own.rows(at, second=second), LoadRange(-1.1 * HIGH, 1.1 * HIGH))
        for second in (True, False)
    ]
    assert [item.default for item in created] == ["kriging", "kriging"]
    asked = full_wrenches(100_000, 4) * HIGH
    (single, batch, python, _), plain = (rates(item, asked, tmp_path) for item in created)
    print(
        f"\n60 solves with second derivatives: in C {single:.2f} us (at most 8), in a batch "
        f"{batch:.2f} us, from Python {python:.2f} us; without {plain[0]:.2f}, {plain[1]:.2f} and "
        f"{plain[2]:.2f} us"
    )
    assert single <= 8


@pytest.mark.timeout(600)
@pytest.mark.parametrize(
    ("rows", "span", "least"), [(1000, 0.95, 1), (10_000, 0.95, 4), (10_000, 0.4, 2)]
)
def test_griddata_is_faster_than_three_bare_calls(
    rows: int, span: float, least: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Group, "kriging", None)  # which answers such rows in milliseconds
    surrogate = build(table(smooth, clean_wrenches(rows, 1)), RANGE)
    scaled = full_wrenches(100_000, 3) * span
    single, batch, python, many = rates(surrogate, scaled * HIGH, tmp_path)
    bare = [
        (LinearNDInterpolator(item.triangulation.points, item.values), scaled[:, item.axis.inputs])
        for item in surrogate.axes.tables
        if item is not None
    ]
    theirs = 1e6 * spent(lambda: [call(places) for call, places in bare], 3) / len(scaled)
    print(
        f"\n{rows:,} rows an axis at {span} of the range: in C {single:.2f} us, from Python "
        f"{python:.2f} us, in a batch {batch:.2f} us; a batch from Python {many:.2f} us, three "
        f"bare calls {theirs:.2f} us: {theirs / many:.1f} x (at least {least})"
    )
    if rows == 1000:
        assert single <= 3
        assert python <= 8
    assert theirs >= least * many
