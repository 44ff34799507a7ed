"""A small bent plate, its solves, and a store that holds their fields."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np

from wrenchbook.fea.bundle.read import read_bundle
from wrenchbook.fea.recovery.fields import SolveFields
from wrenchbook.fea.solve import Solver
from wrenchbook.service.fields.record import write_files
from wrenchbook.service.fields.store import FieldStore
from wrenchbook.service.library.component import Component, component_of
from wrenchbook.surrogate.table.rows import Rows

BUNDLE = """
name = "{name}"
title = "A coarse thin plate"
[mesh]
generator = "plate"
length = 0.4
width = 0.4
thickness = 0.004
patch = 0.12
corner = 0.04
cells = 4
rings = 2
layers = 1
[[material]]
region = "all"
youngs_modulus = 70e9
poisson_ratio = 0.33
yield_strength = {strength}
[supports]
fixed = ["corners"]
[interface]
section = "patch"
point = [0, 0, 0.004]
coupling = "distributed"
[analysis]
nonlinear = {nonlinear}
[range]
force = [1000, 1000, 2000]
moment = [100, 100, 100]
"""


def write_bundle(
    folder: Path, name: str = "sheet", *, nonlinear: bool = True, strength: float = 60e6
) -> Path:
    """Write the plate's bundle into a folder of its name."""
    place = folder / name
    place.mkdir(parents=True)
    text = BUNDLE.format(name=name, strength=strength, nonlinear=str(nonlinear).lower())
    (place / "component.toml").write_text(text, "utf-8")
    return place


@cache
def solver(folder: Path) -> Solver:
    return Solver(read_bundle(folder))


def sheet(folder: Path) -> Component:
    """The component of a bundle's folder."""
    return component_of(read_bundle(folder), shipped=False)


def wrenches(component: Component, count: int, seed: int = 1) -> np.ndarray:
    """Wrenches of all six loads within the range, (count, 6), N and N·m."""
    loads = component.load_range
    return np.random.default_rng(seed).uniform(loads.low, loads.high, (count, 6))


def solved(folder: Path, asked: np.ndarray) -> tuple[list[SolveFields], Rows]:
    """Solve wrenches: their fields, and the rows of a table."""
    own = solver(folder)
    solutions = [own.solve(wrench) for wrench in asked]
    rows = Rows.of(
        asked,
        [solution.displacement for solution in solutions],
        compliance=np.array([solution.compliance for solution in solutions]),
        source=["fea"] * len(asked),
        fingerprint=[read_bundle(folder).fingerprint] * len(asked),
    )
    return [own.fields(solution) for solution in solutions], rows


def keep(store: FieldStore, component: Component, wrench: np.ndarray, fields: SolveFields) -> None:
    """Keep the fields of a solve, by way of an attempt's folder."""
    attempt = component.folder.parent / "attempt"
    attempt.mkdir(exist_ok=True)
    numbers = tuple(wrench.tolist())
    write_files(attempt, numbers, fields)
    assert store.take(attempt, component.name, component.fingerprint, numbers)
