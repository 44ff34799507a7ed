"""From the rows of one version of a table to what answers."""

from __future__ import annotations

from .missing_outputs import MissingOutputs
from .surrogate import Surrogate
from .table.axes import OffAxis
from .table.rows import LoadRange, Rows, Tolerance

AnyTable = Surrogate | MissingOutputs


def build(
    rows: Rows,
    load_range: LoadRange,
    *,
    tolerance: Tolerance | None = None,
    linear: bool = False,
    off_axis: OffAxis = "correct",
    version: int = 0,
) -> AnyTable:
    """Build what answers from valid rows of one fingerprint.

    Parameters
    ----------
    rows : Rows
        One surrogate answers if all of them hold all outputs, else one for each set of outputs
        that the same rows hold.
    tolerance : Tolerance or None, m and rad
    linear : bool
        Whether the component is linear, so that its 6x6 compliance is the whole truth.
    off_axis : {"correct", "ignore", "exclude"}
        What becomes of rows that are clean for no axis.
    """
    made = MissingOutputs if rows.partial else Surrogate
    return made(
        rows, load_range, tolerance=tolerance, linear=linear, off_axis=off_axis, version=version
    )
