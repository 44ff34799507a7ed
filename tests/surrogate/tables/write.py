"""Write the tables of the shipped components that the surrogate's tests read, by real solves.

    python -m tests.surrogate.tables.write [NAME ...]

Clean rows of each axis (the corners of its load range, then random points), and full wrenches, the
first of which may be rows of a table while the rest are only asked about. Some minutes a component.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from wrenchbook.fea.bundle.read import read_bundle
from wrenchbook.fea.solution import Solution
from wrenchbook.fea.solve import Solver

HERE = Path(__file__).parent
COMPONENTS = HERE.parents[2] / "data" / "components"
INPUTS = ((0, 4, 5), (1, 5, 3), (2, 3, 4))

# Clean rows, full wrenches, and how many of those keep their compliance to serve as rows.
COUNTS = {
    "plate_thin": (168, 300, 80),
    "plate": (168, 120, 40),
    "spring": (90, 120, 40),
    "bar": (24, 60, 20),
}


def clean_wrenches(low: np.ndarray, high: np.ndarray, count: int) -> list[np.ndarray]:
    """Return wrenches of one axis' loads each, the axes in turn."""
    rng = np.random.default_rng(13)
    wrenches = []
    for place in range(count):
        x, axis, corner = rng.uniform(-1, 1, 6), list(INPUTS[place % 3]), place // 3
        if corner < 8:
            x[axis] = [1 if corner >> bit & 1 else -1 for bit in range(3)]
        loads = (low + high) / 2 + x * (high - low) / 2
        wrenches.append(np.where(np.isin(np.arange(6), axis), loads, 0.0))
    return wrenches


def full_wrenches(low: np.ndarray, high: np.ndarray, count: int) -> list[np.ndarray]:
    """Return wrenches of all six loads, drawn one after another."""
    rng = np.random.default_rng(11)
    return [(low + high) / 2 + rng.uniform(-1, 1, 6) * (high - low) / 2 for _ in range(count)]


def write(name: str) -> None:
    """Solve one component's wrenches and write them."""
    bundle = read_bundle(COMPONENTS / name)
    solver = Solver(bundle)
    low, high = np.array(bundle.range.low), np.array(bundle.range.high)
    clean, full, kept = COUNTS[name]
    wrenches = clean_wrenches(low, high, clean) + full_wrenches(low, high, full)
    save(name, low, high, [solver.solve(wrench) for wrench in wrenches], clean + kept)


def save(name: str, low: np.ndarray, high: np.ndarray, results: list[Solution], kept: int) -> None:
    """Write what was found; compliances, of the kept ones."""
    np.savez_compressed(
        HERE / f"{name}.npz",
        low=low,
        high=high,
        wrench=[result.wrench for result in results],
        displacement=[result.displacement for result in results],
        compliance=[result.compliance for result in results[:kept]],
        clean=COUNTS[name][0],
    )


if __name__ == "__main__":
    for component in sys.argv[1:] or COUNTS:
        write(component)
