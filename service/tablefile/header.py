"""The header of a CSV table: which column is which, and in which unit.

One form only: ``name [unit]`` (round brackets do as well). Names, in any case: ``fx fy fz mx my
mz`` (missing ones are zero loads), ``ux uy uz rx ry rz`` (at least one; a missing one, or an empty
field, was not measured), ``ux_err`` ... ``rz_err`` (standard uncertainty or error bound, optional),
``dux/dfx [m/N]`` ... ``drz/dmz [rad/(N*m)]`` (the 36 tangents of a solve, all or none) and
``source``, ``note``, ``fingerprint`` (text, no unit; the fingerprint names the setup that a solve
was made with). Every number column names its unit: a rotation without one may be radians or
degrees, and a guess would be loaded without a word. An unknown column is a mistake, because a
misspelt load would count as zero.
"""

from __future__ import annotations

import difflib
import re
from dataclasses import dataclass, field
from decimal import Decimal

from service.tablefile.exact import quotient
from service.tablefile.parsed import RowError
from service.tablefile.units import (
    FORCE,
    MOMENT,
    ROTATION,
    TRANSLATION,
    Quantity,
    UnitError,
    si_factor,
)

WRENCH = ("fx", "fy", "fz", "mx", "my", "mz")
DISPLACEMENT = ("ux", "uy", "uz", "rx", "ry", "rz")
UNCERTAINTY = tuple(f"{name}_err" for name in DISPLACEMENT)
COMPLIANCE = tuple(f"d{output}/d{load}" for output in DISPLACEMENT for load in WRENCH)
TEXTS = ("source", "note", "fingerprint")
NUMBERS = (*WRENCH, *DISPLACEMENT, *UNCERTAINTY, *COMPLIANCE)

_QUANTITY: dict[str, Quantity] = {
    name: (FORCE, MOMENT, TRANSLATION, ROTATION, TRANSLATION, ROTATION)[index // 3]
    for index, name in enumerate((*WRENCH, *DISPLACEMENT, *UNCERTAINTY))
}
_CELL = re.compile(
    r"(?P<name>[^\[\](]*?)\s*(?:\[(?P<square>[^\[\]]*)\]|\((?P<round>[^()\[\]]*)\))?"
)


@dataclass(frozen=True)
class Column:
    """One column: its place in a line, its name as written, its SI factor (1 for text)."""

    place: int
    label: str
    name: str
    factor: Decimal = Decimal(1)


@dataclass
class Header:
    """The columns by name, how many fields a line has, and what is wrong with the header."""

    width: int
    columns: dict[str, Column] = field(default_factory=dict)
    errors: list[RowError] = field(default_factory=list)


def quantity_of(name: str) -> Quantity:
    """Return what the load, displacement or uncertainty column `name` measures."""
    return _QUANTITY[name]


def tangent_quantities(name: str) -> tuple[Quantity, Quantity]:
    """Return what the tangent column `name`, such as ``dux/dfx``, measures over what."""
    output, load = name.split("/")
    return _QUANTITY[output[1:]], _QUANTITY[load[1:]]


def over(upper: str, lower: str) -> str:
    """Write a unit over a unit, as a tangent column's: ``mm/lbf``, ``mm/(lbf*in)``."""
    return f"{upper}/{lower}" if lower.isalpha() else f"{upper}/({lower})"


def read_header(cells: list[str], line: int) -> Header:
    """Read the header line; all mistakes are collected in `Header.errors`.

    Parameters
    ----------
    cells : list of str
        The fields of the line.
    line : int
        Where it stands in the file, from 1.
    """
    labels = [" ".join(cell.split()) for cell in cells]
    while labels and not labels[-1]:  # a spreadsheet's empty columns on the right
        labels.pop()
    header = Header(width=len(labels))
    for place, label in enumerate(labels):
        try:
            column = _column(place, label)
        except UnitError as error:
            header.errors.append(RowError(line, label or f"column {place + 1}", str(error)))
            continue
        if column.name in header.columns:
            header.errors.append(RowError(line, label, f"{column.name} stands twice; keep one"))
        header.columns[column.name] = column
    _complete(header, line, labels)
    return header


def _column(place: int, label: str) -> Column:
    """Read one cell of the header, or say in a UnitError why it is none."""
    match = _CELL.fullmatch(label)
    if match is None or not match["name"]:
        raise UnitError("is not of the form name [unit], such as fx [N]")
    name, unit = match["name"].lower(), match["square"] or match["round"] or ""
    if name in TEXTS:
        return Column(place, label, name)
    if name not in NUMBERS:
        raise UnitError(_unknown(name))
    if not unit.strip():
        raise UnitError(f"has no unit; write for example {_examples(name)}")
    return Column(place, label, name, _factor(name, unit.strip()))


def _factor(name: str, unit: str) -> Decimal:
    """Return what one `unit` of the column `name` is in SI."""
    if name not in COMPLIANCE:
        return si_factor(unit, _QUANTITY[name])
    upper, _, lower = unit.partition("/")
    output, load = tangent_quantities(name)
    lower = lower.strip().removeprefix("(").removesuffix(")")
    if not lower:
        raise UnitError(f"[{unit}] is not a unit over a unit; write for example {_examples(name)}")
    return quotient(si_factor(upper.strip(), output), si_factor(lower, load))


def _examples(name: str) -> str:
    if name in COMPLIANCE:
        output, load = tangent_quantities(name)
        return f"{name} [{over(output.si, load.si)}]"
    return ", ".join(f"{name} [{unit}]" for unit in _QUANTITY[name].examples[:3])


def _unknown(name: str) -> str:
    """Say that a column is not known, with the nearest one that is."""
    near = difflib.get_close_matches(name, (*NUMBERS, *TEXTS), n=1, cutoff=0.6)
    hint = f"; did you mean {near[0]}? Units stand in brackets: fx [N]" if near else ""
    return (
        f"is not a column of a table{hint}. Rename or remove it; there are {' '.join(WRENCH)} "
        f"{' '.join(DISPLACEMENT)}, a displacement's with _err, {COMPLIANCE[0]} ... "
        f"{COMPLIANCE[-1]}, source, note, fingerprint"
    )


def _complete(header: Header, line: int, labels: list[str]) -> None:
    """Add what is missing from the whole: a load, or a displacement column."""
    # A column with a faulty unit is there; saying that it is missing too would mislead.
    named = {re.split(r"[\s\[(]", label.lower(), maxsplit=1)[0] for label in labels}
    if not named & set(DISPLACEMENT):
        message = "no displacement column; name at least one of " + ", ".join(
            f"{name} [{_QUANTITY[name].examples[0]}]" for name in DISPLACEMENT
        )
        header.errors.append(RowError(line, "header", message))
    if not named & set(WRENCH):
        message = "no load column; name at least one of " + ", ".join(
            f"{name} [{_QUANTITY[name].examples[0]}]" for name in WRENCH
        )
        header.errors.append(RowError(line, "header", message))
