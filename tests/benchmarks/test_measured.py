"""Print how error bars of measured tables hold: noise, hysteresis and lags, fresh seeds each run.

CALIBRATION_SEED repeats a run's, CALIBRATION_SEEDS is how many seeds there are (3). Errors are of
the mean: of answers to wrenches that are not in the table against the response without noise, and
of both branches of a loop.
"""

from __future__ import annotations

import os
import secrets
from collections.abc import Callable

import numpy as np
import pytest

from tests.surrogate.findings.rigs import Rig
from tests.surrogate.kriging.responses import RESPONSES
from tests.surrogate.responses import RANGE
from wrenchbook.surrogate.build import build
from wrenchbook.surrogate.findings.find import find
from wrenchbook.surrogate.packed.writer import packed_of
from wrenchbook.surrogate.table.rows import LoadRange, Rows

SEED = int(os.environ.get("CALIBRATION_SEED", secrets.randbelow(10**6)))
SEEDS = range(SEED, SEED + int(os.environ.get("CALIBRATION_SEEDS", "3")))
KINDS = ("linear or stiffening", "smooth", "hardening", "clearance", "kinked", "kink_across")


def part(seed: int, kind: str) -> tuple[Callable[[np.ndarray], np.ndarray], LoadRange]:
    """Return the response of scaled loads (n, 6) and the load range."""
    if kind != KINDS[0]:
        return RESPONSES[kind], RANGE
    rig = Rig(seed)
    return lambda loads: rig.respond(loads * rig.high), rig.range


def judged(table: object, wrenches: np.ndarray, *true: np.ndarray) -> list[float]:
    """Return the covered part, its errors outside, and the median bar over the median error."""
    found = packed_of(table).batch(wrenches)  # pyright: ignore[reportArgumentType]
    errors = [np.abs(found.outputs - one) for one in true]
    covered, known = found.coverage == 0, np.isfinite(found.errors).all(axis=1)
    outside = [(one > found.errors)[covered].mean() for one in errors if covered.any()]
    bars = np.median(found.errors[known], axis=0)
    ratio = np.median(bars / np.median(errors[0][known], axis=0)) if known.any() else np.nan
    mean = float(np.mean(outside)) if outside else np.nan
    return [float(covered.mean()), mean, float(ratio)]


def means(found: list[list[float]]) -> list[float]:
    """Return the mean of each column's known numbers; NaN where there is none."""
    return [
        float(np.mean(known)) if (known := [one for one in column if one == one]) else np.nan
        for column in zip(*found, strict=True)
    ]


@pytest.mark.timeout(3600)
def test_noise() -> None:
    print(f"\nseeds {SEEDS}\n{'response':<22}{'rows':>5}{'noise %':>9}{'covered %':>11}", end="")
    print(f"{'outside %':>11}{'bar / error':>13}")
    for kind in KINDS:
        for count in (200, 500, 1000):
            for noise in (0.001, 0.003, 0.01):
                found = []
                for seed in SEEDS:
                    rng = np.random.default_rng([seed, count, int(1e4 * noise)])
                    respond, span = part(seed, kind)
                    loads, asked = rng.uniform(-1, 1, (count, 6)), rng.uniform(-1, 1, (500, 6))
                    moved = respond(loads)
                    moved += noise * np.ptp(moved, axis=0) * rng.normal(size=moved.shape)
                    rows = Rows.of(loads * span.high, moved, source=["rig"] * count)
                    found.append(judged(build(rows, span), asked * span.high, respond(asked)))
                covered, outside, ratio = means(found)
                print(f"{kind:<22}{count:>5}{100 * noise:>9.1f}{100 * covered:>11.0f}", end="")
                print(f"{100 * outside:>11.1f}{ratio:>13.1f}", flush=True)


@pytest.mark.timeout(3600)
def test_hysteresis() -> None:
    print(f"\nseeds {SEEDS}\n{'loads':<10}{'loop %':>7}{'noise %':>9}{'covered %':>11}", end="")
    print(f"{'outside %':>11}{'named':>8}")
    for kind in ("sweeps", "motion"):
        for width in (0.0, 0.02, 0.08):
            for noise in (0.001, 0.003, 0.01):
                found, named = [], 0
                for seed in SEEDS:
                    rig = Rig(seed, (kind,))
                    rig.noise = noise
                    cause = f"hysteresis of {100 * width:.0f} %" if width else None
                    rows = rig.measured(cause)
                    named += any(one.cause == "hysteresis" for one in find(rows, rig.range))
                    asked = rig.wrench[:: max(len(rig.wrench) // 150, 1)] * 0.98
                    middle, half = rig.respond(asked), width / 2 * rig.size
                    branches = middle - half, middle + half
                    found.append(judged(build(rows, rig.range), asked, *branches)[:2])
                covered, outside = means(found)
                print(
                    f"{kind:<10}{100 * width:>7.0f}{100 * noise:>9.1f}{100 * covered:>11.0f}",
                    end="",
                )
                print(f"{100 * outside:>11.1f}{named:>5}/{len(SEEDS)}", flush=True)
