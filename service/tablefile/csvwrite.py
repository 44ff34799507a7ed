"""Write a table as CSV text that `read_csv` reads back to the same numbers."""

from __future__ import annotations

import csv
import io
from typing import TYPE_CHECKING

import numpy as np

from service.tablefile import header as head
from service.tablefile.units import Quantity, chosen_units

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import ArrayLike


def write_csv(
    wrench: ArrayLike,
    displacement: ArrayLike,
    *,
    uncertainty: ArrayLike | None = None,
    source: Sequence[str] | None = None,
    note: Sequence[str] | None = None,
    units: Mapping[str, str] | None = None,
) -> str:
    """Write rows as CSV with units in the header.

    Parameters
    ----------
    wrench : array_like
        Shape (n, 6), N and N·m.
    displacement : array_like
        Shape (n, 6), m and rad.
    uncertainty : array_like, optional
        Shape (n, 6), m and rad; NaN is left empty. The columns are there only if one is known.
    source, note : sequence of str, optional
        One a row. A column is there only if one is not empty.
    units : mapping, optional
        Any of ``force``, ``moment``, ``translation``, ``rotation`` to the unit to write in, such as
        ``{"force": "lbf", "translation": "mm"}``; SI otherwise. In SI each number is written with
        the digits that give back the same float; in another unit it may move by its last bit.

    Returns
    -------
    str
        Lines end in a line feed.

    Raises
    ------
    UnitError
        If a unit does not measure its quantity.
    """
    chosen = chosen_units(units)
    labels: list[str] = []
    columns: list[Sequence[object]] = []
    for names, block in (
        (head.WRENCH, wrench),
        (head.DISPLACEMENT, displacement),
        (head.UNCERTAINTY, uncertainty),
    ):
        values = np.asarray(block, dtype=float) if block is not None else np.empty((0, 6))
        if names is head.UNCERTAINTY and not np.isfinite(values).any():
            continue
        labels += [f"{name} [{chosen[head.quantity_of(name)][0]}]" for name in names]
        columns += _columns(names, values, chosen)
    for name, texts in (("source", source), ("note", note)):
        if texts is not None and any(texts):
            labels.append(name)
            columns.append(texts)
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(labels)
    writer.writerows(zip(*columns, strict=True))
    return out.getvalue()


def _columns(
    names: Sequence[str], values: np.ndarray, chosen: dict[Quantity, tuple[str, float]]
) -> list[Sequence[object]]:
    """Return six columns of Python floats in the chosen units, an empty text for each NaN."""
    columns: list[Sequence[object]] = []
    for index, name in enumerate(names):
        column = values[:, index] / chosen[head.quantity_of(name)][1]
        known = column.tolist()
        if np.isnan(column).any():
            known = ["" if number != number else number for number in known]
        columns.append(known)
    return columns
