"""Names and units of columns: the spellings in files, and the columns of an export.

A column has one name, one unit and many spellings: ``Fz [N]``, ``Force_z``, ``Fz/N``, ``uz_mm``. A
spelling of two quantities (``Tx`` is a torque to a sensor, a translation to a tracker) needs a unit
that tells which. A component of several interfaces has their names before those of loads and
displacements: ``left.Fx [N]``. Further inputs have the names of the component's space.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from itertools import combinations_with_replacement, product
from typing import Any, NamedTuple, Protocol

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
    further_quantity,
    in_unit,
    si_factor,
)
from wrenchbook.surrogate.table.space import DEFAULT, LOADS, OUTPUTS, Space

WRENCH, DISPLACEMENT = LOADS, OUTPUTS
TEXTS = ("source", "note", "fingerprint")
ARRAYS = ("wrench", "displacement", "uncertainty", "compliance", "curvature")  # of `Columns`
TIME_COLUMN = "time"
MAX_COLUMNS = 256  # an unknown name is compared with all known ones: 0.3 ms each
MAX_LABEL = 200  # characters; a longer label is a title, and takes seconds to read
ORIGIN = ("row", "when", "who")  # columns of an export that an import ignores
# From a standard uncertainty to an interval of 95 %: k = 2 (JCGM 100:2008, G.6.6).
COVERAGE_FACTOR = 2.0

_LETTERS = {"f": FORCE, "m": MOMENT, "u": TRANSLATION, "r": ROTATION}
# The synonyms of column names; a direction follows.
_SYNONYMS = {
    "f": ("f", "force", "kraft"),
    "m": ("m", "moment", "torque", "t", "drehmoment"),
    "u": (
        *("u", "d", "disp", "displacement", "translation", "trans", "t", "deflection"),
        *("weg", "verschiebung"),
    ),
    "r": ("r", "rot", "rotation", "theta", "phi", "angle", "winkel", "verdrehung"),
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
_BRACKETED = re.compile(  # a name may hold brackets: Tensile strain (Extension) [mm/mm]
    r"(?P<name>[^\[\](]*?(?:\([^()\[\]]*\)[^\[\](]*?)*?)"
    r"\s*(?:\[(?P<a>[^\[\]]*)\]|\((?P<b>[^()\[\]]*)\))?"
)
_GAP = re.compile(r"[\s_./,-]+")
_RATE = re.compile(r"(?i)(time|zeit)\s+\d+ - [^\[\]()]+")  # catman: Zeit  1 - Standardmessrate


def over(upper: str, lower: str) -> str:
    """Return the unit of a tangent column: ``mm/lbf``, ``mm/(lbf*in)``."""
    return f"{upper}/{lower}" if lower.isalpha() else f"{upper}/({lower})"


def split(label: str) -> tuple[str, str]:
    """Return the name of a label and the unit in brackets at its end, or empty; UnitError."""
    match = _BRACKETED.fullmatch(label)
    if match is None or not match["name"]:
        name, opening, unit = label.partition("[")
        if name.strip() and opening and "]" not in unit and "[" not in unit:
            complete = f"{name.strip()} [{unit.strip()}]"
            raise UnitError(f'"{label}" lacks its closing bracket; write {complete}')
        raise UnitError("must have the form name [unit]; write for example fx [N]")
    return match["name"], (match["a"] or match["b"] or "").strip()


class Reading(NamedTuple):
    """A meaning of a label."""

    column: str
    unit: str  # as written; may be empty
    factor: float  # 2 from a standard uncertainty to the 95 % half width, else 1


class Columns:
    """The columns of numbers of a table, by the names of its space.

    `wrench` are all inputs: `loads` and `further` ones. Of each of `displacement` there is a 95 %
    half width in `uncertainty` and over each input a tangent in `compliance`. `curvature` has third
    derivatives of the complementary energy e in the order of `Rows.curvature`, always in SI:
    ``d3e/dfx/dfx/dmz [J/(N*N*N*m)]``, where m stands for mu. `numbers` are all but these; a file
    has `max_count` columns at most.
    """

    def __init__(self, space: Space) -> None:
        scalars = {item.name: item.unit for item in space.inputs if item.kind == "scalar"}
        self.space = space
        self.wrench = space.input_names
        self.displacement = space.output_names
        self.loads = tuple(name for name in self.wrench if name not in scalars)
        self.further = tuple(scalars)
        self.uncertainty = tuple(f"{name}_err" for name in self.displacement)
        pairs = product(self.displacement, self.wrench)
        self._tangents = {f"d{output}/d{item}": (output, item) for output, item in pairs}
        self.compliance = tuple(self._tangents)
        self.numbers = (*self.wrench, *self.displacement, *self.uncertainty, *self.compliance)
        triples = combinations_with_replacement(self.wrench, 3)
        self._curvatures = {"/d".join(("d3e", *inputs)): inputs for inputs in triples}
        self.curvature = tuple(self._curvatures)
        self.max_count = max(MAX_COLUMNS, 2 * len(self.numbers) + len(self.curvature))
        # The columns that have one spelling.
        single = *TEXTS, *self.compliance, *self.curvature, *scalars
        self._exact = {name.lower(): name for name in single}
        self._quantities = {name: further_quantity(name, unit) for name, unit in scalars.items()}
        self._quantities[TIME_COLUMN] = TIME
        # Patterns of the interfaces' names before a column's, the longest first.
        names = sorted(filter(None, space.interfaces), key=len, reverse=True)
        self._prefixes = {name: re.compile(re.escape(name) + _GAP.pattern, re.I) for name in names}

    def quantity(self, name: str) -> Quantity:
        """Return the quantity of an input, displacement or uncertainty column."""
        return self._quantities.get(name) or _LETTERS[name.rpartition(".")[2][0]]

    def readings(self, label: str) -> Iterator[Reading]:
        """Yield the meanings of a label; UnitError."""
        if len(label) > MAX_LABEL:
            return
        name, unit = split(label)
        if _RATE.fullmatch(name):
            yield Reading(TIME_COLUMN, unit, 1.0)
            return
        if name.lower() in self._exact:
            yield Reading(self._exact[name.lower()], unit, 1.0)
            return
        joined = "".join(_GAP.split(name)).lower()
        for item in self.further:
            if joined in self.quantity(item).spellings:
                yield Reading(item, unit, 1.0)
        prefixes = self._prefixes.items()
        interface = next((item for item, prefix in prefixes if prefix.match(name)), "")
        bare = self._prefixes[interface].sub("", name, 1) if interface else name
        for reading in _readings_without_interface(bare, unit):
            is_time = reading.column == TIME_COLUMN
            if not prefixes or (is_time and not interface):
                yield reading
            elif interface and not is_time:
                yield reading._replace(column=f"{interface}.{reading.column}")

    def interface_problem(self, name: str) -> str:
        """Return the mistake in the interface of a load's or output's name, if there is one."""
        if not self._prefixes or len(name) > MAX_LABEL:
            return ""
        interface, _, rest = name.rpartition(".")
        columns = (reading.column for reading in _readings_without_interface(rest, ""))
        column = next((column for column in columns if column != TIME_COLUMN), "")
        if not column:
            return ""
        problem = f"names an unknown interface {interface!r}" if interface else "names no interface"
        known = self.space.interfaces
        return f"{problem}; choose one of {', '.join(known)}, for example {known[0]}.{column}"

    def factor(self, name: str, unit: str) -> float:
        """Return the factor from a unit of the column `name` to that of the table; UnitError."""
        if name in TEXTS:
            return 1.0
        if name in self._curvatures:
            if unit != self.unit_of_curvature(name):
                raise UnitError(f"must be in SI, not in [{unit}]; write {self.examples(name)}")
            return 1.0
        if name not in self._tangents:
            return si_factor(unit, self.quantity(name))
        upper, _, lower = unit.partition("/")
        output, load = map(self.quantity, self._tangents[name])
        lower = lower.strip().removeprefix("(").removesuffix(")")
        if not lower:
            example = self.examples(name)
            raise UnitError(f"[{unit}] must be a quotient of units; write for example {example}")
        return si_factor(upper.strip(), output) / si_factor(lower, load)

    def unit_of_curvature(self, name: str) -> str:
        """Return the unit of a column of `curvature`: ``J/(N*N*N*m)``."""
        return over("J", "*".join(self.quantity(item).si for item in self._curvatures[name]))

    def zero(self, name: str, unit: str) -> float:
        """Return the zero of a unit in that of the table: 273.15 of degC in K; mostly 0."""
        scales = self.quantity(name).scales if name in self.further else ()
        return next((zero for item, _, zero in scales if item == unit), 0.0)

    def examples(self, name: str) -> str:
        """Return the name of a column with units that it may have."""
        if name in self._tangents:
            output, load = map(self.quantity, self._tangents[name])
            return f"{name} [{over(output.si, load.si)}]"
        if name in self._curvatures:
            return f"{name} [{self.unit_of_curvature(name)}]"
        return ", ".join(f"{name} [{unit}]" for unit in self.quantity(name).examples[:3])

    def example_in(self, unit: str, label: str) -> str:
        """Return a load or displacement that `unit` measures; a force if none is.

        Its direction is the last word of `label`, or z.
        """
        direction = _GAP.split(label.lower())[-1]
        direction = direction if direction in ("x", "y") else "z"
        names = [name for name in (*self.loads, *self.displacement) if name.endswith(direction)]
        for name in names:
            with suppress(UnitError):
                if unit and self.factor(name, unit):
                    return f"{name} [{unit}]"
        return self.examples(names[0]).split(", ")[0]


@cache
def columns_of(space: Space = DEFAULT) -> Columns:
    """Return the columns of a space."""
    return Columns(space)


def _readings_without_interface(name: str, unit: str) -> Iterator[Reading]:
    """Yield the meanings of a name without its interface; see `Columns.readings`.

    The name may end in its unit, before or after it in the ending of an uncertainty: ``ux_mm_err``.
    """
    ends = {len(name), *(gap.start() for gap in _GAP.finditer(name))}
    for end in sorted(ends, reverse=True):
        after, ending = _split_ending(name[end:].lstrip(" _./,-"))
        columns = sorted(_columns_named(name[:end] + ending))
        unit_in_name = after.removeprefix("(").removesuffix(")").replace("_", "*")
        if unit and unit_in_name:
            continue
        for column, factor in columns:
            yield Reading(column, unit or unit_in_name, factor)


def _split_ending(text: str) -> tuple[str, str]:
    """Return a unit and the ending of an uncertainty after it: ``mm``, ``_err`` of ``mm - err``."""
    gaps = list(_GAP.finditer(text))
    if gaps and text[gaps[-1].end() :].lower() in (*_HALF_WIDTH, *_STANDARD):
        return text[: gaps[-1].start()], f"_{text[gaps[-1].end() :]}"
    return text, ""


def _columns_named(name: str) -> set[tuple[str, float]]:
    """Return the columns that a name without a unit can mean, each with its factor."""
    parts = [word.lower() for word in _GAP.split(name) if word]
    joined = "".join(parts)
    if joined in _NAMES:
        return {(column, 1.0) for column in _NAMES[joined]}
    if len(parts) < 2 or parts[-1] not in (*_HALF_WIDTH, *_STANDARD):
        return set()
    factor = 1.0 if parts[-1] in _HALF_WIDTH else COVERAGE_FACTOR
    of = _NAMES.get("".join(parts[:-1]), set())
    return {(f"{column}_err", factor) for column in of if column in DISPLACEMENT}


class WritableRows(Protocol):
    """Rows to write; also with `curvature`, `note`, `fingerprint`, `seq`, `when`, `who`."""

    @property
    def wrench(self) -> np.ndarray: ...  # noqa: D102
    @property
    def displacement(self) -> np.ndarray: ...  # noqa: D102
    @property
    def uncertainty(self) -> np.ndarray: ...  # noqa: D102
    @property
    def compliance(self) -> np.ndarray: ...  # noqa: D102
    @property
    def source(self) -> Iterable[str]: ...  # noqa: D102


@dataclass(frozen=True)
class NumberColumn:
    """A column of numbers: its name, its array and its index there, its unit and SI factor."""

    name: str
    block: str
    index: int
    unit: str
    factor: float

    @property
    def label(self) -> str:
        """The text in the header."""
        return f"{self.name} [{self.unit}]"

    def values(self, rows: WritableRows) -> np.ndarray:
        """Return the column, shape (n,), SI, NaN where unknown."""
        block = getattr(rows, self.block, None)
        if block is None or not block.size:  # a curvature that no row brings
            return np.full(len(rows.wrench), np.nan)
        return block.reshape(len(block), int(np.prod(block.shape[1:])))[:, self.index]

    def digits(self, rows: WritableRows) -> list[str]:
        """Return the column in its unit as digits, empty where unknown."""
        factor = self.factor
        numbers = self.values(rows).tolist()
        return ["" if number != number else in_unit(number, factor) for number in numbers]


@dataclass(frozen=True)
class Layout:
    """The columns of an export: numbers, then texts."""

    numbers: tuple[NumberColumn, ...]
    texts: tuple[str, ...]

    def labels(self) -> list[str]:
        """Return the header."""
        return [*(column.label for column in self.numbers), *self.texts]

    def text_columns(self, rows: Any) -> list[list[str]]:
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
    space: Space = DEFAULT,
    curvature: bool = False,
) -> Layout:
    """Return the columns of an export; UnitError if a unit does not measure its quantity.

    `uncertainty`, `compliance` and `curvature` say whether any row has such numbers; `texts` are of
    ``source``, ``note`` and ``fingerprint``; with `origin` number, time and sender of each row are
    columns; `units` are by ``force``, ``moment``, ``translation``, ``rotation``, else SI.
    """
    chosen, columns = chosen_units(units), columns_of(space)

    def unit_of(name: str) -> tuple[str, float]:
        if name in columns.curvature:
            return columns.unit_of_curvature(name), 1.0
        if name in columns.compliance:
            output, _, load = name[1:].partition("/d")
            (upper, above), (lower, below) = unit_of(output), unit_of(load)
            return over(upper, lower), above / below
        quantity = columns.quantity(name)
        return chosen.get(quantity, (quantity.si, 1.0))

    blocks = {
        "wrench": columns.wrench,
        "displacement": columns.displacement,
        "uncertainty": columns.uncertainty if uncertainty else (),
        "compliance": columns.compliance if compliance else (),
        "curvature": columns.curvature if curvature else (),
    }
    numbers = tuple(
        NumberColumn(name, block, index, *unit_of(name))
        for block, names in blocks.items()
        for index, name in enumerate(names)
    )
    return Layout(numbers, (*texts, *(ORIGIN if origin else ())))
