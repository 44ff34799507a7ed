"""What rows show of the errors of their measurement."""

from __future__ import annotations

import numpy as np

from ..table.rows import Floats, LoadRange, Rows
from .contract import (
    asymmetry_findings,
    lever_findings,
    linear_fit,
    range_findings,
    sign_findings,
    size_findings,
    solved_fit,
    turned_findings,
    unit_findings,
)
from .finding import RigFinding
from .response import response_of
from .sequence import sequence_findings
from .single_rows import single_row_findings, wrong_rows

FEWEST = 7  # rows: six loads and a constant
MOST = 5_000  # rows that are looked at, some 0.5 s: every k-th of more


def find(
    rows: Rows, load_range: LoadRange, solved: Floats | None = None, *, linear: bool = True
) -> list[RigFinding]:
    """Return the probable systematic errors of measured rows, in the order of their measurement.

    Parameters
    ----------
    rows : Rows
        Measured rows in the order in which they were measured.
    load_range : LoadRange, N and N·m
    solved : ndarray, shape (6, 6), SI, optional
        Compliance of the component's solves: size and sign that displacements should have. Columns
        of zeros are not known.
    linear : bool
        Whether the component is.
    """
    if len(rows) < FEWEST:
        return range_findings(rows, load_range) if len(rows) else []
    rows = looked_at(rows)
    response = response_of(rows, load_range)
    wrong = wrong_rows(rows, load_range, response)
    found = single_row_findings(rows, response, wrong)
    good = rows.take(~wrong.any(axis=1))
    if len(good) < FEWEST:
        return found
    response = response_of(good, load_range)
    fit = linear_fit(good, load_range, response)
    units = [*range_findings(good, load_range), *size_findings(good, response)]
    known = None if solved is None else solved_fit(solved, load_range)
    units = units or unit_findings(fit, known, linear=linear)
    # A lever can make a load's own work negative; a wrong sign or unit is no lever.
    contract = units or turned_findings(fit, known) or lever_findings(fit, load_range)
    found += contract or sign_findings(fit) or asymmetry_findings(fit, load_range)
    return [*found, *sequence_findings(good, response)]


def looked_at(rows: Rows) -> Rows:
    """Return the rows that are looked at, in their order."""
    return rows.take(np.arange(0, len(rows), -(-len(rows) // MOST)))
