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
from numpy.typing import NDArray

from .composition.composition import Composition
from .solver_error import SolverError
from .surrogate import Surrogate
from .table.axes import OffAxis
from .table.compliance import ComplianceFit
from .table.conflicts import row_conflicts
from .table.rows import OUTPUTS, LoadRange, Rows, Tolerance


class MissingOutputs:
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
    packed : surrogate.kernel.binding.PackedTable or None
        The same table packed; None until it is made.
    solver_error : SolverError or None
        What the solver may be wrong by: in no bar here; `bars_are_whole` says if it is known.
    """

    packed: Any = None
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
    def version(self) -> int:
        """The table's version."""
        return self.thinnest.version

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
