"""The cards of a Nastran bulk data file, and the content that other cards refer to by number."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from wrenchbook.fea.mesh.io.abaqus import axes_through, cartesian, radial_axes
from wrenchbook.fea.mesh.io.abaqus_keywords import real as plain_real
from wrenchbook.fea.mesh.io.abaqus_keywords import whole
from wrenchbook.fea.mesh.io.translated import Translated
from wrenchbook.fea.spec.deck_text import DeckText
from wrenchbook.fea.spec.problems import MeshFileError

SYSTEMS = ("CORD1R", "CORD1C", "CORD1S", "CORD2R", "CORD2C", "CORD2S")
BASIC = ("", "0")
"""Numbers of the basic coordinate system."""
CD = 5
"""Field of a GRID: number of the coordinate system of the node's freedoms."""

_EXPONENT = re.compile(r"(?<=[\d.])([+-]\d+)$")  # of a number without a letter before it


class Card(NamedTuple):
    """A card with its continuations."""

    line: int  # its first line, from 1
    name: str
    fields: list[str]  # without the name


def read_cards(lines: list[str], text: DeckText, skipped: int) -> Iterator[Card]:
    """Yield each card with its continuations; `skipped` lines of the file come before the first."""
    card: Card | None = None
    for number, line in enumerate(lines, start=skipped + 1):
        line = line.partition("$")[0].expandtabs().rstrip()
        if not line:
            continue
        head, fields, count = _split(line)
        if head.upper() == "ENDDATA":
            break
        extra = [field for field in fields[count:] if field]
        # The one after the last is the name of the continuation, such as +A1.
        if any(fields[count + 1 :]) or (extra and extra[0].isdigit()):
            raise MeshFileError(
                f"line {text.place(number)}: {head} has more than {count} fields; continue with "
                f'"{extra[0]}" on a new line'
            )
        fields = (fields + [""] * count)[:count]
        if card is not None and head[:1] in ("", "+", "*"):
            card.fields.extend(fields)
            continue
        if card is not None:
            yield card
        card = Card(number, head.rstrip("*").upper(), fields)
    if card is not None:
        yield card


def _split(line: str) -> tuple[str, list[str], int]:
    """Cut a line at its commas, or at fixed columns: head, fields, and fields of its format."""
    head, *fields = [text.strip() for text in line.split(",")]
    count = 4 if line[:1] == "*" or head[:8].rstrip().endswith("*") else 8
    if "," not in line:
        head = line[:8].strip()
        width = 64 // count
        fields = [line[8 + width * i : 8 + width * (i + 1)].strip() for i in range(count)]
    return head, fields, count


def real(field: str) -> float:
    """Return a number, whose exponent may have no letter: 2.1+5."""
    try:
        return plain_real(_EXPONENT.sub(r"e\1", field) or "0")
    except MeshFileError:
        raise MeshFileError(f'has "{field}" where a number must be; write a number') from None


def node_numbers(fields: list[str], grids: Collection[str]) -> list[str]:
    """Return the numbers of a list; of first THRU last BY step, those among `grids`."""
    fields = [text for text in fields if text]
    numbers: list[str] = []
    try:
        while fields:
            capitals = [text.upper() for text in fields[:4]]
            if capitals[1:2] == ["THRU"]:
                has_step = capitals[3:] == ["BY"]
                step = whole(fields[4]) if has_step else 1
                first, last = whole(fields[0]), whole(fields[2])
                if first > last:
                    raise ValueError
                span = range(first, last + 1, step)
                # A range to 99999999 means all nodes.
                inside = grids if last - first > len(grids) else map(str, span)
                numbers += [n for n in inside if n in grids and n.isdigit() and int(n) in span]
                fields = fields[5 if has_step else 3 :]
            else:
                numbers.append(str(whole(fields[0])))
                fields = fields[1:]
    except (ValueError, IndexError):
        message = f'lists "{", ".join(fields[:5])}"; write numbers, or first, THRU, last, BY, step'
        raise MeshFileError(message) from None
    return numbers


class _System(NamedTuple):
    """A coordinate system, in basic axes."""

    kind: str  # R, C or S
    axes: np.ndarray  # (3, 3): unit vectors in rows
    origin: np.ndarray  # (3,)


class Entry(NamedTuple):
    """A motion or a load of a freedom in a set."""

    node: str
    freedom: str  # a digit from 1 to 6
    value: float


@dataclass
class Bulk(Translated):
    """A deck under construction, and the content of the file that later cards refer to."""

    # By kind ("SPC", "LOAD") and number; the set ("GRID", "") has the supports of GRID cards
    # themselves.
    sets: dict[tuple[str, str], list[Entry]] = field(default_factory=lambda: defaultdict(list))
    # By kind and number of an SPCADD or LOAD: factors and numbers of sets
    sums: dict[tuple[str, str], list[tuple[float, str]]] = field(default_factory=dict)
    mass_factor: float = 1.0  # factor on all densities: PARAM,WTMASS
    # Name and fields of coordinate systems, fields of nodes, and evaluated systems, by number
    cards: dict[str, tuple[str, list[str]]] = field(default_factory=dict)
    grids: dict[str, list[str]] = field(default_factory=dict)
    systems: dict[str, _System] = field(default_factory=dict)
    defaults: list[str] = field(default_factory=lambda: [""] * 8)  # fields of GRDSET
    # Name and fields of springs by number, and by name and number the stiffnesses of each property
    springs: dict[str, tuple[str, list[str]]] = field(default_factory=dict)

    def index(self, name: str, fields: list[str]) -> None:
        """Store a GRID or coordinate systems by number.

        Raises MeshFileError if an earlier card has the number of a node of other axes, or of the
        second system of a card. Readers of the cards refuse other positions and first systems.
        """
        number = fields[0]
        if name == "GRID":
            for i in (1, CD, 6):  # coordinate systems, supports
                fields[i] = fields[i] or self.defaults[i]
            if self.grids.setdefault(number, fields)[CD] != fields[CD]:
                again = "is defined again with another CD; renumber one of the two"
                raise MeshFileError(f"{name} {number} {again}")
        elif name in SYSTEMS:
            self.cards.setdefault(number, (name, fields))
            if name[4] == "1" and fields[4]:
                if fields[4] in self.cards:
                    again = "is defined again; renumber one of the two"
                    raise MeshFileError(f"{name} {fields[4]} {again}")
                self.cards[fields[4]] = name, fields[4:]

    def system(self, number: str) -> _System:
        """Return a coordinate system.

        Raises MeshFileError if no card defines it, or its card is wrong or needs itself.
        """
        if number in BASIC:
            return _System("R", np.eye(3), np.zeros(3))
        if number not in self.systems:
            self.systems[number] = self._evaluate(number)
        return self.systems[number]

    def _evaluate(self, number: str) -> _System:
        """Return the coordinate system of a card."""
        if number not in self.cards:
            message = f"needs coordinate system {number}, which no CORD card defines; add it"
            raise MeshFileError(message)
        name, fields = self.cards[number]
        if not fields:
            raise MeshFileError(f"needs {name} {number}, which needs itself; correct its RID")
        # No fields during its own evaluation: a system must not refer to itself.
        self.cards[number] = name, []
        try:
            if name[4] == "1":
                points = np.array([self.point(self.grid(node)) for node in fields[1:4]])
            else:
                numbers = np.array([real(text) for text in fields[2:11]]).reshape(3, 3)
                points = np.array([self.in_basic_axes(fields[1], point) for point in numbers])
            z, x, y = axes_through(*points)  # its second point is on z, its third in xz
        except MeshFileError as error:  # the current card names the system
            raise MeshFileError(f"needs {name} {number}, which {error}") from None
        finally:
            self.cards[number] = name, fields
        return _System(name[5], np.array([x, y, z]), points[0])

    def in_basic_axes(self, number: str, point: np.ndarray) -> np.ndarray:
        """Return a point of a coordinate system, its angles in degrees, in basic axes: (3,)."""
        if number in BASIC:
            return point
        kind, axes, origin = self.system(number)
        return origin + cartesian(kind, point) @ axes

    def point(self, fields: list[str]) -> np.ndarray:
        """Return the position of the node of a GRID, in basic axes, shape (3,)."""
        return self.in_basic_axes(fields[1], np.array([real(text) for text in fields[2:5]]))

    def grid(self, node: str) -> list[str]:
        """Return the fields of a node's GRID.

        Raises MeshFileError if there is none.
        """
        if node not in self.grids:
            raise MeshFileError(f"names node {node}, which no GRID defines; add it")
        return self.grids[node]

    def stiffnesses(self, name: str, number: str) -> list[float]:
        """Return the stiffnesses of a spring.

        Raises MeshFileError if its property is missing.
        """
        _, fields = self.springs[number]
        if name == "CELAS2":  # has its own stiffness
            return [real(fields[1])]
        kind = "PBUSH" if name == "CBUSH" else "PELAS"
        key = fields[1] or number
        if kind + key not in self.springs:
            raise MeshFileError(f"needs {kind} {key}, which no card defines")
        return [real(text) for text in self.springs[kind + key][1]]

    def add_orientation(self, name: str, axes: np.ndarray, kind: str = "R") -> str:
        """Add an orientation unless it is the basic one; return the option that names it."""
        if kind == "R" and np.array_equal(axes, np.eye(3)):
            return ""
        system = ", SYSTEM=CYLINDRICAL" if kind == "C" else ""
        self.couplings += [f"*ORIENTATION, NAME=AXES_{name}{system}", axes_text(axes)]
        return f", ORIENTATION=AXES_{name}"

    def axes_at(self, number: str, node: str) -> np.ndarray:
        """Return the axes of a coordinate system at a node in rows, shape (3, 3)."""
        kind, axes, origin = self.system(number)
        if kind == "R":
            return axes
        out = self.point(self.grid(node)) - origin
        try:
            if kind == "C":
                return radial_axes(axes[2], out)
            return axes_through(np.zeros(3), out, np.cross(np.cross(axes[2], out), out))
        except MeshFileError:
            raise MeshFileError(
                f"has node {node} on the axis of coordinate system {number}, where its directions "
                "are not defined; use a rectangular system (CORD2R) there"
            ) from None


def axes_text(axes: np.ndarray) -> str:
    """Return the first two rows of axes as a row of a deck."""
    return ", ".join(f"{component:.15g}" for component in axes[:2].ravel().tolist())
