"""The surrogate of one version of a table: rows in; displacement, error bar and coverage out."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from surrogate.answer import (
    COMPOSED,
    COVERED,
    METHODS,
    NAMES,
    OUTSIDE,
    THIN,
    Answer,
    Batch,
    UnknownMethodError,
    judged,
    over_tolerance,
)
from surrogate.bars.coverage import Careful, read_carefully
from surrogate.bars.evaluate import (
    diagnose,
    nothing_known,
    read_many_linearly,
    read_many_nearest,
)
from surrogate.composition.build import build_composition
from surrogate.composition.composition import Composition
from surrogate.describe.summary import summarise
from surrogate.methods.linear import answer_linearly, explain_linearly
from surrogate.methods.nearest import NearestRow
from surrogate.methods.registry import Methods
from surrogate.table.axes import OffAxis, clean_rows
from surrogate.table.compliance import ComplianceFit, fit_compliance
from surrogate.table.merging import merge
from surrogate.table.rows import CLEAN, OUTPUTS, Floats, LoadRange, Rows, Tolerance

# Full wrenches, or rows with tangents, from which on a table can tell what loads of several axes do
# together: with fewer, 3 to 26 % of the errors at full wrenches lay inside the bars.
ENOUGH_FULL = 20


class Surrogate:
    """The interpolators built from one version of a table whose rows hold all outputs; immutable.

    Attributes
    ----------
    rows : Rows
        All rows, in ascending order of `seq`.
    used : Rows
        Those that answers are made of: within the load range, repeated ones merged.
    members : tuple of tuple of int
        The numbers (`seq`) of the rows behind each of `used`.
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
        merged = merge(rows, load_range)
        self.used = merged.rows.take(merged.within)
        within = np.flatnonzero(merged.within)
        self.members = tuple(merged.members[place] for place in within)
        self.fit: ComplianceFit = fit_compliance(self.used, load_range, linear=linear)
        self.default = "linear" if linear and self.fit.complete else "griddata"
        self._small = (CLEAN * load_range.scale).tolist()
        self._exact, self._owner = merged.rows, merged.owner
        self._place = {tuple(w): p for p, w in reversed(list(enumerate(rows.wrench.tolist())))}
        self.full_wrenches = int((~clean_rows(self.used, load_range).any(axis=1)).sum())
        self._alone = not self._tells_full_wrenches()
        if self.default == "griddata":
            _ = self.composition  # linear components triangulate only when they are asked to

    def _tells_full_wrenches(self) -> bool:
        """Whether full wrenches or tangents show what loads of several axes do together.

        Tangents do if most rows, or enough of them, bring one.
        """
        tangents = int(np.isfinite(self.used.compliance).all(axis=(1, 2)).sum())
        many = tangents >= ENOUGH_FULL or 0 < len(self.used) <= 2 * tangents
        return many or self.full_wrenches >= ENOUGH_FULL

    @cached_property
    def composition(self) -> Composition:
        """The three axes of the straight direction influence."""
        return build_composition(self.used, self.load_range, self.fit, self.off_axis)

    @cached_property
    def methods(self) -> Methods:
        """The methods besides `griddata` that compose axes, and what `auto` chooses."""
        return Methods(self.used, self.load_range, self.fit, self.composition)

    @cached_property
    def nearest(self) -> NearestRow:
        """The index of nearest rows; needs at least one row."""
        return NearestRow(self.used, self.load_range)

    def answer(
        self,
        wrench: Sequence[float],
        tolerance: Tolerance | None = None,
        method: str | None = None,
    ) -> Answer:
        """Answer one wrench of six finite floats, N and N·m.

        Raises
        ------
        UnknownMethodError
            If the method is none of `METHODS`.
        """
        tolerance = tolerance or self.tolerance
        if (method or self.default) != "griddata":
            return self._answer_otherwise(wrench, tolerance, self._known_method(method))
        quick = self.composition.quick(wrench)
        if quick is None or (self._alone and self._several_axes(wrench)):
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
        UnknownMethodError
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
            found = self._answer_linearly(wrench, tolerance or self.tolerance)
            return explain_linearly(self.fit, self.used, self.members, wrench, found)
        careful = self._carefully(wrench)
        tolerance = tolerance or self.tolerance
        for axis in careful.axes:
            bars = axis["error"]
            if tolerance is None or bars is None or axis["coverage"] != "covered":
                continue
            padded = [bars.get(name, 0.0) for name in OUTPUTS]
            reason = over_tolerance(padded, tolerance)
            if reason:
                axis["coverage"], axis["reason"] = "thin", f"axis {axis['axis']}: {reason}"
        return careful.axes

    def source_of(self, wrench: Sequence[float]) -> str | None:
        """Return the source of the row that has just this wrench, N and N·m; None if none has.

        Of several rows that have it, all their sources.
        """
        same = (self.rows.wrench == np.asarray(wrench, dtype=float)).all(axis=1)
        return ", ".join(dict.fromkeys(self.rows.source[same].tolist())) if same.any() else None

    def coverage_summary(self) -> dict[str, Any]:
        """Return how the table covers the load range, as JSON-able values."""
        composition = None if self.default == "linear" else self.composition
        return summarise(self.rows, self.used, self.load_range, self.fit, composition) | {
            "method": self.default,
            "table_version": self.version,
            "full_wrench_rows": self.full_wrenches,
            "tells_full_wrenches": not self._alone,
        }

    def _known_method(self, method: str | None) -> str:
        if method is not None and method not in METHODS:
            raise UnknownMethodError(method)
        return method or self.default

    def _read_many(self, asked: Floats, method: str) -> Batch:
        """Answer many wrenches by a method; what the quick path cannot tell, carefully."""
        small = np.array(self._small)
        loads = np.where(np.abs(asked) > small, asked, 0.0)
        if not len(self.used) and method != "griddata":
            return nothing_known(len(asked))
        found = self._read_by(method, asked, loads)
        if self._alone and not (self.linear and method == "linear"):
            clean = clean_rows(Rows.of(asked, np.zeros_like(asked)), self.load_range)
            several = ~clean.any(axis=1) & (found.coverage == COVERED)
            found.coverage[several] = THIN
        return found

    def _read_by(self, method: str, asked: Floats, loads: Floats) -> Batch:
        """Answer wrenches (n, 6), N and N·m, by a method; `loads` are they without traces."""
        if method == "linear":
            return read_many_linearly(self.fit, self.load_range, asked, np.array(self._small))
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
            if len(self.used):
                careful = diagnose(self.composition, self.fit, loads[rest]).batch
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
                displacement[place], error[place] = self._row(row)
                coverage[place] = COVERED
        return found

    def _row(self, place: int) -> tuple[Floats, Floats]:
        """Return displacement and uncertainty, (6,) each, m and rad, of a row or its merged one."""
        owner = self._owner[place]
        doubt = np.nan_to_num(self._exact.uncertainty[owner])
        return self._exact.displacement[owner], doubt

    def _several_axes(self, wrench: Sequence[float]) -> bool:
        """Whether a wrench loads more than one axis: the table is then thin, if nothing tells."""
        a, b, c, d, e, f = self._without_traces(wrench)
        return not (
            (not b and not c and not d)
            or (not a and not c and not e)
            or (not a and not b and not f)
        )

    def _too_few(self) -> str:
        """Say what a table lacks that does not tell what loads of several axes do together."""
        return (
            f"{self.full_wrenches} full wrenches and no tangents: at least {ENOUGH_FULL} full "
            "wrenches are needed to tell what loads of several axes do together"
        )

    def _without_traces(self, wrench: Sequence[float]) -> list[float]:
        """Return the wrench with loads below 1e-9 of the range taken as none."""
        return [
            float(w) if abs(w) > small else 0.0
            for w, small in zip(wrench, self._small, strict=True)
        ]

    def _carefully(self, wrench: Sequence[float]) -> Careful:
        loads = self._without_traces(wrench)
        return read_carefully(self.composition, self.fit, self.members, loads)

    def _answer_carefully(self, wrench: Sequence[float], tolerance: Tolerance | None) -> Answer:
        if not len(self.used):
            return self._or_row(wrench, Answer(None, None, "outside", self._empty(), "estimate"))
        careful = self._carefully(wrench)
        displacement = tuple(careful.displacement.tolist())
        error = None if careful.error is None else tuple(careful.error.tolist())
        method = "estimate" if careful.state == OUTSIDE else "griddata"
        if careful.state == COVERED and error is not None:
            # The numbers of the quick path, if it has them: its bars are the sharper ones.
            displacement, error = self.composition.quick(wrench) or (displacement, error)
            found = judged(displacement, error, tolerance, method)
        else:
            found = Answer(displacement, error, NAMES[careful.state], careful.reason, method)
        return self._or_row(wrench, self._unless_alone(wrench, found))

    def _unless_alone(self, wrench: Sequence[float], found: Answer) -> Answer:
        """Return a covered answer as a thin one where nothing tells how far it may be wrong."""
        if found.coverage == "covered" and self._alone and self._several_axes(wrench):
            return found._replace(coverage="thin", reason=self._too_few())
        return found

    def _empty(self) -> str:
        if len(self.rows):
            return "all rows of the table are outside its load range"
        return "the table has no rows"

    def _or_row(self, wrench: Sequence[float], found: Answer) -> Answer:
        """Return the row of just this wrench if there is one and the table is not covered."""
        place = None if found.coverage == "covered" else self._place.get(tuple(wrench))
        if place is None:
            return found
        displacement, error = (tuple(each.tolist()) for each in self._row(place))
        return Answer(displacement, error, "covered", "", "row")

    def _answer_otherwise(
        self, wrench: Sequence[float], tolerance: Tolerance | None, method: str
    ) -> Answer:
        if not len(self.used):
            return self._or_row(wrench, Answer(None, None, "outside", self._empty(), method))
        if method == "nearest":
            found = self._answer_nearest(wrench, tolerance)
        elif method in COMPOSED:
            found = self._answer_composed(wrench, tolerance, method)
        else:
            found = self._answer_linearly(wrench, tolerance)
        return self._or_row(wrench, found)

    def _answer_linearly(self, wrench: Sequence[float], tolerance: Tolerance | None) -> Answer:
        found = answer_linearly(self.fit, self.load_range, wrench, tolerance)
        return found if self.linear else self._unless_alone(wrench, found)

    def _answer_composed(
        self, wrench: Sequence[float], tolerance: Tolerance | None, method: str
    ) -> Answer:
        asked = np.array([wrench], dtype=float)
        loads = np.array([self._without_traces(wrench)])
        found = self._read_by(method, asked, loads)
        if found.coverage[0] != COVERED:
            return self._answer_carefully(wrench, tolerance)
        moved, error = tuple(found.displacement[0].tolist()), tuple(found.error[0].tolist())
        return self._unless_alone(wrench, judged(moved, error, tolerance, method))

    def _answer_nearest(self, wrench: Sequence[float], tolerance: Tolerance | None) -> Answer:
        displacement, bars = self.nearest.read(np.array([wrench], dtype=float))
        careful = self._carefully(wrench)
        moved, error = tuple(displacement[0].tolist()), tuple(bars[0].tolist())
        if careful.state != COVERED:
            return Answer(moved, error, NAMES[careful.state], careful.reason, "nearest")
        return self._unless_alone(wrench, judged(moved, error, tolerance, "nearest"))
