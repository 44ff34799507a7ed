"""Print how the error bars are calibrated, per response, size and method; asserted in the tests."""

from __future__ import annotations

import numpy as np

from surrogate.build import build
from tests.surrogate.calibrating import Calibration, calibration, noisy, shipped, with_slopes
from tests.surrogate.responses import (
    HIGH,
    RANGE,
    clean_wrenches,
    full_wrenches,
    kinked,
    smooth,
    table,
)

METHODS = ("griddata", "tangent", "rbf", "corrected", "auto")
SIZES = (56, 200, 600)


def line(name: str, size: str, method: str, found: Calibration) -> None:
    """Print the worst and the median output."""
    inside, ratio = found.inside * 100, found.ratio
    print(
        f"{name:<16}{size:>10}{method:>11}{inside.min():>9.1f}{np.median(inside):>8.1f}"
        f"{ratio.max():>9.2f}{np.median(ratio):>8.2f}{100 * np.median(found.rms):>9.3f}"
    )


def heading() -> None:
    print(
        f"\n{'response':<16}{'rows':>10}{'method':>11}{'inside %':>9}{'median':>8}"
        f"{'ratio':>9}{'median':>8}{'RMS %':>9}"
    )


def test_synthetic_responses() -> None:
    heading()
    asked = full_wrenches(2000, 99)
    for size in SIZES:
        scaled = clean_wrenches(size, 1)
        tables = {
            "smooth": (table(smooth, scaled), smooth),
            "smooth, slopes": (with_slopes(smooth, scaled), smooth),
            "kinked": (table(kinked, scaled), kinked),
            "kinked, slopes": (with_slopes(kinked, scaled), kinked),
            "noisy": (noisy(size, 1), smooth),
        }
        for name, (rows, response) in tables.items():
            surrogate = build(rows, RANGE)
            for method in ("griddata", "tangent", "rbf", "auto"):
                found = calibration(surrogate, asked * HIGH, response(asked), method)
                line(name, f"3x{size}", method, found)


def test_shipped_components() -> None:
    heading()
    for name in ("plate_thin", "plate", "spring", "bar"):
        for full in (20, 40, 80) if name == "plate_thin" else (20,):
            component = shipped(name, full)
            surrogate = build(component.rows, component.load_range)
            for method in METHODS:
                found = calibration(surrogate, component.asked, component.true, method)
                line(name, f"{len(component.rows) - full}+{full}", method, found)
