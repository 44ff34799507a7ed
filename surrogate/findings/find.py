"""What rows show of the errors of their measurement."""

from __future__ import annotations

import numpy as np

from ..table.rows import LoadRange, Rows
from .contract import (
    Fit,
    lever_findings,
    linear_fit,
    range_findings,
    sign_findings,
    size_findings,
    unit_findings,
)
from .finding import RigFinding
from .response import response_of
from .sequence import sequence_findings
from .single_rows import single_row_findings, wrong_rows

FEWEST = 7  # rows: six loads and a constant
MOST = 5_000  # rows that are looked at, some 0.5 s: every k-th of more


def find(rows: Rows, load_range: LoadRange, solved: Rows | None = None) -> list[RigFinding]:
    """Return the probable systematic errors of measured rows, in the order of their measurement.

    Parameters
    ----------
    rows : Rows
        Measured rows in the order in which they were measured.
    load_range : LoadRange, N and N·m
    solved : Rows, optional
        Solved rows of the same component, which tell the size that displacements should have.
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
    units = units or unit_findings(fit, _fit_of(solved, load_range))
    # A lever can make a load's own work negative; a wrong sign or unit is no lever.
    found += units or lever_findings(fit, load_range) or sign_findings(fit)
    return [*found, *sequence_findings(good, response)]


def looked_at(rows: Rows) -> Rows:
    """Return the rows that are looked at, in their order."""
    return rows.take(np.arange(0, len(rows), -(-len(rows) // MOST)))


def _fit_of(rows: Rows | None, load_range: LoadRange) -> Fit | None:
    if rows is None or len(rows) < FEWEST:
        return None
    return linear_fit(rows, load_range, response_of(rows, load_range))
