"""A steel column, 10 x 10 mm and 1 m long: its table by real solves, and the closed form of it.

    python -m tests.column

writes `column.npz`: 64 nonlinear solves, half of them in the plane of bending, in a minute or two.
"""

from __future__ import annotations

import tempfile
from functools import cache
from pathlib import Path

import numpy as np
from scipy.stats import qmc

from wrenchbook.fea.bundle.read import read_bundle
from wrenchbook.fea.solve import Solver
from wrenchbook.service.client import Table
from wrenchbook.surrogate.build import build
from wrenchbook.surrogate.kernel.binding import PackedTable
from wrenchbook.surrogate.packed.writer import pack
from wrenchbook.surrogate.table.rows import LoadRange, Rows, Tolerance

FILE = Path(__file__).with_name("column.npz")
COLUMN = """
name = "column"
title = "Steel column, 10 x 10 mm, 1 m long, clamped at one end"
[mesh]
generator = "bar"
length = 1.0
width = 0.01
height = 0.01
cells_along = 40
cells_across = 2
[[material]]
region = "all"
youngs_modulus = 210e9
poisson_ratio = 0.3
[supports]
fixed = ["start"]
[interface]
section = "end"
coupling = "distributed"
[analysis]
nonlinear = true
[range]
force = [250, 20, 20]
moment = [10, 20, 20]
[tolerance]
translation = 1e-3
rotation = 1e-3
"""
LENGTH, BENDING = 1.0, 210e9 * 0.01**4 / 12  # m, N·m^2: it buckles at 432 N
TIP = np.array([LENGTH, 0.0, 0.0])
LARGEST = np.array([250.0, 8.0, 8.0, 5.0, 4.0, 4.0])  # of the solves, N and N·m
MESH = 3e-3  # the mesh and 3D elasticity against the beam: 0.17 to 0.28 % in the solves


def deflection(push: float, force: float, moment: float = 0.0) -> float:
    """The tip's deflection along z, m, of a beam-column.

    Timoshenko and Gere, Theory of Elastic Stability, chapter 1: a dead push along -x, N (negative:
    a pull), a dead force along z, N, and an end moment, N·m, that bends towards z.
    """
    k = np.emath.sqrt(push / BENDING) * LENGTH
    tip = force * LENGTH * (np.tan(k) / k - 1.0) + moment * (1.0 / np.cos(k) - 1.0)
    return float(np.real(tip)) / push


def slope(push: float, force: float, moment: float = 0.0) -> float:
    """The slope dw/dx of the same beam-column at its tip, rad."""
    k = np.emath.sqrt(push / BENDING) * LENGTH
    turned = force * (1.0 / np.cos(k) - 1.0) + moment * k / LENGTH * np.tan(k)
    return float(np.real(turned)) / push


@cache
def packed_column() -> PackedTable:
    """The packed table of the stored solves."""
    with np.load(FILE) as file:
        result = dict(file)
    columns = {name: result[name] for name in ("compliance", "curvature")}
    columns["source"] = ["fea"] * len(result["wrench"])
    rows = Rows.of(result["wrench"], result["displacement"], **columns)
    load_range = LoadRange(result["low"], result["high"])
    built = build(rows, load_range, tolerance=Tolerance(1e-3, 1e-3))
    return PackedTable.from_bytes(b"".join(pack(built, component="column")))


def column_table() -> Table:
    """The same as a simulator has it."""
    return Table(packed_column())


def write() -> None:
    """Solve the wrenches and write them."""
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "component.toml").write_text(COLUMN)
        bundle = read_bundle(Path(folder))
    solver = Solver(bundle)
    wrenches = 2.0 * qmc.Sobol(6, rng=1).random(64) - 1.0
    wrenches[32:, [1, 3, 5]] = 0.0
    solved = [solver.solve(wrench) for wrench in wrenches * LARGEST]
    np.savez_compressed(
        FILE,
        low=bundle.range.low,
        high=bundle.range.high,
        wrench=[solution.wrench for solution in solved],
        displacement=[solution.displacement for solution in solved],
        compliance=[solution.compliance for solution in solved],
        curvature=[solution.curvature for solution in solved if solution.curvature is not None],
    )


if __name__ == "__main__":
    write()
