"""Tables whose rows do not all hold every output, such as a test rig's that measured only u_z.

Outputs that the same rows hold make one surrogate, built from just those rows. So a row without a
rotation never enters a rotation's table, and no NaN ever enters any. An output that no row holds
is answered by None, with the reason.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from surrogate.answers import Answer, Batch
from surrogate.axes import OffAxis
from surrogate.conflicts import row_conflicts
from surrogate.coverage import NAMES, OUTSIDE
from surrogate.rows import OUTPUTS, LoadRange, Rows, Tolerance
from surrogate.surrogate import Surrogate

Group = tuple[tuple[int, ...], Surrogate]


class PartlyMeasured(Surrogate):
    """A surrogate of rows that may lack some outputs.

    Attributes
    ----------
    groups : tuple of (tuple of int, Surrogate)
        Outputs that are held by the same rows, and the surrogate of those rows; of `Surrogate`'s
        own attributes `composition` and `fit` are those of the group with the fewest rows.
    unmeasured : tuple of str
        Outputs that no row holds.
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
        """Build one surrogate for each group of outputs; `rows` hold NaN where not measured."""
        known = np.isfinite(rows.displacement)
        places: dict[bytes, list[int]] = {}
        for output in range(6):
            places.setdefault(known[:, output].tobytes(), []).append(output)
        groups: list[Group] = []
        for outputs in places.values():
            held = rows.take(known[:, outputs[0]])
            if len(held):
                blank = np.where(np.isin(np.arange(6), outputs), held.displacement, 0.0)
                part = Surrogate(
                    replace(held, displacement=blank),
                    load_range,
                    tolerance=tolerance,
                    linear=linear,
                    off_axis=off_axis,
                    version=version,
                )
                groups.append((tuple(outputs), part))
        self.groups = tuple(sorted(groups, key=lambda group: len(group[1].rows)))
        least = self.groups[0][1]
        self.__dict__.update(least.__dict__)
        self.rows = rows
        told = {output for outputs, _ in self.groups for output in outputs}
        self.unmeasured = tuple(name for k, name in enumerate(OUTPUTS) if k not in told)

    def answer(
        self,
        wrench: Sequence[float],
        tolerance: Tolerance | None = None,
        method: str | None = None,
    ) -> Answer:
        """Answer one wrench; an output that no row holds is None, in the error bars too."""
        moved: list[float | None] = [None] * 6
        bars: list[float | None] = [None] * 6
        answers = [part.answer(wrench, tolerance, method) for _, part in self.groups]
        for (outputs, _), told in zip(self.groups, answers, strict=True):
            for output in outputs:
                moved[output] = told.displacement[output] if told.displacement else None
                bars[output] = told.error[output] if told.error else None
        worst = max(answers, key=lambda told: NAMES.index(told.coverage))
        reasons = dict.fromkeys(told.reason for told in answers if told.reason)
        if self.unmeasured:
            reasons[f"not measured in any row: {', '.join(self.unmeasured)}"] = None
        displacement = tuple(moved) if any(one is not None for one in moved) else None
        error = tuple(bars) if any(one is not None for one in bars) else None
        return Answer(displacement, error, worst.coverage, "; ".join(reasons), worst.method)  # pyright: ignore[reportArgumentType]

    def batch(
        self,
        wrenches: ArrayLike,
        tolerance: Tolerance | None = None,
        method: str | None = None,
    ) -> Batch:
        """Answer many wrenches; NaN for an output that no row holds."""
        asked = np.asarray(wrenches, dtype=float).reshape(-1, 6)
        moved, bars = np.full((len(asked), 6), np.nan), np.full((len(asked), 6), np.nan)
        coverage = np.zeros(len(asked), dtype=np.uint8)
        for outputs, part in self.groups:
            told = part.batch(asked, tolerance, method)
            moved[:, outputs], bars[:, outputs] = (
                told.displacement[:, outputs],
                told.error[:, outputs],
            )
            coverage = np.maximum(coverage, told.coverage)
        return Batch(moved, bars, np.minimum(coverage, OUTSIDE).astype(np.uint8))

    def explain(
        self,
        wrench: Sequence[float],
        tolerance: Tolerance | None = None,
        method: str | None = None,
    ) -> list[dict[str, Any]]:
        """Return per group and axis what `Surrogate.explain` does, for the outputs there are."""
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

    def coverage_summary(self) -> dict[str, Any]:
        """Return the summary of the group with the fewest rows, and how many rows hold what."""
        summary = self.groups[0][1].coverage_summary()
        held = np.isfinite(self.rows.displacement).sum(axis=0).tolist()
        return {
            **summary,
            "rows": len(self.rows),
            **row_conflicts(self.rows, self.load_range),
            "rows_per_output": dict(zip(OUTPUTS, held, strict=True)),
            "unmeasured": list(self.unmeasured),
        }
