"""Tables whose rows do not all hold every output, such as a test rig's that measured only u_z.

Outputs that the same rows hold make one surrogate, built from just those rows. So a row without a
rotation never enters a rotation's table, and no NaN ever enters any. An output that no row holds
is answered by None, and every answer names it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .answer import NAMES, Answer, Batch
from .composition.composition import Composition
from .exact_rows import sources_at
from .kriging import Kriging
from .limits import LimitedAnswers
from .solver_error import SolverError
from .surrogate import Surrogate
from .table.axes import OffAxis
from .table.compliance import ComplianceFit
from .table.conflicts import row_conflicts
from .table.rows import OUTPUTS, Floats, LoadRange, Rows, Tolerance


class MissingOutputs(LimitedAnswers):
    """The surrogates of rows that may lack some outputs.

    Attributes
    ----------
    rows : Rows
        All of them; NaN where an output was not measured.
    load_range : LoadRange
    groups : tuple of (tuple of int, Surrogate)
        Outputs that are held by the same rows, and the surrogate of those rows, the fewest first.
    unmeasured : tuple of str
        The names of the outputs that no row holds.
    solver_error : SolverError or None
        What the solver may be wrong by: in no bar here; `bars_are_whole` says if it is known.
    """

    solver_error: SolverError | None = None
    bars_are_whole: bool = True

    def __init__(
        self,
        rows: Rows,
        load_range: LoadRange,
        *,
        tolerance: Tolerance | None = None,
        linear: bool = False,
        off_axis: OffAxis = "correct",
        version: int = 0,
        before: MissingOutputs | None = None,
        locked: Sequence[int] = (),
    ) -> None:
        """Build from rows; axes that another version has as well are taken from it."""
        self.rows, self.load_range = rows, load_range
        known = dict(before.groups) if before is not None else {}
        groups = [
            (
                outputs,
                Surrogate(
                    held,
                    load_range,
                    tolerance=tolerance,
                    linear=linear,
                    off_axis=off_axis,
                    version=version,
                    before=known.get(outputs),
                    locked=locked,
                ),
            )
            for outputs, held in _by_output(rows)
        ]
        for outputs, part in groups:  # its rows hold no others: those of its answers say nothing
            part.allowed = replace(part.allowed, outputs=outputs)
        self.groups = tuple(sorted(groups, key=lambda group: len(group[1].rows)))
        held = {output for outputs, _ in self.groups for output in outputs}
        self.unmeasured = tuple(name for k, name in enumerate(OUTPUTS) if k not in held)

    @property
    def kriging(self) -> Kriging | None:
        """That of the first outputs that have one, None without: what whole fields are told by."""
        return next((own.kriging for _, own in self.groups if own.kriging is not None), None)

    @property
    def thinnest(self) -> Surrogate:
        """The surrogate of the outputs that the fewest rows hold."""
        return self.groups[0][1]

    @property
    def composition(self) -> Composition:
        """The axes of the thinnest surrogate: where they are thin, some output is."""
        return self.thinnest.composition

    @property
    def fit(self) -> ComplianceFit:
        """The compliance of the thinnest surrogate."""
        return self.thinnest.fit

    @property
    def used(self) -> Rows:
        """The rows that the thinnest surrogate's answers are made of."""
        return self.thinnest.used

    @property
    def full_wrenches(self) -> int:
        """How many of those load more than one axis."""
        return self.thinnest.doubt.full_wrenches

    @property
    def tolerance(self) -> Tolerance | None:
        """The tolerance of all its surrogates, m and rad."""
        return self.thinnest.tolerance

    @property
    def linear(self) -> bool:
        """Whether the component is linear."""
        return self.thinnest.linear

    @property
    def default(self) -> str:
        """The method that answers where none is asked for."""
        return self.thinnest.default

    @property
    def locked(self) -> tuple[int, ...]:
        """The places of the loads on locked freedoms, which change no answer."""
        return self.thinnest.locked

    @property
    def steepest(self) -> Floats:
        """What each output moves over half the load range at most, (6,), m and rad: `ExactRows`."""
        found = np.zeros(6)
        for outputs, part in self.groups:
            found[list(outputs)] = part.steepest[list(outputs)]
        return found

    @property
    def version(self) -> int:
        """The table's version."""
        return self.thinnest.version

    def estimate(
        self,
        wrench: Sequence[float],
        tolerance: Tolerance | None = None,
        method: str | None = None,
    ) -> Answer:
        """Answer one wrench, N and N·m; an output that no row holds is None, in the bars too."""
        moved: list[float | None] = [None] * 6
        bars: list[float | None] = [None] * 6
        answers = [part.estimate(wrench, tolerance, method) for _, part in self.groups]
        for (outputs, _), found in zip(self.groups, answers, strict=True):
            for output in outputs:
                moved[output] = found.displacement[output] if found.displacement else None
                bars[output] = found.error[output] if found.error else None
        # An answer is a row's only if all its outputs are.
        worst = max(answers, key=lambda one: (NAMES.index(one.coverage), one.method != "row"))
        reasons = list(dict.fromkeys(one.reason for one in answers if one.reason))
        if self.unmeasured:
            reasons.append(f"not measured in any row: {', '.join(self.unmeasured)}")
        displacement = tuple(moved) if any(one is not None for one in moved) else None
        error = tuple(bars) if any(one is not None for one in bars) else None
        return Answer(
            displacement,  # pyright: ignore[reportArgumentType]  # None where not measured
            error,  # pyright: ignore[reportArgumentType]
            worst.coverage,
            "; ".join(reasons),
            worst.method,
            self.unmeasured,
        )

    def estimates(
        self,
        wrenches: ArrayLike,
        tolerance: Tolerance | None = None,
        method: str | None = None,
    ) -> Batch:
        """Answer many wrenches, shape (n, 6), N and N·m; NaN for an output that no row holds."""
        asked = np.asarray(wrenches, dtype=float).reshape(-1, 6)
        moved, bars = np.full((len(asked), 6), np.nan), np.full((len(asked), 6), np.nan)
        coverage = np.zeros(len(asked), dtype=np.uint8)
        for outputs, part in self.groups:
            found = part.estimates(asked, tolerance, method)
            chosen = list(outputs)
            moved[:, chosen] = found.displacement[:, chosen]
            bars[:, chosen] = found.error[:, chosen]
            coverage = np.maximum(coverage, found.coverage)
        return Batch(moved, bars, coverage)

    def derivatives(self, wrenches: ArrayLike, method: str | None = None) -> Floats:
        """Return du/dw (n, 6, 6) at wrenches (n, 6): m/N, m/(N·m), rad/N, rad/(N·m).

        NaN for an output that no row holds.

        Raises
        ------
        UnknownMethodError
            If the method is none of `METHODS`.
        """
        asked = np.asarray(wrenches, dtype=float).reshape(-1, 6)
        found = np.full((len(asked), 6, 6), np.nan)
        for outputs, part in self.groups:
            found[:, list(outputs)] = part.derivatives(asked, method)[:, list(outputs)]
        return found

    def explain(
        self,
        wrench: Sequence[float],
        tolerance: Tolerance | None = None,
        method: str | None = None,
    ) -> list[dict[str, Any]]:
        """Return per group and axis what `Surrogate.explain` does, for the outputs there are.

        The wrench is six floats, N and N·m.
        """
        detail = []
        for outputs, part in self.groups:
            names = {OUTPUTS[output] for output in outputs}
            for axis in part.explain(wrench, tolerance, method):
                for key in ("outputs", "error"):
                    if axis[key] is not None:
                        axis[key] = {k: v for k, v in axis[key].items() if k in names}
                if axis["outputs"]:
                    detail.append(axis)
        return detail

    def source_of(self, wrench: Sequence[float]) -> str | None:
        """Return the source of the rows at or beside a wrench, N and N·m; None if none is.

        Of several rows that have it, which may hold different outputs, all their sources.
        """
        return sources_at(self.rows, [part.exact.wrench_at(wrench) for _, part in self.groups])

    def has_row(self, wrench: Sequence[float]) -> bool:
        """Return whether the row at or beside a wrench (6,), N and N·m, has just that."""
        return any(part.has_row(wrench) for _, part in self.groups)

    def near_rows(self, wrenches: Floats) -> NDArray[np.bool_]:
        """Return at or beside which wrenches (k, 6), N and N·m, there is a row, shape (k,)."""
        return np.logical_or.reduce([part.near_rows(wrenches) for _, part in self.groups])

    def row_tangent(self, wrench: Sequence[float]) -> Floats:
        """Return the tangent (6, 6), SI, of the rows at or beside a wrench; NaN where none has."""
        found = np.full((6, 6), np.nan)
        for outputs, part in self.groups:
            found[list(outputs)] = part.row_tangent(wrench)[list(outputs)]
        return found

    def coverage_summary(self) -> dict[str, Any]:
        """Return the summary of the thinnest surrogate, and how many rows hold what."""
        held = np.isfinite(self.rows.displacement).sum(axis=0).tolist()
        return {
            **self.thinnest.coverage_summary(),
            "rows": len(self.rows),
            **row_conflicts(self.rows, self.load_range),
            "rows_per_output": dict(zip(OUTPUTS, held, strict=True)),
            "unmeasured": list(self.unmeasured),
        }


def _by_output(rows: Rows) -> list[tuple[tuple[int, ...], Rows]]:
    """Return which outputs the same rows hold, and those rows, 0 in the place of all others.

    Their slopes are 0 too: slopes of a displacement that is not there would contradict it.
    """
    known = np.isfinite(rows.displacement)
    outputs_of: dict[bytes, list[int]] = {}
    for output in range(6):
        outputs_of.setdefault(known[:, output].tobytes(), []).append(output)
    parts = []
    for outputs in outputs_of.values():
        held = rows.take(known[:, outputs[0]])
        if len(held):
            own = np.isin(np.arange(6), outputs)
            moved = np.where(own, held.displacement, 0.0)
            slopes = np.where(own[:, None] | ~_sloped(held), held.compliance, 0.0)
            parts.append((tuple(outputs), replace(held, displacement=moved, compliance=slopes)))
    return parts


def _sloped(rows: Rows) -> NDArray[np.bool_]:
    """Return which rows bring a whole finite tangent, shape (n, 1, 1)."""
    return np.asarray(np.isfinite(rows.compliance).all(axis=(1, 2), keepdims=True))
