"""Every method of an answer in numpy, and the best estimate that errors are measured against."""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from wrenchbook.surrogate.answer import COVERED, METHODS, OUTSIDE, UnknownMethodError
from wrenchbook.surrogate.axes.axes import OFF_HULL, Axes
from wrenchbook.surrogate.build import Group
from wrenchbook.surrogate.kriging import Kriging
from wrenchbook.surrogate.table.compliance import ComplianceFit
from wrenchbook.surrogate.table.rows import ROUNDING, ZERO_LOAD, Floats, LoadRange, why_beyond
from wrenchbook.surrogate.table.space import LOADS

from .reasons import why_not


class Reference(Protocol):
    """What the errors of other methods are measured from: displacements and 95 % error bars."""

    def __call__(self, wrenches: Floats, /) -> tuple[Floats, Floats]:
        """Return (n, 6) each, m and rad, at wrenches (n, 6), N and N·m."""
        ...


def unknown(wrenches: Floats) -> tuple[Floats, Floats]:
    """Return a reference that knows nothing, (n, 6) each, m and rad."""
    return np.zeros((len(wrenches), 6)), np.full((len(wrenches), 6), np.nan)


class Estimates(NamedTuple):
    """Answers to n wrenches, before they are held against a tolerance.

    Attributes
    ----------
    displacement, error : ndarray, shape (n, 6), m and rad
        Error bars are NaN where nothing tells them.
    state : ndarray of uint8, shape (n,)
        `COVERED`, `THIN` or `OUTSIDE`.
    """

    displacement: Floats
    error: Floats
    state: NDArray[np.uint8]


class Method(Protocol):
    """One way to answer; made for one version of a table."""

    name: str

    def estimate(self, wrenches: Floats) -> Estimates:
        """Answer wrenches, shape (n, 6), N and N·m."""
        ...

    def reason(self, wrench: Floats) -> str:
        """Return why one wrench is not covered; empty if no reason is the method's own.

        The wrench has shape (6,), N and N·m.
        """
        ...


class StraightDirection(Method):
    """The composition's answer, with error bars from the reference.

    Parameters
    ----------
    composition : Axes
    reference : Reference
    name : {"griddata", "additive"}
        Translations of their own axis alone; all six outputs composed.
    """

    def __init__(self, composition: Axes, reference: Reference, name: str) -> None:
        self.axes, self.reference, self.name = composition, reference, name

    def estimate(self, wrenches: Floats) -> Estimates:
        """Answer wrenches, shape (n, 6), N and N·m."""
        composed = self.axes.evaluate(wrenches)
        displacement = composed.additive if self.name == "additive" else composed.griddata
        best, error = self.reference(wrenches)
        coverage = np.where(composed.state >= OFF_HULL, OUTSIDE, COVERED)
        error = np.abs(displacement - best) + error
        return Estimates(displacement, error, coverage.astype(np.uint8))

    def reason(self, wrench: Floats) -> str:
        """Return which axis does not hold a wrench (6,), N and N·m, and why."""
        return why_not(self.axes, wrench)


class GaussianProcess(Method):
    """The kriging's answer; outside the load range it is an estimate.

    Parameters
    ----------
    kriging : Kriging
    load_range : LoadRange
    """

    name = "kriging"

    def __init__(self, kriging: Kriging, load_range: LoadRange) -> None:
        self.kriging, self.load_range = kriging, load_range

    def estimate(self, wrenches: Floats) -> Estimates:
        """Answer wrenches, shape (n, 6), N and N·m."""
        displacement, error = self.kriging.answer_many(wrenches)
        outside = ~self.load_range.holds(wrenches)
        state = np.where(outside, OUTSIDE, COVERED).astype(np.uint8)
        return Estimates(displacement, error, state)

    def reason(self, wrench: Floats) -> str:
        """Return which load of a wrench (6,), N and N·m, lies outside the load range."""
        return why_beyond(self.load_range, wrench)


class Linear(Method):
    """The compliance's answer.

    Parameters
    ----------
    fit : ComplianceFit
    reference : Reference or None
        None for a linear component, whose compliance is the whole truth.
    """

    name = "linear"

    def __init__(
        self, fit: ComplianceFit, load_range: LoadRange, reference: Reference | None
    ) -> None:
        self.fit, self.load_range, self.reference = fit, load_range, reference

    def estimate(self, wrenches: Floats) -> Estimates:
        """Answer wrenches, shape (n, 6), N and N·m."""
        displacement = wrenches @ self.fit.matrix.T
        # Rounding is that of the sum's parts, which may cancel.
        error = self.fit.error + ROUNDING * np.abs(wrenches) @ np.abs(self.fit.matrix).T
        if self.reference is not None:
            best, bars = self.reference(wrenches)
            error = np.maximum(error, np.abs(displacement - best) + bars)
        unknown = self._unknown(wrenches).any(axis=1)
        error[unknown] = np.nan
        outside = unknown | ~self.load_range.holds(wrenches)
        return Estimates(displacement, error, np.where(outside, OUTSIDE, COVERED).astype(np.uint8))

    def reason(self, wrench: Floats) -> str:
        """Return which load of a wrench no row tells, or lies outside the load range.

        The wrench has shape (6,), N and N·m.
        """
        unknown = self._unknown(wrench[None])[0]
        if unknown.any():
            return f"no row tells the influence of {LOADS[int(np.argmax(unknown))]}"
        return why_beyond(self.load_range, wrench)

    def _unknown(self, wrenches: Floats) -> np.ndarray:
        return ~self.fit.known & (np.abs(wrenches) > ZERO_LOAD * self.load_range.scale)


def method_of(table: Any, name: str) -> Method:
    """Return a method of a group of outputs, a `GroupLaw`.

    Raises
    ------
    UnknownMethodError
        If it is none of `METHODS`.
    """
    check(name)
    if name == "kriging":
        return _gaussian(table)
    if name == "linear":
        return _linear(table)
    return _straight(table, name)


def check(name: str) -> None:
    """Raise `UnknownMethodError` if a method is none of `METHODS`."""
    if name not in METHODS:
        raise UnknownMethodError(name)


def reference_of(table: Group) -> Reference:
    """Return what the answers of methods are compared with for their error bars."""
    if table.is_exact:
        exact = Linear(table.fit, table.load_range, None)
        return lambda wrenches: exact.estimate(wrenches)[:2]
    return unknown if table.kriging is None else table.kriging.answer_many


def _straight(table: Any, name: str) -> Method:
    return StraightDirection(table.axes, table.reference, name)


def _gaussian(table: Any) -> Method:
    if table.kriging is None:  # too few rows, or rows that contradict each other
        return method_of(table, table.default)
    return GaussianProcess(table.kriging, table.load_range)


def _linear(table: Any) -> Method:
    return Linear(table.fit, table.load_range, None if table.is_exact else table.reference)
