"""How error bars are held against true errors, for the tests and the benchmark's table."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from tests.surrogate.kriging.responses import Response, noisy_rows, solved, spread_wrenches
from tests.surrogate.law import build
from tests.surrogate.responses import HIGH, RANGE, full_wrenches, smooth
from wrenchbook.surrogate.build import Group
from wrenchbook.surrogate.design import next_wrenches
from wrenchbook.surrogate.table.rows import LoadRange, Rows

TABLES = Path(__file__).parent / "tables"
ASKED = 1000

INSIDE = 0.9  # of the true errors lie within their bars
COVERED_INSIDE = 0.85  # of those that a table says it covers, whatever the table
SHARP = 5.0  # the median bar over the median error, at most, of the median output
# Where errors are below a ten-thousandth of the range no one needs sharper bars.
TINY, SHARP_TINY = 1e-4, 8.0
# To what truth is known, of the largest displacement: made-up responses by their arithmetic, solves
# by where Newton's steps end (two solves of one wrench of the spring differ by 4e-7).
ARITHMETIC, SOLVES = 1e-9, 4e-7
# Piecewise linear: most errors are nothing, so that their 90 % quantile is what bars are for.
FLOOR = 1e-5  # of an output's spread: no bar is sharper
PIECEWISE = ("kinked", "kink_across")


class Calibration(NamedTuple):
    """Per output, shape (6,), what bars are beside true errors.

    Attributes
    ----------
    inside : ndarray
        Part of the true errors inside the bar.
    ratio : ndarray
        Median bar over median error.
    tail_ratio : ndarray
        Median bar over the 90 % quantile of the errors.
    rms, median : ndarray
        Of the errors, over the output's range.
    covered : float
        Part of the answers that the table says it covers.
    covered_inside : float
        Part of those answers' errors inside the bar, the worst output; 1 where none is covered.
    """

    inside: np.ndarray
    ratio: np.ndarray
    tail_ratio: np.ndarray
    rms: np.ndarray
    median: np.ndarray
    covered: float
    covered_inside: float

    def complaints(self, *, piecewise: bool = False, calibrated: bool = True) -> list[str]:
        """Return what is not as it should be.

        Parameters
        ----------
        piecewise : bool
            Whether the response is piecewise linear.
        calibrated : bool
            Whether bars must hold everywhere; if not, only where the table says it covers.
        """
        results = []
        if self.covered_inside < COVERED_INSIDE:
            results.append(f"{self.covered_inside:.1%} of what is called covered inside")
        if not calibrated:
            return results
        if np.isnan(self.inside).any():
            return [*results, "no error is known"]
        if self.inside.min() < INSIDE:
            results.append(f"{self.inside.min():.1%} inside")
        ratio = self.tail_ratio if piecewise else self.ratio
        over = float(np.median(ratio / np.where(self.median < TINY, SHARP_TINY, SHARP)))
        if over > 1:
            results.append(f"median bar {over:.2f} x what it may be")
        return results


class Shipped(NamedTuple):
    """Real solves of a shipped component: a table, and wrenches that are not in it."""

    rows: Rows
    load_range: LoadRange
    asked: np.ndarray
    true: np.ndarray


def calibration(
    surrogate: Group,
    wrenches: np.ndarray,
    true: np.ndarray,
    method: str | None = None,
    accuracy: float = ARITHMETIC,
) -> Calibration:
    """Hold the bars of answers within the rows against true displacements, (n, 6).

    `accuracy`, of the largest displacement, is what the truth itself is known to.
    """
    reported = surrogate.batch(wrenches, None, method)
    error = np.abs(reported.displacement - true)
    size = np.maximum(np.ptp(true, axis=0), np.finfo(float).tiny)
    # What no load moves errs by rounding, and so does its bar.
    rounding = accuracy * np.abs(true).max(axis=0) + 1e-16
    held, covered = error <= reported.error + rounding, reported.coverage == 0
    known = (reported.coverage != 2) & np.isfinite(reported.error).all(axis=1)
    if not known.any():  # a table that knows no error claims nothing, and covers nothing
        assert not covered.any()
        nothing = np.full(6, np.nan)
        return Calibration(nothing, nothing, nothing, nothing, nothing, 0.0, 1.0)
    error, bars = error[known], reported.error[known]
    least = np.maximum(rounding, FLOOR * true.std(axis=0))
    middle = np.maximum(np.median(error, axis=0), least)
    tail = np.maximum(np.quantile(error, 0.9, axis=0), least)
    return Calibration(
        held[known].mean(axis=0),
        np.median(bars, axis=0) / middle,
        np.median(bars, axis=0) / tail,
        np.sqrt((error**2).mean(axis=0)) / size,
        middle / size,
        float(covered.mean()),
        float(held[covered].mean(axis=0).min()) if covered.any() else 1.0,
    )


def synthetic(
    response: Response, rows: Rows, method: str | None = None, seed: int = 99, **how: object
) -> Calibration:
    """Calibrate a table of a synthetic response on full wrenches."""
    asked = full_wrenches(ASKED, seed)
    surrogate = build(rows, RANGE, **how)  # type: ignore[arg-type]
    return calibration(surrogate, asked * HIGH, response(asked), method)


def filled(response: Response, count: int, seed: int) -> Rows:
    """Return what fill asks for, with tangents, after two random wrenches."""
    rows = solved(response, full_wrenches(2, seed))
    while len(rows) < count:
        surrogate = build(rows, RANGE)
        asked = next_wrenches(surrogate, min(24, count - len(rows))).wrenches
        rows = rows + solved(response, asked / HIGH)
    return rows


with_slopes = solved


def noisy(per_axis: int, full: int, seed: int, told: bool = False) -> Rows:
    """Return measured rows of the smooth response."""
    return noisy_rows(smooth, spread_wrenches(per_axis, full, seed), seed, told)


def shipped(name: str, full: int, clean: int | None = None, begin: int = 0) -> Shipped:
    """Return a component's clean rows and some full wrenches as a table, the rest to be asked."""
    with np.load(TABLES / f"{name}.npz") as file:
        wrench, moved = file["wrench"], file["displacement"]
        compliance, first = file["compliance"].astype(float), int(file["clean"])
        load_range = LoadRange(file["low"], file["high"])
    kept = np.concatenate((np.arange(first)[:clean], first + begin + np.arange(full)))
    count = len(kept)
    rows = Rows.of(wrench[kept], moved[kept], compliance=compliance[kept], source=["fea"] * count)
    rest = slice(len(compliance), None)
    return Shipped(rows, load_range, wrench[rest], moved[rest])
