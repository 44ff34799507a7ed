"""The methods a composed answer can be read by, in one registry.

`griddata` interpolates linearly between rows. `tangent` adds the bend that the rows' slopes tell,
`rbf` puts splines in the place of triangulations, `corrected` adds to those a six-dimensional
correction; `auto` takes for each output the one whose errors at rows it does not know are the
smallest. All of them know the same wrenches: where `griddata` is not covered, none is.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import cached_property

import numpy as np

from surrogate.bars.conformal import conformal_factor
from surrogate.composition.build import axes_of
from surrogate.composition.composition import Composed, Composition
from surrogate.corrected import Corrected
from surrogate.leftout import product_sizes
from surrogate.methods.selection import Choice, choose, straight_scores
from surrogate.straight import StraightSplines
from surrogate.table.axes import clean_rows
from surrogate.table.compliance import ComplianceFit
from surrogate.table.rows import Floats, LoadRange, Rows

FEW_FULL = 10  # full-wrench rows below which they calibrate no bar and choose no method
SLOWEST = 2e-3  # s a single answer may take for `auto` to choose its method

Told = tuple[Floats, Floats]


class Methods:
    """The methods of one table; each is made ready when it is first asked for.

    Attributes
    ----------
    registry : dict of str to callable
        From wrenches (n, 6), N and N·m, and what the composition says of them, to displacements
        and error bars (n, 6), m and rad.
    """

    def __init__(
        self, rows: Rows, load_range: LoadRange, fit: ComplianceFit, composition: Composition
    ) -> None:
        self.rows, self.load_range, self.fit = rows, load_range, fit
        self.composition, self.scale = composition, load_range.scale
        self.full = np.flatnonzero(~clean_rows(rows, load_range).any(axis=1))
        self.registry: dict[str, Callable[[Floats, Composed], Told]] = {
            "griddata": lambda _, composed: (composed.displacement, composed.error),
            "tangent": self._read_tangent,
            "rbf": self._read_rbf,
            "corrected": self._read_corrected,
            "auto": self._read_auto,
        }

    def read(self, method: str, wrenches: Floats, composed: Composed) -> Told:
        """Return displacements and error bars, m and rad, where the composition is told."""
        told = np.flatnonzero(composed.told)
        displacement, error = composed.displacement.copy(), composed.error.copy()
        if len(told):
            some = composed.at(told)
            displacement[told], error[told] = self.registry[method](wrenches[told], some)
        return displacement, error

    @cached_property
    def straight(self) -> StraightSplines:
        """The splines of `rbf`."""
        zero = np.array(self.composition.zero)
        return StraightSplines(self.rows, self.load_range, self.fit, zero)

    @cached_property
    def corrected(self) -> Corrected:
        """The splines of `corrected`."""
        return Corrected(self.straight, self.rows, self.load_range)

    @cached_property
    def choices(self) -> tuple[Choice, ...]:
        """Which method `auto` takes for each of the six outputs, and why."""
        if len(self.full) >= FEW_FULL:
            scores = {
                name: np.sqrt(np.nanmean(e**2, axis=0)) for name, e in self._full_errors().items()
            }
            basis = f"{len(self.full)} full-wrench rows it does not know"
        else:
            scores = straight_scores(self.composition, self.straight)
            basis = "rows left out of their axes"
        seconds = {name: self._seconds(name) for name in scores}
        return choose(scores, seconds, SLOWEST, basis)

    def _full_errors(self) -> dict[str, Floats]:
        """Return each method's errors (h, 6) at full-wrench rows that it was not made from."""
        wrench, moved = self.rows.wrench[self.full], self.rows.displacement[self.full]
        composition = axes_of(self.rows, self.load_range, self.fit, "exclude")
        composed = composition.many(wrench)
        if composed.told.sum() < FEW_FULL:
            return {"griddata": np.zeros((len(wrench), 6))}
        told = composed.told
        plain = moved - composed.displacement
        errors = {
            "griddata": plain,
            "tangent": plain - composed.bend,
            "rbf": moved - self.straight.at(wrench / self.scale),
        }
        known = np.isin(self.full, self.corrected.places)
        corrected = moved - self.corrected.at(wrench / self.scale)
        learnt = np.isin(self.corrected.places, self.full)
        corrected[known] = self.corrected.left_out[learnt]
        errors["corrected"] = corrected
        return {name: np.where(told[:, None], error, np.nan) for name, error in errors.items()}

    def _seconds(self, method: str) -> float:
        """Return the seconds one answer takes, the best of three."""
        wrench = np.full((1, 6), 0.1) * self.scale
        composed, best = self.composition.many(wrench), np.inf
        composed.told[:] = True
        self.read(method, wrench, composed)
        for _ in range(3):
            start = time.perf_counter()
            self.read(method, wrench, composed)
            best = min(best, time.perf_counter() - start)
        return best

    def _read_tangent(self, wrenches: Floats, composed: Composed) -> Told:
        left_out = self.composition.left_out.influence.many(wrenches)
        error = composed.error - composed.expected + np.abs(left_out)
        return composed.displacement + composed.bend, error

    def _read_rbf(self, wrenches: Floats, composed: Composed) -> Told:
        moved = self.straight.at(wrenches / self.scale)
        return moved, np.maximum(
            self._bars("rbf", wrenches, moved, composed), self._least(composed)
        )

    def _read_corrected(self, wrenches: Floats, composed: Composed) -> Told:
        moved = self.corrected.at(wrenches / self.scale)
        bars = self._bars("corrected", wrenches, moved, composed)
        return moved, np.maximum(bars, self._least(composed))

    def _read_auto(self, wrenches: Floats, composed: Composed) -> Told:
        displacement, error = composed.displacement.copy(), composed.error.copy()
        chosen = [choice.method for choice in self.choices]
        for method in set(chosen) - {"griddata"}:
            outputs = [output for output in range(6) if chosen[output] == method]
            moved, bars = self.registry[method](wrenches, composed)
            displacement[:, outputs], error[:, outputs] = moved[:, outputs], bars[:, outputs]
        return displacement, error

    def _bars(self, method: str, wrenches: Floats, moved: Floats, composed: Composed) -> Floats:
        """Return the error bars of splines, (n, 6), calibrated on full-wrench rows.

        Without those the bar holds what rows left out of their axes show, and what `griddata` says
        is left out of all of them, which no slope of this table denies.
        """
        if len(self.full) < FEW_FULL or method not in self._factors:
            return self._bars_of_axes(wrenches)
        doubt = np.nan_to_num(self.rows.uncertainty).max(axis=0)
        sizes, factors = self._indicators(wrenches), self._factors[method]
        return np.einsum("npk,pk->nk", sizes, factors) + doubt

    def _least(self, composed: Composed) -> Floats:
        """Return the least bars of splines, shape (6,) or (n, 6), m and rad.

        Rounding; or, with no clean row at all, those of the composition, since nothing was left
        out of any axis.
        """
        if any(spline is not None for spline in self.straight.splines):
            return np.array(self.composition.rest.rounding)
        return composed.error

    def _bars_of_axes(self, wrenches: Floats) -> Floats:
        lean = np.zeros(6)
        for table in self.composition.tables:
            if table is not None:
                lean[3:] += np.abs(table.lean)
        spread = np.tile(self.straight.bars**2 + lean**2, (len(wrenches), 1))
        bent = np.zeros_like(spread)
        self.composition.left_out.widen_many(wrenches, spread, bent)
        return np.sqrt(spread) + np.abs(bent)

    def _indicators(self, wrenches: Floats) -> Floats:
        """Return what errors may grow with, (n, 3, 6): nothing, load products, their roots."""
        product = np.repeat(product_sizes(wrenches / self.scale)[:, None], 3, axis=1)
        product[:, 0] = 1.0
        product[:, 2] = np.sqrt(product[:, 2])
        return product

    @cached_property
    def _factors(self) -> dict[str, Floats]:
        """Return per method what to multiply the indicators by, (3, 6): one of them per output."""
        sizes = self._indicators(self.rows.wrench[self.full])
        factors = {}
        for method, errors in self._full_errors().items():
            known = np.isfinite(errors).all(axis=1)
            here, misses = sizes[known], np.abs(errors[known])
            each = np.stack([conformal_factor(misses, here[:, p]) for p in range(3)])
            with np.errstate(invalid="ignore"):
                width = np.median(each * here, axis=0)
            best = np.argmin(np.where(np.isfinite(width), width, np.inf), axis=0)
            factors[method] = np.where(np.arange(3)[:, None] == best, each, 0.0)
        return factors
