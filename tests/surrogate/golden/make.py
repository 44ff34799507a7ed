"""Write the golden answers, a file for each kind of table: `python -m tests.surrogate.golden.make`.

A file has the packed table, wrenches, every field of the replies, and the commit whose kernel gave
them. Make them anew only where answers are meant to change, and say in the commit why they do.
"""

import json
import subprocess
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from tests.service.live import FULL, full_wrenches, moved
from tests.surrogate.energies import PARTS, part
from tests.surrogate.kernel import kinds
from tests.surrogate.responses import HIGH
from tests.surrogate.softening import SOFT, column
from wrenchbook.surrogate.answer import METHODS, UnknownMethodError
from wrenchbook.surrogate.build import Table, build
from wrenchbook.surrogate.kernel.binding import PackedTable
from wrenchbook.surrogate.kernel.explain import explain
from wrenchbook.surrogate.packed.writer import packed_of
from wrenchbook.surrogate.scene.cut import cut
from wrenchbook.surrogate.scene.plan import need_of
from wrenchbook.surrogate.solver_error import SolverError
from wrenchbook.surrogate.table.rows import LoadRange, Rows, Tolerance

FOLDER = Path(__file__).parent
QUERIES, SLOPES, DETAILS = 300, 40, 20
LIMIT = Tolerance(1e-4, 1e-3)
MESH = SolverError(
    {"mesh": np.full((6, 6), 1e-9).tolist(), "linearity": [1e-7] * 6, "loads": FULL.tolist()}
)
NUMBERS = ("outputs", "error", "interpolation", "discretisation", "linearity", "measurement")
WORDS = ("coverage", "reason", "within_tolerance", "method", "row", "exact", "source", "missing")


def several(clean: int, full: int) -> np.ndarray:
    """Wrenches of one axis each, so many an axis, and so many of all."""
    return np.concatenate((kinds.clean(clean), full_wrenches(full)))


def partial() -> Table:
    """Rows of which none tells r_y, and some u_z."""
    reported = moved(several(2, 14))
    reported[:, 4], reported[::3, 2] = np.nan, np.nan
    return build(Rows.of(several(2, 14), reported), kinds.RANGE)


def rig_error() -> Table:
    """Readings of two rigs 3 % apart, which may be off by some micrometres."""
    wrenches = several(2, 12)
    reported = moved(wrenches) * np.where(np.arange(len(wrenches)) % 2, 1.03, 1.0)[:, None]
    table = build(Rows.of(wrenches, reported, source=["rig", "other rig"] * 9), kinds.RANGE)
    return replace(table, rig_error=1e-6 * np.arange(1.0, 7.0))


def locked() -> Table:
    """Rows of a guide that carries f_y and m_z."""
    wrenches = full_wrenches(16) * [1, 0, 1, 1, 1, 0]
    return build(Rows.of(wrenches, moved(wrenches)), kinds.RANGE, locked=(1, 5))


def bent() -> Table:
    """Solves of which some bring second derivatives."""
    rows = part(PARTS["stiffening"], 1).rows(np.random.default_rng(2).uniform(-1, 1, (4, 6)))
    rows.curvature[2:] = np.nan
    return build(rows, LoadRange(-1.1 * HIGH, 1.1 * HIGH))


def softening() -> Table:
    """A column whose mesh lacks the more the nearer it is to buckling."""
    rows, span = column(np.linspace(0.0, 0.85, 6)), LoadRange(-np.ones(6), np.ones(6))
    return build(rows, span, solver_error=SolverError(SOFT))


def scene() -> PackedTable:
    """A table cut to four loads of a scene."""
    span = np.array([0.5, 0.5, 1, 0, 0.7, 0]) * FULL
    whole = packed_of(kinds.measured(several(3, 14)))
    return PackedTable.from_bytes(
        b"".join(cut(whole, need_of(kinds.RANGE, np.column_stack((-span, span)), [0, 2, 4])))
    )


TABLES = {
    "solved": lambda: kinds.solved("plate_thin", 0, 6, tolerance=LIMIT, solver_error=MESH),
    "locked": locked,
    "uncertain": lambda: kinds.measured(full_wrenches(16), uncertainty=np.full((16, 6), 1e-6)),
    "second_derivatives": bent,
    "partial": partial,
    "rig_error": rig_error,
    "planar": lambda: kinds.measured(full_wrenches(14) * [0, 0, 1, 1, 0, 0]),
    "clean_and_beyond": lambda: kinds.measured(
        np.concatenate((kinds.clean(5), 3 * full_wrenches(3)))
    ),
    "few": lambda: kinds.measured(kinds.clean(1)),
    "linear": lambda: kinds.linear(6),
    "linear_unknown": lambda: kinds.linear(4),
    "softening": softening,
    "scene": scene,
}


def packed(kind: str) -> PackedTable:
    """The packed table of a kind, built now."""
    created = TABLES[kind]()
    return created if isinstance(created, PackedTable) else packed_of(created)


def asked_of(table: PackedTable) -> np.ndarray:
    """Wrenches about the load range, of few loads, far beyond it, of rows and beside them."""
    random, (low, high) = np.random.default_rng(7), table.arrays["space/range"]
    rows = np.resize(table.arrays["g0/row/wrench"], (30, 6))
    x = random.uniform(-1.1, 1.1, (QUERIES, 6))
    x[:80] *= 0.6
    x[::2, ~rows.any(axis=0)] = 0.0
    x[100:200] *= random.random((100, 6)) < 0.4
    x[200:240] *= 4.0
    asked = (low + high) / 2 + np.round(x, 3) * (high - low) / 2
    asked[240:270], asked[270:] = rows, rows + 5e-7 * np.round(x[270:], 3) * (high - low)
    asked[0] = 0.0
    return asked[random.permutation(QUERIES)]


def options(table: PackedTable) -> Iterator[tuple[list[float] | None, str | None]]:
    """The tolerance and the method of each query, without end."""
    methods: list[str | None] = [None]
    for method in METHODS:
        try:
            table.answer([0.0] * 6, None, method)
        except UnknownMethodError:
            continue
        methods.append(method)
    allowed, number = table.arrays["g0/allowed"], 0
    while True:
        factor = (None, 10.0, 0.1)[number % 3]
        limit = None if factor is None else (factor * allowed).tolist()
        yield limit, methods[number // 3 % len(methods)]
        number += 1


def told_by(table: PackedTable, asked: np.ndarray) -> dict[str, Any]:
    """What a table replies: numbers (k, 36), words, du/dw of the first, axes of the first."""
    queries = list(zip(asked.tolist(), options(table), strict=False))
    replies = [table.answer(wrench, *how) for wrench, how in queries]
    none = (None,) * 6
    numbers = [[getattr(reply, name) or none for name in NUMBERS] for reply in replies]
    slopes = [table.derivative(wrench, *how) for wrench, how in queries[:SLOPES]]
    axes = [explain(table, wrench, *how) for wrench, how in queries[:DETAILS]]
    return {
        "numbers": np.array(numbers, dtype=float),
        "slopes": np.array(slopes),
        "words": [[getattr(reply, name) for name in WORDS] for reply in replies],
        "axes": [] if "scene" in table.meta else axes,
    }


def main() -> None:
    """Write all files."""
    command = ["git", "rev-parse", "HEAD"]
    commit = subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()
    for kind in TABLES:
        table = packed(kind)
        asked = asked_of(table)
        reported = told_by(table, asked)
        for name in ("words", "axes"):
            reported[name] = np.frombuffer(json.dumps(reported[name]).encode(), dtype=np.uint8)
        content = np.frombuffer(table.content, dtype=np.uint8)
        np.savez_compressed(
            FOLDER / f"{kind}.npz", commit=commit, table=content, asked=asked, **reported
        )


if __name__ == "__main__":
    main()
