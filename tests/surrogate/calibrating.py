"""How error bars are held against true errors, for the tests and the benchmark's table."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from surrogate.build import build
from surrogate.surrogate import Surrogate
from surrogate.table.rows import LoadRange, Rows
from tests.surrogate.responses import HIGH, RANGE, Response, clean_wrenches, full_wrenches, table
from tests.surrogate.responses import smooth as smooth_response

TABLES = Path(__file__).parent / "tables"
NOISE = 3e-4  # m and rad, standard deviation


class Calibration(NamedTuple):
    """Per output: the part of true errors inside the bar, and median bar over median error."""

    inside: np.ndarray
    ratio: np.ndarray
    rms: np.ndarray


class Shipped(NamedTuple):
    """Real solves of a shipped component: a table, and wrenches that are not in it."""

    rows: Rows
    load_range: LoadRange
    asked: np.ndarray
    true: np.ndarray


def calibration(
    surrogate: Surrogate, wrenches: np.ndarray, true: np.ndarray, method: str | None = None
) -> Calibration:
    """Hold the bars of answers within the rows against true displacements, (n, 6).

    Of synthetic responses that leave nothing out, bars hold though the table cannot know it and so
    calls full wrenches thin.
    """
    answers = surrogate.batch(wrenches, None, method)
    covered = answers.coverage != 2
    assert covered.mean() > 0.9
    error, bars = np.abs(answers.displacement - true)[covered], answers.error[covered]
    # What no load moves errs by rounding, and so does its bar.
    rounding = 1e-9 * np.abs(true).max(axis=0) + 1e-16
    middle = np.maximum(np.median(error, axis=0), rounding)
    ratio = np.median(bars, axis=0) / middle
    rms = np.sqrt((error**2).mean(axis=0)) / np.maximum(np.ptp(true, axis=0), 1e-16)
    return Calibration((error <= bars + rounding).mean(axis=0), ratio, rms)


def synthetic(
    response: Response, rows: Rows, method: str | None = None, **how: object
) -> Calibration:
    """Calibrate a table of a synthetic response on 2000 full wrenches."""
    asked = full_wrenches(2000, 99)
    surrogate = build(rows, RANGE, **how)  # type: ignore[arg-type]
    return calibration(surrogate, asked * HIGH, response(asked), method)


def noisy(per_axis: int, seed: int) -> Rows:
    """Return measured rows of the smooth response."""
    noise = np.random.default_rng(seed).normal(size=(3 * per_axis, 6)) * NOISE
    return table(lambda x: smooth_response(x) + noise, clean_wrenches(per_axis, seed))


def with_slopes(response: Response, scaled: np.ndarray) -> Rows:
    """Return rows with their tangents, as solves write them."""
    step, slopes = 1e-6, np.empty((len(scaled), 6, 6))
    for load, way in enumerate(step * np.eye(6)):
        slopes[:, :, load] = (response(scaled + way) - response(scaled - way)) / (2 * step)
    return table(response, scaled, compliance=slopes / HIGH, source=["fea"] * len(scaled))


def shipped(name: str, full: int) -> Shipped:
    """Return a component's clean rows and some full wrenches as a table, the rest to be asked."""
    with np.load(TABLES / f"{name}.npz") as file:
        wrench, moved = file["wrench"], file["displacement"]
        compliance, clean = file["compliance"].astype(float), int(file["clean"])
        load_range = LoadRange(file["low"], file["high"])
    kept = slice(0, clean + full)
    count = len(wrench[kept])
    rows = Rows.of(wrench[kept], moved[kept], compliance=compliance[kept], source=["fea"] * count)
    rest = slice(len(compliance), None)
    return Shipped(rows, load_range, wrench[rest], moved[rest])
