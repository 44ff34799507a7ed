"""What a planar scene saves: solves, build time, memory and time an answer, beside the whole.

The whole table is `plate_thin`'s, of real solves at wrenches of all six loads; the scene has F_x,
F_z and M_y alone, over their whole range. The scene's table is cut from the whole one, as
`Client.download(name, scene=)` does. It keeps a kriging's neighbourhoods, which are nearly all of
its bytes. How many solves bring the bars of a fill down is counted on a made-up response, in place
of the finite elements.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from statistics import median

import numpy as np
import pytest

from tests.surrogate.calibrating import shipped
from tests.surrogate.kriging.responses import RESPONSES, solved
from tests.surrogate.responses import HIGH, RANGE
from wrenchbook.surrogate.build import Table, build
from wrenchbook.surrogate.kernel.binding import PackedTable
from wrenchbook.surrogate.packed.writer import pack
from wrenchbook.surrogate.scene.cut import cut
from wrenchbook.surrogate.scene.plan import Need, design_of, need_of, plan_of
from wrenchbook.surrogate.table.rows import LoadRange, Rows, Tolerance

PLANAR, ALL = np.isin(np.arange(6), (0, 2, 4)), np.ones(6, dtype=bool)
ROWS, ASKED, RUNS, ROUND = 60, 2000, 3, 16
CUT = 0.05  # of the time of a build: cutting takes 0.005, reading 0.004
GOAL = Tolerance(1e-5, 1e-5)  # bars of some 1 % of the response's range
MOST = 256  # solves spent on that at most


def need(whole: LoadRange, chosen: np.ndarray) -> Need:
    ends = np.column_stack((whole.low, whole.high)) * chosen[:, None]
    return need_of(whole, ends, tolerance=GOAL)


def filled(wanted: Need) -> tuple[int, int]:
    """Fill an empty table until the bars are met; return first solves, and all."""
    rows, first = Rows.empty(), 0
    while len(rows) < MOST:
        table = build(rows, RANGE)
        plan = plan_of(table, wanted)
        design = design_of(table, plan, min(ROUND, MOST - len(rows)))
        if not len(design.wrenches):
            break
        more = solved(RESPONSES["hardening"], design.wrenches / HIGH)
        rows = Rows.of(
            np.concatenate((rows.wrench, more.wrench)),
            np.concatenate((rows.displacement, more.displacement)),
            compliance=np.concatenate((rows.compliance, more.compliance)),
            source=["fea"] * (len(rows) + len(more)),
        )
        first = len(rows) if design.stage == "first" else first
    return first, len(rows)


def seconds(make: Callable[[], object]) -> float:
    """Return the processor time of the fastest run."""
    times = []
    for _ in range(RUNS):
        started = time.process_time()
        make()
        times.append(time.process_time() - started)
    return min(times)


def us(table: PackedTable, wrenches: np.ndarray) -> float:
    asked = [tuple(wrench) for wrench in wrenches[:200].tolist()]
    return 1e6 * seconds(lambda: [table.answer(wrench) for wrench in asked]) / len(asked)


def packed_of(table: Table) -> PackedTable:
    return PackedTable.from_bytes(b"".join(pack(table)))


def assert_same_bits(whole: PackedTable, part: PackedTable, wrenches: np.ndarray) -> None:
    full, cut_down = whole.batch(wrenches), part.batch(wrenches)
    for name in ("outputs", "errors", "coverage"):
        np.testing.assert_array_equal(getattr(full, name), getattr(cut_down, name))


@pytest.mark.timeout(1800)
def test_what_a_planar_scene_saves() -> None:
    component = shipped("plate_thin", ROWS, 0)
    rows, load_range = component.rows, component.load_range
    scene = need(load_range, PLANAR)
    planned = plan_of(build(Rows.empty(), load_range), scene).solves
    (whole_first, whole_to_goal), (scene_first, to_goal) = (
        filled(need(RANGE, chosen)) for chosen in (ALL, PLANAR)
    )

    whole = build(rows, load_range, tolerance=GOAL)  # the scene's, so that coverage is the same
    whole_s = seconds(lambda: build(rows, load_range, tolerance=GOAL))
    packed = packed_of(whole)
    cut_s = seconds(lambda: cut(packed, scene))
    content = b"".join(cut(packed, scene))
    read_s = seconds(lambda: PackedTable.from_bytes(content))
    own_table = PackedTable.from_bytes(content)
    asked = np.random.default_rng(1).uniform(scene.span.low, scene.span.high, (ASKED, 6))
    assert_same_bits(packed, own_table, asked)

    times = [(us(packed, asked), us(own_table, asked)) for _ in range(3)]
    answers = median(w for w, _ in times), median(c for _, c in times)

    print(f"\nplate_thin, {len(rows)} solves; the scene: fx, fz, my over their whole range")
    print(f"{'':<34}{'whole':>10}{'scene':>10}{'ratio':>8}")
    for name, pair in (
        ("first solves, planned", planned),
        ("made-up, slopes alone: first", (whole_first, scene_first)),
        (f"made-up: solves to 1 % (<= {MOST})", (whole_to_goal, to_goal)),
        ("build: cutting it, s", (whole_s, cut_s)),
        ("build: reading its file, s", (whole_s, read_s)),
        ("size, MB", (packed.size / 1e6, own_table.size / 1e6)),
        ("one answer, µs", answers),
    ):
        print(f"{name:<34}{pair[0]:>10.4g}{pair[1]:>10.4g}{pair[1] / pair[0]:>8.2f}")
    print("outputs, error bars and coverage of both tables' scenes: the same bits")
    assert planned[1] < planned[0]
    assert scene_first < whole_first
    assert max(to_goal, whole_to_goal) < MOST
    assert max(cut_s, read_s) <= CUT * whole_s
    assert own_table.size <= packed.size
