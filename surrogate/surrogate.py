"""The surrogate of one version of a table: rows in; displacement, error bar and coverage out."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from surrogate.answers import COMPOSED, METHODS, Answer, Batch, judged
from surrogate.axes import CLEAN, OffAxis
from surrogate.batches import (
    nothing_known,
    read_many_carefully,
    read_many_linearly,
    read_many_nearest,
)
from surrogate.building import build_composition
from surrogate.compliance import ComplianceFit, fit_compliance
from surrogate.composition import Composition
from surrogate.coverage import (
    COVERED,
    NAMES,
    OUTSIDE,
    THIN,
    Careful,
    over_tolerance,
    read_carefully,
)
from surrogate.linear import answer_linearly, explain_linearly
from surrogate.methods import Methods
from surrogate.nearest import NearestRow
from surrogate.rows import Floats, LoadRange, Rows, Tolerance
from surrogate.summary import summarise


class Surrogate:
    """The interpolators built from one version of a table; immutable.

    Attributes
    ----------
    rows : Rows
    load_range : LoadRange
    tolerance : Tolerance or None
    linear : bool
        Whether the component is linear, so that its 6x6 compliance is the whole truth.
    version : int
    fit : ComplianceFit
    """

    def __init__(
        self,
        rows: Rows,
        load_range: LoadRange,
        *,
        tolerance: Tolerance | None = None,
        linear: bool = False,
        off_axis: OffAxis = "correct",
        version: int = 0,
    ) -> None:
        if (np.diff(rows.seq) < 0).any():  # so that the order they come in changes nothing
            rows = rows.take(np.argsort(rows.seq, kind="stable"))
        self.rows, self.load_range, self.tolerance = rows, load_range, tolerance
        self.linear, self.version = linear, version
        self.off_axis: OffAxis = off_axis
        self.fit: ComplianceFit = fit_compliance(rows, load_range, linear=linear)
        self.default = "linear" if linear and self.fit.complete else "griddata"
        self._small = (CLEAN * load_range.scale).tolist()
        self._place = {tuple(w): p for p, w in reversed(list(enumerate(rows.wrench.tolist())))}
        if self.default == "griddata":
            _ = self.composition  # linear components triangulate only when they are asked to

    @classmethod
    def build(
        cls,
        rows: Rows,
        load_range: LoadRange,
        *,
        tolerance: Tolerance | None = None,
        linear: bool = False,
        off_axis: OffAxis = "correct",
        version: int = 0,
    ) -> Surrogate:
        """Build the surrogate of valid rows of one fingerprint.

        Parameters
        ----------
        off_axis : {"correct", "ignore", "exclude"}
            What becomes of rows that are clean for no axis.
        """
        if rows.partial:
            from surrogate.partial import PartlyMeasured  # it is made of surrogates

            cls = PartlyMeasured
        return cls(
            rows,
            load_range,
            tolerance=tolerance,
            linear=linear,
            off_axis=off_axis,
            version=version,
        )

    @cached_property
    def composition(self) -> Composition:
        """The three axes of the straight direction influence."""
        return build_composition(self.rows, self.load_range, self.fit, self.off_axis)

    @cached_property
    def methods(self) -> Methods:
        """The methods besides `griddata` that compose axes, and what `auto` chooses."""
        return Methods(self.rows, self.load_range, self.fit, self.composition)

    @cached_property
    def nearest(self) -> NearestRow:
        """The index of nearest rows; needs at least one row."""
        return NearestRow(self.rows, self.load_range)

    def answer(
        self,
        wrench: Sequence[float],
        tolerance: Tolerance | None = None,
        method: str | None = None,
    ) -> Answer:
        """Answer one wrench of six finite floats, N and N·m.

        Raises
        ------
        ValueError
            If the method is none of `METHODS`.
        """
        tolerance = tolerance or self.tolerance
        if (method or self.default) != "griddata":
            return self._answer_otherwise(wrench, tolerance, self._known_method(method))
        quick = self.composition.quick(wrench)
        if quick is None:
            return self._answer_carefully(wrench, tolerance)
        displacement, error = quick
        if tolerance is not None:
            a, b, c, d, e, f = error
            most, turn = tolerance.translation, tolerance.rotation
            if a > most or b > most or c > most or d > turn or e > turn or f > turn:
                return self._or_row(wrench, judged(displacement, error, tolerance, "griddata"))
        return Answer(displacement, error, "covered", "", "griddata")

    def batch(
        self,
        wrenches: ArrayLike,
        tolerance: Tolerance | None = None,
        method: str | None = None,
    ) -> Batch:
        """Answer many wrenches, shape (n, 6), N and N·m, with the same numbers as `answer`.

        Raises
        ------
        ValueError
            If the method is none of `METHODS`.
        """
        asked = np.asarray(wrenches, dtype=float).reshape(-1, 6)
        tolerance = tolerance or self.tolerance
        known = self._known_method(method)
        return self._judged_many(asked, self._read_many(asked, known), tolerance)

    def explain(
        self,
        wrench: Sequence[float],
        tolerance: Tolerance | None = None,
        method: str | None = None,
    ) -> list[dict[str, Any]]:
        """Return per axis its inputs, outputs, error bars, coverage, reason and rows (their seq).

        They are those of the compliance if it answers, of the composition otherwise.
        """
        if self._known_method(method) == "linear":
            found = answer_linearly(self.fit, self.load_range, wrench, tolerance or self.tolerance)
            return explain_linearly(self.fit, self.rows, wrench, found)
        careful = self._carefully(wrench)
        tolerance = tolerance or self.tolerance
        for axis in careful.axes:
            bars = axis["error"]
            if tolerance is None or bars is None or axis["coverage"] != "covered":
                continue
            padded = [bars.get(name, 0.0) for name in ("u_x", "u_y", "u_z", "rx", "ry", "rz")]
            reason = over_tolerance(padded, tolerance)
            if reason:
                axis["coverage"], axis["reason"] = "thin", f"axis {axis['axis']}: {reason}"
        return careful.axes

    def source_of(self, wrench: Sequence[float]) -> str | None:
        """Return the source of the row that has just this wrench; None if there is none."""
        place = self._place.get(tuple(wrench))
        return None if place is None else str(self.rows.source[place])

    def coverage_summary(self) -> dict[str, Any]:
        """Return how the table covers the load range, as JSON-able values."""
        return summarise(self)

    def _known_method(self, method: str | None) -> str:
        if method is not None and method not in METHODS:
            raise ValueError(f"unknown method {method!r}: one of {', '.join(METHODS)}")
        return method or self.default

    def _read_many(self, asked: Floats, method: str) -> Batch:
        """Answer many wrenches by a method; what the quick path cannot tell, carefully."""
        small = np.array(self._small)
        loads = np.where(np.abs(asked) > small, asked, 0.0)
        if not len(self.rows) and method != "griddata":
            return nothing_known(len(asked))
        if method == "linear":
            return read_many_linearly(self.fit, self.load_range, asked, small)
        if method == "nearest":
            return read_many_nearest(self.nearest, self.composition, self.fit, asked, loads)
        composed = self.composition.many(asked)
        displacement, error, told = composed[:3]
        if method in COMPOSED:
            displacement, error = self.methods.read(method, asked, composed)
        coverage = np.zeros(len(asked), dtype=np.uint8)
        rest = np.flatnonzero(~told)
        if len(rest):
            careful = nothing_known(len(rest))
            if len(self.rows):
                careful = read_many_carefully(self.composition, self.fit, loads[rest])
            displacement[rest], error[rest], coverage[rest] = careful
        return Batch(displacement, error, coverage)

    def _judged_many(self, asked: Floats, found: Batch, tolerance: Tolerance | None) -> Batch:
        """Hold error bars against the tolerance; where not covered, take the row of the wrench."""
        displacement, error, coverage = found
        if tolerance is not None:
            most = np.repeat([tolerance.translation, tolerance.rotation], 3)
            coverage[(coverage == COVERED) & (error > most).any(axis=1)] = THIN
        doubtful = np.flatnonzero(coverage != COVERED)
        for place, wrench in zip(doubtful, map(tuple, asked[doubtful].tolist()), strict=True):
            row = self._place.get(wrench)
            if row is not None:
                displacement[place] = self.rows.displacement[row]
                error[place] = np.nan_to_num(self.rows.uncertainty[row])
                coverage[place] = COVERED
        return found

    def _without_traces(self, wrench: Sequence[float]) -> list[float]:
        """Return the wrench with loads below 1e-9 of the range taken as none."""
        return [
            float(w) if abs(w) > small else 0.0
            for w, small in zip(wrench, self._small, strict=True)
        ]

    def _carefully(self, wrench: Sequence[float]) -> Careful:
        loads = self._without_traces(wrench)
        return read_carefully(self.composition, self.fit, self.rows, loads)

    def _answer_carefully(self, wrench: Sequence[float], tolerance: Tolerance | None) -> Answer:
        if not len(self.rows):
            return Answer(None, None, "outside", "the table has no rows", "estimate")
        careful = self._carefully(wrench)
        displacement = tuple(careful.displacement.tolist())
        error = None if careful.error is None else tuple(careful.error.tolist())
        method = "estimate" if careful.state == OUTSIDE else "griddata"
        if careful.state == COVERED and error is not None:
            return self._or_row(wrench, judged(displacement, error, tolerance, method))
        found = Answer(displacement, error, NAMES[careful.state], careful.reason, method)
        return self._or_row(wrench, found)

    def _or_row(self, wrench: Sequence[float], found: Answer) -> Answer:
        """Return the row of just this wrench if there is one and the table is not covered."""
        place = None if found.coverage == "covered" else self._place.get(tuple(wrench))
        if place is None:
            return found
        displacement = tuple(self.rows.displacement[place].tolist())
        error = tuple(np.nan_to_num(self.rows.uncertainty[place]).tolist())
        return Answer(displacement, error, "covered", "", "row")

    def _answer_otherwise(
        self, wrench: Sequence[float], tolerance: Tolerance | None, method: str
    ) -> Answer:
        if not len(self.rows):
            return Answer(None, None, "outside", "the table has no rows", method)
        if method == "nearest":
            return self._or_row(wrench, self._answer_nearest(wrench, tolerance))
        if method in COMPOSED:
            return self._answer_composed(wrench, tolerance, method)
        found = answer_linearly(self.fit, self.load_range, wrench, tolerance)
        return self._or_row(wrench, found)

    def _answer_composed(
        self, wrench: Sequence[float], tolerance: Tolerance | None, method: str
    ) -> Answer:
        found = self._read_many(np.array([wrench], dtype=float), method)
        if found.coverage[0] != COVERED:
            return self._answer_carefully(wrench, tolerance)
        moved, error = tuple(found.displacement[0].tolist()), tuple(found.error[0].tolist())
        return self._or_row(wrench, judged(moved, error, tolerance, method))

    def _answer_nearest(self, wrench: Sequence[float], tolerance: Tolerance | None) -> Answer:
        displacement, bars = self.nearest.read(np.array([wrench], dtype=float))
        careful = self._carefully(wrench)
        moved, error = tuple(displacement[0].tolist()), tuple(bars[0].tolist())
        if careful.state != COVERED:
            return Answer(moved, error, NAMES[careful.state], careful.reason, "nearest")
        return judged(moved, error, tolerance, "nearest")
