"""Write a table as CSV text that `read_csv` reads back to the same numbers."""

from __future__ import annotations

import csv
from typing import TYPE_CHECKING

import numpy as np

from service.tablefile import header as head
from service.tablefile.parsed import TableRows, texts_of
from service.tablefile.units import Quantity, chosen_units

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence


def write_csv(table: TableRows, units: Mapping[str, str] | None = None) -> str:
    """Write rows as CSV with units in the header.

    Parameters
    ----------
    table : TableRows
        Rows in SI. Uncertainty columns are there only if one is known (NaN is left empty), source,
        note and fingerprint only if one is not empty.
    units : mapping, optional
        Any of ``force``, ``moment``, ``translation``, ``rotation`` to the unit to write in, such as
        ``{"force": "lbf", "translation": "mm"}``; SI otherwise. In SI each number is written with
        the digits that give back the same float; in another unit it may move by its last bits.

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
    blocks = [(head.WRENCH, table.wrench), (head.DISPLACEMENT, table.displacement)]
    if np.isfinite(table.uncertainty).any():
        blocks.append((head.UNCERTAINTY, table.uncertainty))
    for names, values in blocks:
        labels += [f"{name} [{chosen[head.quantity_of(name)][0]}]" for name in names]
        columns += _columns(names, values, chosen)
    for name, texts in texts_of(table).items():
        labels.append(name)
        columns.append(texts)
    out = _Lines()
    writer = csv.writer(out, lineterminator="\r\n")
    writer.writerow(labels)
    writer.writerows(zip(*columns, strict=True))
    return "".join(out)


class _Lines(list[str]):
    r"""Collects lines that end in ``\n``, from a writer that ends them in ``\r\n``.

    Python's writer quotes a text with a carriage return only if the line end has one.
    """

    def write(self, line: str) -> None:
        self.append(line.removesuffix("\r\n") + "\n")


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
