"""Rows of one wrench: repeats that agree are merged, those that do not are reported."""

from __future__ import annotations

from typing import Any

import numpy as np

from .rows import Floats, LoadRange, Rows

SAME = 9  # decimals, in scaled loads, to which two wrenches are one
AGREE = 1e-6  # of an output's range: what rounding in a file may do
MOST_LISTED = 50


def row_conflicts(rows: Rows, load_range: LoadRange) -> dict[str, Any]:
    """Return what a coverage summary says of repeated wrenches: how many, and which disagree."""
    disagree = conflicts(rows, load_range)
    return {
        "conflicts": disagree[:MOST_LISTED],
        "conflicting_wrenches": len(disagree),
        "repeated_wrenches": len(repeated(rows, load_range)),
    }


def repeated(rows: Rows, load_range: LoadRange) -> list[np.ndarray]:
    """Return the places of each set of rows that have one wrench, ascending.

    Each has shape (k,): indices of its rows.
    """
    keys = np.round(rows.wrench / load_range.scale, SAME) + 0.0
    _, group, counts = np.unique(keys, axis=0, return_inverse=True, return_counts=True)
    group = group.reshape(-1)
    order = np.argsort(group, kind="stable")
    ends = np.cumsum(counts)
    return [order[end - count : end] for count, end in zip(counts, ends, strict=True) if count > 1]


def conflicts(rows: Rows, load_range: LoadRange) -> list[dict[str, Any]]:
    """Return the sets of rows that give one wrench different displacements, as JSON-able values.

    They differ if an output's spread is over twice the largest stored uncertainty plus a millionth
    of the output's range: no two of such rows can both be right.
    """
    if not len(rows):
        return []
    moved = rows.displacement
    size = AGREE * np.nanmax(np.abs(np.nan_to_num(moved)), axis=0)
    found = []
    for places in repeated(rows, load_range):
        spread = _spread(moved[places])
        allowed = 2 * np.nan_to_num(rows.uncertainty[places]).max(axis=0) + size
        over = np.flatnonzero(spread > allowed)
        if len(over):
            found.append(
                {
                    "rows": rows.seq[places].tolist(),
                    "wrench": dict(
                        zip(rows.space.input_names, rows.wrench[places[0]].tolist(), strict=True)
                    ),
                    "spread": {
                        rows.space.output_names[output]: float(spread[output]) for output in over
                    },
                }
            )
    return found


def _spread(moved: Floats) -> Floats:
    """Return largest less smallest of each output, shape (k, 6) -> (6,), of those measured."""
    known = np.isfinite(moved)
    high = np.where(known, moved, -np.inf).max(axis=0)
    low = np.where(known, moved, np.inf).min(axis=0)
    return np.where(known.any(axis=0), high - low, 0.0)
