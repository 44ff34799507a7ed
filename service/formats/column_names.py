"""Names and units of columns: the spellings in files, and the columns of an export.

A column has one name, one unit and many spellings: ``Fz [N]``, ``Force_z``, ``Fz/N``, ``uz_mm``. A
spelling of two quantities (``Tx`` is a torque to a sensor, a translation to a tracker) needs a unit
that tells which.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from decimal import Decimal
from typing import Any, Protocol

import numpy as np

from wrenchbook.service.formats.units import (
    FORCE,
    MOMENT,
    ROTATION,
    TIME,
    TRANSLATION,
    Quantity,
    UnitError,
    chosen_units,
    in_unit,
    quotient,
    si_factor,
)

WRENCH = ("fx", "fy", "fz", "mx", "my", "mz")
DISPLACEMENT = ("ux", "uy", "uz", "rx", "ry", "rz")
UNCERTAINTY = tuple(f"{name}_err" for name in DISPLACEMENT)
COMPLIANCE = tuple(f"d{output}/d{load}" for output in DISPLACEMENT for load in WRENCH)
TEXTS = ("source", "note", "fingerprint")
NUMBERS = (*WRENCH, *DISPLACEMENT, *UNCERTAINTY, *COMPLIANCE)
TIME_COLUMN = "time"
MOST_LABEL = 200  # characters; a longer label is a title, and takes seconds to read
ORIGIN = ("row", "when", "who")  # columns of an export that an import ignores

COVERAGE_FACTOR = Decimal(2)
"""From a standard uncertainty to an interval of 95 %: k = 2 (JCGM 100:2008, G.6.6)."""

_QUANTITY: dict[str, Quantity] = {
    name: (FORCE, MOMENT, TRANSLATION, ROTATION, TRANSLATION, ROTATION)[index // 3]
    for index, name in enumerate((*WRENCH, *DISPLACEMENT, *UNCERTAINTY))
} | {TIME_COLUMN: TIME}
# The synonyms of column names; a direction follows.
_SYNONYMS = {
    "f": ("f", "force", "kraft"),
    "m": ("m", "moment", "torque", "t", "drehmoment"),
    "u": ("u", "d", "disp", "displacement", "translation", "trans", "t", "deflection"),
    "r": ("r", "rot", "rotation", "theta", "phi"),
}
_NAMES: dict[str, set[str]] = {}
for _letter, _spellings in _SYNONYMS.items():
    for _spelling in _spellings:
        for _direction in "xyz":
            _NAMES.setdefault(_spelling + _direction, set()).add(_letter + _direction)
for _spelling in ("time", "timestamp", "t", "zeit"):
    _NAMES[_spelling] = {TIME_COLUMN}
# Words after the name of a displacement: its 95 % half width, or its standard uncertainty.
_HALF_WIDTH = ("err", "error", "unc", "uncertainty", "u95")
_STANDARD = ("std", "sd", "sigma")
_BRACKETED = re.compile(r"(?P<name>[^\[\](]*?)\s*(?:\[(?P<a>[^\[\]]*)\]|\((?P<b>[^()\[\]]*)\))?")
_GAP = re.compile(r"[\s_./,-]+")
_RATE = re.compile(r"(?i)(time|zeit)\s+\d+ - [^\[\]()]+")  # catman: Zeit  1 - Standardmessrate


def quantity_of(name: str) -> Quantity:
    """Return the quantity of a load, displacement or uncertainty column."""
    return _QUANTITY[name]


def tangent_quantities(name: str) -> tuple[Quantity, Quantity]:
    """Return the quantities over and under the stroke of a tangent column such as ``dux/dfx``."""
    output, load = name.split("/")
    return _QUANTITY[output[1:]], _QUANTITY[load[1:]]


def over(upper: str, lower: str) -> str:
    """Return the unit of a tangent column: ``mm/lbf``, ``mm/(lbf*in)``."""
    return f"{upper}/{lower}" if lower.isalpha() else f"{upper}/({lower})"


def split(label: str) -> tuple[str, str]:
    """Return the name of a label and the unit in its brackets, empty if there are none.

    Raises
    ------
    UnitError
        If the label has brackets elsewhere than at its end.
    """
    match = _BRACKETED.fullmatch(label)
    if match is None or not match["name"]:
        raise UnitError("is not of the form name [unit], such as fx [N]")
    return match["name"], (match["a"] or match["b"] or "").strip()


def readings(label: str) -> Iterator[tuple[str, str, Decimal]]:
    """Yield the meanings of a label: the name of a column, its unit as written, a further factor.

    The unit is empty if the label has none. A label that begins with no name of a column, or is
    longer than `MOST_LABEL`, has no meaning.
    """
    if len(label) > MOST_LABEL:
        return
    name, unit = split(label)
    if _RATE.fullmatch(name):
        yield TIME_COLUMN, unit, Decimal(1)
        return
    if name.lower() in (*TEXTS, *COMPLIANCE):
        yield name.lower(), unit, Decimal(1)
        return
    for end in sorted({len(name), *(gap.start() for gap in _GAP.finditer(name))}, reverse=True):
        rest, last = _split_uncertainty(name[end:].lstrip(" _./,-"))
        found = sorted(_columns(name[:end] + last))
        rest = rest.removeprefix("(").removesuffix(")").replace("_", "*")
        if not found or (unit and rest):
            continue
        yield from ((column, unit or rest, factor) for column, factor in found)


def _split_uncertainty(rest: str) -> tuple[str, str]:
    """Split ``mm_err`` into ``mm`` and ``_err``; the latter is empty without such a word."""
    words = _GAP.split(rest)
    if len(words) < 2 or words[-1].lower() not in (*_HALF_WIDTH, *_STANDARD):
        return rest, ""
    return rest[: -len(words[-1]) - 1], f"_{words[-1]}"


def _columns(name: str) -> set[tuple[str, Decimal]]:
    """Return the columns that a name without a unit can mean, each with its factor."""
    words = [word.lower() for word in _GAP.split(name) if word]
    joined = "".join(words)
    if joined in _NAMES:
        return {(column, Decimal(1)) for column in _NAMES[joined]}
    if len(words) < 2 or words[-1] not in (*_HALF_WIDTH, *_STANDARD):
        return set()
    factor = Decimal(1) if words[-1] in _HALF_WIDTH else COVERAGE_FACTOR
    of = _NAMES.get("".join(words[:-1]), set())
    return {(f"{column}_err", factor) for column in of if column in DISPLACEMENT}


def factor_of(name: str, unit: str) -> Decimal:
    """Return the factor from a unit of the column `name` to SI; raises UnitError."""
    if name in TEXTS:
        return Decimal(1)
    if name not in COMPLIANCE:
        return si_factor(unit, _QUANTITY[name])
    upper, _, lower = unit.partition("/")
    output, load = tangent_quantities(name)
    lower = lower.strip().removeprefix("(").removesuffix(")")
    if not lower:
        raise UnitError(f"[{unit}] is not a unit over a unit; write for example {examples(name)}")
    return quotient(si_factor(upper.strip(), output), si_factor(lower, load))


def examples(name: str) -> str:
    """Return the name of a column with units that it may have."""
    if name in COMPLIANCE:
        output, load = tangent_quantities(name)
        return f"{name} [{over(output.si, load.si)}]"
    return ", ".join(f"{name} [{unit}]" for unit in _QUANTITY[name].examples[:3])


class WritableRows(Protocol):
    """Rows that can be written: a `ParsedTable`, the rows of a surrogate, any of this form.

    ``note``, ``fingerprint``, ``seq``, ``when`` and ``who``, one a row, are optional.
    """

    @property
    def wrench(self) -> np.ndarray:
        """Shape (n, 6), N and N·m."""
        ...

    @property
    def displacement(self) -> np.ndarray:
        """Shape (n, 6), m and rad; NaN where not measured."""
        ...

    @property
    def uncertainty(self) -> np.ndarray:
        """Shape (n, 6), m and rad; NaN where unknown."""
        ...

    @property
    def compliance(self) -> np.ndarray:
        """Shape (n, 6, 6), m and rad over N and N·m; NaN where unknown."""
        ...

    @property
    def source(self) -> Iterable[str]:
        """The origin of each row."""
        ...


@dataclass(frozen=True)
class NumberColumn:
    """A column of numbers: its name, its array and its index there, its unit and SI factor."""

    name: str
    block: str
    index: int
    unit: str
    factor: Decimal

    @property
    def label(self) -> str:
        """The text in the header."""
        return f"{self.name} [{self.unit}]"

    def values(self, rows: WritableRows) -> np.ndarray:
        """Return the column, shape (n,), SI, NaN where unknown."""
        block = getattr(rows, self.block)
        return block.reshape(len(block), int(np.prod(block.shape[1:])))[:, self.index]

    def digits(self, rows: WritableRows) -> list[str]:
        """Return the column in its unit, as digits that an import reads to the same floats."""
        factor = self.factor
        return ["" if v != v else in_unit(v, factor) for v in self.values(rows).tolist()]


@dataclass(frozen=True)
class Layout:
    """The columns of an export: numbers, then texts."""

    numbers: tuple[NumberColumn, ...]
    texts: tuple[str, ...]

    def labels(self) -> list[str]:
        """Return the header."""
        return [*(column.label for column in self.numbers), *self.texts]

    def words(self, rows: Any) -> list[list[str]]:
        """Return the columns of texts."""
        names = ["seq" if name == "row" else name for name in self.texts]
        return [[str(word) for word in getattr(rows, name)] for name in names]


def layout(
    uncertainty: bool,
    compliance: bool,
    texts: Iterable[str],
    units: Mapping[str, str] | None = None,
    *,
    origin: bool = False,
) -> Layout:
    """Return the columns of an export.

    Parameters
    ----------
    uncertainty, compliance : bool
        Whether any row has one.
    texts : iterable of str
        Of ``source``, ``note`` and ``fingerprint``.
    units : mapping, optional
        From ``force``, ``moment``, ``translation``, ``rotation`` to the unit to write in; SI
        otherwise.
    origin : bool
        Whether number, time and sender of each row are columns.

    Raises
    ------
    UnitError
        If a unit does not measure its quantity.
    """
    chosen = chosen_units(units)
    blocks = [("wrench", WRENCH), ("displacement", DISPLACEMENT)]
    blocks += [("uncertainty", UNCERTAINTY)] if uncertainty else []
    blocks += [("compliance", COMPLIANCE)] if compliance else []
    numbers = tuple(
        NumberColumn(name, block, index, *_export_unit(name, chosen))
        for block, names in blocks
        for index, name in enumerate(names)
    )
    return Layout(numbers, (*texts, *(ORIGIN if origin else ())))


def _export_unit(name: str, chosen: Mapping[Quantity, tuple[str, Decimal]]) -> tuple[str, Decimal]:
    """Return the unit that a column is written in, and its SI factor."""
    if name not in COMPLIANCE:
        return chosen[quantity_of(name)]
    (upper, above), (lower, below) = (chosen[of] for of in tangent_quantities(name))
    return over(upper, lower), quotient(above, below)
