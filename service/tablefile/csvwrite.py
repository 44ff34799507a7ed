"""Write a table as CSV text that `read_csv` reads back to the same numbers."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from decimal import Decimal

import numpy as np

from service.tablefile import header as head
from service.tablefile.exact import in_unit, quotient
from service.tablefile.parsed import TableRows, texts_of
from service.tablefile.units import Quantity, chosen_units

_Chosen = dict[Quantity, tuple[str, Decimal]]


def write_csv(table: TableRows, units: Mapping[str, str] | None = None) -> str:
    """Write rows as CSV with units in the header.

    Parameters
    ----------
    table : TableRows
        Rows in SI. Uncertainty and tangent columns are there only if one is known (NaN is left
        empty), source, note and fingerprint only if one is not empty.
    units : mapping, optional
        Any of ``force``, ``moment``, ``translation``, ``rotation`` to the unit to write in, such as
        ``{"force": "lbf", "translation": "mm"}``; SI otherwise. In every unit a number is written
        with the digits that `read_csv` turns into the same float.

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
    columns: list[Sequence[str]] = []
    for name, values in _numbers(table):
        unit, factor = _unit(name, chosen)
        labels.append(f"{name} [{unit}]")
        columns.append(
            ["" if number != number else in_unit(number, factor) for number in values.tolist()]
        )
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


def _numbers(table: TableRows) -> list[tuple[str, np.ndarray]]:
    """Return the number columns of an export by name, each of shape (n,), SI."""
    blocks = [(head.WRENCH, table.wrench), (head.DISPLACEMENT, table.displacement)]
    if np.isfinite(table.uncertainty).any():
        blocks.append((head.UNCERTAINTY, table.uncertainty))
    if np.isfinite(table.compliance).any():
        blocks.append((head.COMPLIANCE, table.compliance.reshape(-1, 36)))
    return [
        (name, values[:, index]) for names, values in blocks for index, name in enumerate(names)
    ]


def _unit(name: str, chosen: _Chosen) -> tuple[str, Decimal]:
    """Return the unit a column is written in, and its SI factor."""
    if name not in head.COMPLIANCE:
        return chosen[head.quantity_of(name)]
    (upper, above), (lower, below) = (chosen[of] for of in head.tangent_quantities(name))
    return head.over(upper, lower), quotient(above, below)
