"""Keyword blocks of an Abaqus or CalculiX input deck (.inp), and numbers in their fields.

Nodes and elements are numbered by instance, as in the parts of an assembly, and keywords of a part
are read once for each instance.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from wrenchbook.fea import tensors
from wrenchbook.fea.spec.deck_text import DeckText
from wrenchbook.fea.spec.problems import MeshFileError, point_text

STRIDE = 10**12
"""Number of labels of one instance; Abaqus has at most 9 digits, a larger label is refused."""


@dataclass(frozen=True)
class Frame:
    """An instance of a part: its name, its number from 1, and its position in the assembly.

    A deck without parts and the assembly itself have no name and the number 0. `rotation` are
    nine numbers row by row, no unit; `shift` is in the deck's length unit.
    """

    name: str = ""
    number: int = 0
    rotation: tuple[float, ...] = ()
    shift: tuple[float, ...] = ()

    def label(self, text: str) -> int:
        """Return the number of a node or element of this instance, unique among all instances."""
        number = whole(text)
        if not 0 <= number < STRIDE:
            raise MeshFileError(f"has the node or element {number}; write 1 to {STRIDE - 1}")
        return number + self.number * STRIDE

    def key(self, name: str) -> str:
        """Return a set's name in the deck: capitals, as solvers compare names."""
        return (f"{self.name}.{name}" if self.name else name).upper()

    def transformed(self, point: list[float]) -> list[float]:
        """Return the position of a part's point in the assembly, shape (3,), in the deck's unit."""
        if not self.shift:
            return point
        r = np.array(self.rotation).reshape(3, 3)
        return (r @ np.array(point) + self.shift).tolist()


@dataclass(frozen=True)
class Keyword:
    """One block: its line, its word, its options by capitals, its rows of fields, its frame.

    `line` counts in the deck with its included files in place, `at` in the file that `at` names.
    """

    line: int
    at: str
    word: str
    options: dict[str, str]
    rows: list[list[str]] = field(default_factory=list)
    frame: Frame = Frame()
    row_lines: list[int] = field(default_factory=list)  # counted as `line`
    deck: DeckText = field(default=DeckText(), repr=False)

    @property
    def where(self) -> str:
        """The line and the word."""
        return f"line {self.at}: *{self.word}"

    def option(self, name: str) -> str:
        """Return the value of an option.

        Raises MeshFileError if the keyword does not have it.
        """
        if not (value := self.options.get(name)):
            raise MeshFileError(f"has no {name}; write *{self.word}, {name}=...")
        return value

    def wrong(self, message: object) -> MeshFileError:
        """Return the error with the keyword's line."""
        return MeshFileError(f"{self.where} {message}")


def read_keywords(text: DeckText) -> Iterator[Keyword]:
    """Yield the blocks of a deck, those of a part in the place of each of its instances.

    Raises MeshFileError if an instance has no part, a part occurs twice, or parts have no
    instances.
    """
    if not re.search(r"^\s*\*INSTANCE\b", text, re.I | re.M):
        yield from _without_instances(text)
        return

    parts: dict[str, list[Keyword]] = {}
    lines: dict[str, str] = {}  # lines of each part
    frame = Frame()
    part = None
    count = 0
    for keyword in _blocks(text):
        if keyword.word == "PART":
            name = keyword.options.get("NAME", "").upper()
            if name in parts:
                raise keyword.wrong(
                    f'defines "{name}" of line {lines[name]} again; rename one of them'
                )
            lines[name] = keyword.at
            part = parts.setdefault(name, [])
        elif keyword.word == "INSTANCE":
            count += 1
            frame = _frame(keyword, count)
            name = keyword.options.get("PART", "").upper()
            if name not in parts:
                known = f"the parts above are {', '.join(parts)}" if parts else "no *PART is above"
                raise keyword.wrong(
                    f'names the part "{name}", not defined above ({known}); move its *PART up, or '
                    "correct the name"
                )
            yield replace(keyword, frame=frame)
            yield from (replace(part, frame=frame) for part in parts[name])
        elif keyword.word == "END PART":
            part = None
        elif keyword.word == "END INSTANCE":
            frame = Frame()
        elif part is not None:
            part.append(keyword)
        else:
            yield replace(keyword, frame=frame)


def _without_instances(text: DeckText) -> Iterator[Keyword]:
    """Yield the blocks of a deck with at most one part."""
    first = None
    for keyword in _blocks(text):
        if keyword.word == "PART":
            if first is not None:
                raise keyword.wrong(
                    f"is a second part (the first is in line {first.at}), but no *INSTANCE places "
                    "them; write the deck with its *ASSEMBLY, or as one part"
                )
            first = keyword
        yield keyword


def _blocks(text: DeckText) -> Iterator[Keyword]:
    """Yield the keywords with their data lines; a line that ends with a comma continues."""
    head: Keyword | None = None
    open_head = ""
    for number, line in enumerate(text.splitlines(), start=1):
        line = line.strip()
        if not line or line.startswith("**"):
            continue
        if line.startswith("*") or open_head:
            if head is not None and not open_head:
                yield head
            first = head.line if head is not None and open_head else number
            line = open_head + line
            keyword, *options = (part.strip() for part in line.lstrip("*").split(","))
            pairs = (option.partition("=") for option in options if option)
            values = {key.strip().upper(): value.strip() for key, _, value in pairs}
            head = Keyword(first, text.place(first), keyword.upper(), values, deck=text)
            open_head = line if line.endswith(",") else ""
        elif head is not None:
            head.row_lines.append(number)
            head.rows.append([each.strip() for each in line.rstrip(",").split(",")])
    if head is not None:
        yield head


def _frame(keyword: Keyword, number: int) -> Frame:
    """Return the position of an instance: moved by its first line, then rotated by its second."""
    try:
        name = keyword.option("NAME")
        if not keyword.rows:
            return Frame(name, number)
        shift = numbers(keyword, 0, 3)
        rotation = np.eye(3)
        if len(keyword.rows) > 1:
            if (count := len(keyword.rows[1])) < 7:
                raise MeshFileError(
                    f"has {count} numbers in its second line; write seven: two points of the axis, "
                    "and the angle in degrees"
                )
            a, b, (angle,) = np.split(numbers(keyword, 1, 7), [3, 6])
            if np.array_equal(a, b):
                raise MeshFileError(
                    f"turns about an axis through {point_text(a)} twice; write two different points"
                )
            rotation = tensors.rotation(np.radians(angle) * (b - a) / np.linalg.norm(b - a))
            shift = rotation @ (shift - a) + a
    except MeshFileError as error:
        raise keyword.wrong(error) from None
    return Frame(name, number, tuple(rotation.ravel().tolist()), tuple(shift.tolist()))


def numbers(keyword: Keyword, row: int, count: int) -> np.ndarray:
    """Return numbers of a row, shape (count,); missing ones are 0."""
    fields = keyword.rows[row] if row < len(keyword.rows) else []
    return np.array([real(each or "0") for each in (*fields, *["0"] * count)[:count]])


def real(text: str) -> float:
    """Return the number of a field, also with Fortran's exponent, as 7.D4.

    Raises MeshFileError if it is no number.
    """
    try:
        value = float(text.lower().replace("d", "e").replace("_", "?"))  # Python takes 1_000
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise MeshFileError(f'has "{text}" where a number must be; write a number')
    return value


def whole(text: str) -> int:
    """Return the whole number of a field.

    Raises MeshFileError if it is no whole number.
    """
    try:
        return int(text.replace("_", "?"))  # Python takes 1_000
    except ValueError:
        message = f'has "{text}" where a whole number must be; write a whole number'
        raise MeshFileError(message) from None


UNREADABLE = "has a data line that lacks a field, or has a number too large; write all its fields"
"""Message on a keyword whose lines have another form, if no message names the field."""
