"""What stands in which column of an export: names, units, and the texts beside the numbers."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from typing import Any, Protocol

import numpy as np

from service.formats.exact import in_unit, quotient
from service.formats.parsed import TableRows, texts_of
from service.formats.spelling import (
    CARRIED,
    COMPLIANCE,
    DISPLACEMENT,
    UNCERTAINTY,
    WRENCH,
    over,
    quantity_of,
    tangent_quantities,
)
from service.formats.units import Quantity, chosen_units

_Chosen = dict[Quantity, tuple[str, Decimal]]


class ExportRows(TableRows, Protocol):
    """Rows as an export has them: with their texts, and where they came from."""

    note: Sequence[str]
    fingerprint: Sequence[str]
    seq: Sequence[int]
    when: Sequence[str]
    who: Sequence[str]


@dataclass(frozen=True)
class NumberColumn:
    """A column of numbers: its name, its place in its block, its unit and what one is in SI."""

    name: str
    block: str
    place: int
    unit: str
    factor: Decimal

    @property
    def label(self) -> str:
        """What the header says."""
        return f"{self.name} [{self.unit}]"

    def values(self, rows: TableRows) -> np.ndarray:
        """Return the column in SI, shape (n,), NaN where not known."""
        block = getattr(rows, self.block)
        return block.reshape(len(block), int(np.prod(block.shape[1:])))[:, self.place]

    def digits(self, rows: TableRows) -> list[str]:
        """Return the column in its unit, with the digits that come back; empty where not known."""
        factor = self.factor
        return ["" if v != v else in_unit(v, factor) for v in self.values(rows).tolist()]


@dataclass(frozen=True)
class Layout:
    """The columns of an export.

    Attributes
    ----------
    numbers : tuple of NumberColumn
    texts : tuple of str
        Of source, note and fingerprint those that say anything, then what rows carry along.
    """

    numbers: tuple[NumberColumn, ...]
    texts: tuple[str, ...]

    def labels(self) -> list[str]:
        """Return the header."""
        return [*(column.label for column in self.numbers), *self.texts]

    def words(self, rows: Any) -> list[list[str]]:
        """Return the columns of texts."""
        return [[str(word) for word in getattr(rows, _FIELD.get(t, t))] for t in self.texts]


_FIELD = {"row": "seq"}


def layout_of(table: TableRows, units: Mapping[str, str] | None = None) -> Layout:
    """Return the columns that a table of rows needs: none that says nothing."""
    blocks = [bool(np.isfinite(column).any()) for column in (table.uncertainty, table.compliance)]
    return layout(blocks[0], blocks[1], tuple(texts_of(table)), units)


def layout(
    uncertainty: bool,
    compliance: bool,
    texts: Iterable[str],
    units: Mapping[str, str] | None = None,
    *,
    carried: bool = False,
) -> Layout:
    """Return the columns of an export.

    Parameters
    ----------
    uncertainty, compliance : bool
        Whether any row has one.
    texts : iterable of str
        Of ``source``, ``note`` and ``fingerprint``.
    units : mapping, optional
        Any of ``force``, ``moment``, ``translation``, ``rotation`` to the unit to write in; SI
        otherwise.
    carried : bool
        Whether the rows' numbers, times and senders are columns as well.

    Raises
    ------
    UnitError
        If a unit does not measure its quantity.
    """
    chosen = chosen_units(units)
    blocks: list[tuple[str, tuple[str, ...]]] = [
        ("wrench", WRENCH),
        ("displacement", DISPLACEMENT),
    ]
    blocks += [("uncertainty", UNCERTAINTY)] if uncertainty else []
    blocks += [("compliance", COMPLIANCE)] if compliance else []
    numbers = tuple(
        NumberColumn(name, block, place, *_unit(name, chosen))
        for block, names in blocks
        for place, name in enumerate(names)
    )
    return Layout(numbers, (*texts, *(CARRIED if carried else ())))


def _unit(name: str, chosen: _Chosen) -> tuple[str, Decimal]:
    """Return the unit a column is written in, and its SI factor."""
    if name not in COMPLIANCE:
        return chosen[quantity_of(name)]
    (upper, above), (lower, below) = (chosen[of] for of in tangent_quantities(name))
    return over(upper, lower), quotient(above, below)
