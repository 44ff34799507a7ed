"""Print what each method misses on full wrenches of the thin plate, at equal numbers of solves.

Beside them SMT's kriging, without and with tangents, and scipy's RBFInterpolator in all six loads.
"""

from __future__ import annotations

import numpy as np
import pytest

from tests.benchmarks.peers import SMT_MISSING, radial, smt_kriging
from tests.surrogate.calibrating import Shipped, shipped
from tests.surrogate.law import build
from wrenchbook.surrogate.answer import METHODS
from wrenchbook.surrogate.table.rows import Rows
from wrenchbook.surrogate.table.space import OUTPUTS


def percent(component: Shipped, moved: np.ndarray) -> np.ndarray:
    """Return the RMS error of each output, % of its range."""
    error = np.sqrt(((moved - component.true) ** 2).mean(axis=0))
    return 100 * error / np.ptp(component.true, axis=0)


def answers(component: Shipped) -> dict[str, np.ndarray]:
    """Return what methods and peers say of a component's asked wrenches, by name."""
    rows, scale, asked = component.rows, component.load_range.scale, component.asked
    surrogate = build(rows, component.load_range)
    told = {method: surrogate.batch(asked, None, method).displacement for method in METHODS}
    bare = Rows.of(rows.wrench, rows.displacement)
    without = build(bare, component.load_range).batch(asked, None, "kriging")
    told["kriging, no tangents"] = without.displacement
    told["scipy RBFInterpolator"] = radial(rows, scale, asked)
    if not SMT_MISSING:
        told["SMT KRG"] = smt_kriging(rows, scale, asked)
        told["SMT GEKPLS"] = smt_kriging(rows, scale, asked, gradients=True)
    return told


@pytest.mark.timeout(1800)
def test_rms_at_equal_numbers_of_solves() -> None:
    print(f"\n{'solves':>7} {'method':<24}" + "".join(f"{name:>8}" for name in OUTPUTS))
    if SMT_MISSING:
        print(SMT_MISSING)
    for clean, full in ((0, 30), (0, 80), (60, 0), (20, 40), (100, 60)):
        component = shipped("plate_thin", full, clean)
        worst = {}
        for name, moved in answers(component).items():
            errors = percent(component, moved)
            worst[name] = errors.max()
            told = "".join(f"{value:8.3f}" for value in errors)
            print(f"{clean:>4}+{full:<2} {name:<24}{told}", flush=True)
        assert worst["kriging"] == min(worst.values())
