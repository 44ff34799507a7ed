"""Print what each method misses on full wrenches of the thin plate, at equal numbers of solves."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import RBFInterpolator

from surrogate.build import build
from surrogate.table.rows import OUTPUTS, Rows
from tests.surrogate.calibrating import Shipped, shipped


def percent(component: Shipped, moved: np.ndarray) -> np.ndarray:
    """Return the RMS error of each output, % of its range."""
    error = np.sqrt(((moved - component.true) ** 2).mean(axis=0))
    return 100 * error / np.ptp(component.true, axis=0)


def full_rbf(component: Shipped, rows: Rows) -> np.ndarray:
    """Answer by one polyharmonic spline in all six loads."""
    scale, size = component.load_range.scale, np.abs(rows.displacement).max(axis=0)
    spline = RBFInterpolator(rows.wrench / scale, rows.displacement / size, kernel="cubic")
    return spline(component.asked / scale) * size


def test_rms_at_equal_numbers_of_solves() -> None:
    component = shipped("plate_thin", 80)
    rows, clean = component.rows, len(component.rows) - 80
    print(f"\n{'solves':>7} {'method':<28}" + "".join(f"{name:>8}" for name in OUTPUTS))
    for solves in (104, 168):
        for full in (0, solves // 4, solves * 2 // 5):
            kept = np.concatenate((np.arange(solves - full), clean + np.arange(full)))
            some = rows.take(kept)
            surrogate = build(some, component.load_range)
            answers = {
                name: surrogate.batch(component.asked, None, method).displacement
                for name, method in (
                    ("straight Delaunay", "griddata"),
                    ("straight Delaunay, tangents", "tangent"),
                    ("straight RBF, tangents", "rbf"),
                    ("corrected", "corrected"),
                )
            }
            bare = some.take(np.arange(len(some)))
            bare.compliance[:] = np.nan
            plain = build(bare, component.load_range)
            for name, method in (("straight RBF", "rbf"), ("corrected, no tangents", "corrected")):
                answers[name] = plain.batch(component.asked, None, method).displacement
            answers["full 6-D RBF"] = full_rbf(component, some)
            for name, moved in answers.items():
                errors = "".join(f"{value:8.3f}" for value in percent(component, moved))
                print(f"{solves - full:>4}+{full:<2} {name:<28}{errors}")
