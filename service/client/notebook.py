"""Answers for notebooks: small HTML tables, and named columns for pandas."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

# The column names of a CSV export.
WRENCH_COLUMNS = ("fx [N]", "fy [N]", "fz [N]", "mx [N*m]", "my [N*m]", "mz [N*m]")
DISPLACEMENT_COLUMNS = ("ux [m]", "uy [m]", "uz [m]", "rx [rad]", "ry [rad]", "rz [rad]")
ERROR_COLUMNS = tuple(f"error {name}" for name in DISPLACEMENT_COLUMNS)
SHOWN = 10  # rows of an HTML table: a notebook shows no more at once


def html_table(caption: str, names: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return an HTML table with its text escaped; the floats have six digits."""
    head = "".join(f"<th>{escape(name)}</th>" for name in names)
    body = "".join(
        f"<tr>{''.join(f'<td>{escape(_text(cell))}</td>' for cell in row)}</tr>" for row in rows
    )
    return (
        f"<table><caption>{escape(caption)}</caption>"
        f"<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
    )


def named_columns(names: Sequence[str], block: Floats) -> dict[str, Floats]:
    """Return the columns of a block, shape (n, names), by names with units."""
    return dict(zip(names, block.T, strict=True))


def _text(cell: object) -> str:
    if isinstance(cell, float):
        return "" if np.isnan(cell) else f"{cell:.6g}"
    return "" if cell is None else str(cell)
