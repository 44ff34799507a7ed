"""From the rows of one version of a table to the interpolators that are packed.

Rows may lack outputs, such as those of a test rig that measured only u_z. Outputs that the same
rows have make one group with a surrogate of just those rows, so no NaN enters an interpolator.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from .axes.axes import Composition
from .findings.find import rig_error
from .solver_error import SolverError, bars_are_whole
from .surrogate import Surrogate
from .table.axes import OffAxis
from .table.compliance import ComplianceFit
from .table.merging import row_conflicts
from .table.rows import LoadRange, Rows, Tolerance


class AnyTable:
    """The surrogates of one version of a table; `build` makes one.

    Attributes
    ----------
    rows : Rows
        All of them, in ascending order of `seq`; NaN where an output was not measured.
    load_range : LoadRange
    groups : tuple of (tuple of int, Surrogate)
        Outputs that the same rows have, and the surrogate of those rows, the fewest first. An
        output that no row has is in no group.
    thinnest : Surrogate
        That of the fewest rows: where it is thin, some output is.
    composition, fit, used, default
        Those of the thinnest surrogate.
    packed : surrogate.kernel.binding.PackedTable or None
        The same table packed; None until it is made.
    solver_error : SolverError or None
        Error of the solver: in no error bar here; `bars_are_whole` says whether it is known.
    rig_error : ndarray, shape (6,), m and rad
        See `rig_error.rig_error`: in no error bar here.
    reading : ndarray, shape (6,), m and rad
        Noise of one measured reading, 95 %; NaN where it is not known.
    """

    packed: Any = None

    def __init__(
        self,
        rows: Rows,
        load_range: LoadRange,
        groups: Sequence[tuple[tuple[int, ...], Surrogate]],
        solver_error: SolverError | None,
    ) -> None:
        self.rows, self.load_range = rows, load_range
        self.groups = tuple(sorted(groups, key=lambda group: len(group[1].rows)))
        thinnest = self.thinnest = self.groups[0][1]
        self.tolerance, self.linear = thinnest.tolerance, thinnest.linear
        self.version = thinnest.version
        self.fit: ComplianceFit = thinnest.fit
        self.used, self.default = thinnest.used, thinnest.default
        self.solver_error = None if solver_error is None else solver_error.grown(rows, load_range)
        self.bars_are_whole = bars_are_whole(rows, solver_error)
        self.rig_error = rig_error(rows, load_range)
        self.reading = np.full(rows.displacement.shape[1], np.nan)
        for outputs, group in self.groups:
            self.reading[list(outputs)] = group.reading[list(outputs)]

    @property
    def locked(self) -> tuple[int, ...]:
        """Places, in `LOADS`, of the loads on locked freedoms, which change no answer."""
        return self.thinnest.locked

    @property
    def composition(self) -> Composition:
        """The axes of the thinnest surrogate."""
        return self.thinnest.composition

    def coverage_summary(self) -> dict[str, Any]:
        """Return how the table covers the load range, as JSON-able values."""
        summary = self.thinnest.coverage_summary() | {
            "rig_error": self.rig_error.tolist(),
            "noise_of_a_reading": [None if one != one else one for one in self.reading.tolist()],
        }
        if not self.rows.partial:
            return summary
        measured = np.isfinite(self.rows.displacement).sum(axis=0).tolist()
        names = self.rows.space.output_names
        return {
            **summary,
            "rows": len(self.rows),
            **row_conflicts(self.rows, self.load_range),
            "rows_per_output": dict(zip(names, measured, strict=True)),
            "unmeasured": [name for name, count in zip(names, measured, strict=True) if not count],
        }


def build(
    rows: Rows,
    load_range: LoadRange,
    *,
    tolerance: Tolerance | None = None,
    linear: bool = False,
    off_axis: OffAxis = "correct",
    version: int = 0,
    before: AnyTable | None = None,
    solver_error: SolverError | None = None,
    locked: Sequence[int] = (),
) -> AnyTable:
    """Build the table of valid rows of one fingerprint.

    Parameters
    ----------
    tolerance : Tolerance or None, m and rad
    linear : bool
        Whether the component is linear, so that its 6x6 compliance is the whole truth.
    off_axis : {"correct", "ignore", "exclude"}
        What becomes of rows that are clean for no axis.
    before : AnyTable, optional
        Another version: axes with the same points are taken from it, to the last bit the same.
    solver_error : SolverError, optional
        What the solver of those rows may be wrong by; in no error bar of the table itself.
    locked : sequence of int
        Places, in `LOADS`, of the loads on locked freedoms: answers leave these loads out.
    """
    if (np.diff(rows.seq) < 0).any():  # so that the order they come in changes nothing
        rows = rows.take(np.argsort(rows.seq, kind="stable"))
    known = dict(before.groups) if before is not None else {}
    how: dict[str, Any] = {"tolerance": tolerance, "linear": linear, "off_axis": off_axis}
    how |= {"version": version, "locked": locked}
    groups = [
        (outputs, Surrogate(own, load_range, before=known.get(outputs), outputs=outputs, **how))
        for outputs, own in _by_output(rows)
    ]
    return AnyTable(rows, load_range, groups, solver_error)


def _by_output(rows: Rows) -> list[tuple[tuple[int, ...], Rows]]:
    """Return which outputs the same rows have, and those rows, 0 in the place of all others.

    Their slopes are 0 too, and there are no third derivatives: those of a displacement that is not
    there would contradict it.
    """
    if not rows.partial:
        return [(tuple(range(rows.displacement.shape[1])), rows)]
    known = np.isfinite(rows.displacement)
    every = np.arange(known.shape[1])
    outputs_of: dict[bytes, list[int]] = {}
    for output in every.tolist():
        outputs_of.setdefault(known[:, output].tobytes(), []).append(output)
    parts = []
    for outputs in outputs_of.values():
        some = rows.take(known[:, outputs[0]])
        if len(some):
            own = np.isin(every, outputs)
            moved = np.where(own, some.displacement, 0.0)
            partly = ~np.isfinite(some.compliance).all(axis=(1, 2), keepdims=True)
            slopes = np.where(own[:, None] | partly, some.compliance, 0.0)
            changed = {
                "displacement": moved,
                "compliance": slopes,
                "curvature": np.empty((len(some), 0)),
            }
            parts.append((tuple(outputs), replace(some, **changed)))
    return parts
