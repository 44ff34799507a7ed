"""The keyword blocks of an Abaqus or CalculiX deck, those of a part once for each instance.

Apart from `fea.mesh.io.abaqus`, which takes nodes, elements and sets out of them.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from wrenchbook.fea.mesh.io.raw import MeshFileError

STRIDE = 10**12
"""Labels of one instance; Abaqus has at most 9 digits, a label above is refused."""


@dataclass(frozen=True)
class Frame:
    """An instance of a part: its name, its number from 1, and its place in the assembly.

    A deck without parts and the assembly itself have no name and the number 0. `rotation` are
    nine numbers row by row, no unit; `shift` is in the deck's length unit.
    """

    name: str = ""
    number: int = 0
    rotation: tuple[float, ...] = ()
    shift: tuple[float, ...] = ()

    def label(self, text: str) -> int:
        """Return the number of a node or element of this instance, unlike all others'."""
        number = int(text)
        if not 0 <= number < STRIDE:
            raise MeshFileError(f"has the number {number}; number from 1 to {STRIDE}")
        return number + self.number * STRIDE

    def key(self, name: str) -> str:
        """Return a set's name in the deck: capitals, as solvers compare names."""
        return (f"{self.name}.{name}" if self.name else name).upper()

    def place(self, point: list[float]) -> list[float]:
        """Return where a point of the part is in the assembly, shape (3,), the deck's unit."""
        if not self.shift:
            return point
        r = np.array(self.rotation).reshape(3, 3)
        return (r @ (np.array(point)) + self.shift).tolist()


@dataclass(frozen=True)
class Keyword:
    """One block: its line, its word, its options by capitals, its rows of fields, its frame."""

    line: int
    word: str
    options: dict[str, str]
    rows: list[list[str]] = field(default_factory=list)
    frame: Frame = Frame()

    def wrong(self, message: object) -> MeshFileError:
        """Return the error that names the line."""
        return MeshFileError(f"line {self.line}: *{self.word} {message}")


def read_keywords(text: str) -> Iterator[Keyword]:
    """Yield the blocks of a deck in the assembly, those of a part where an instance places it.

    Raises MeshFileError if an instance is of no part, a part comes twice, or parts have no
    instances.
    """
    if not re.search(r"^\s*\*INSTANCE\b", text, re.I | re.M):
        yield from _without_instances(text)
        return
    parts: dict[str, list[Keyword]] = {}
    frame, part, count = Frame(), None, 0
    for keyword in _blocks(text):
        if keyword.word == "PART":
            name = keyword.options.get("NAME", "").upper()
            if name in parts:
                raise keyword.wrong(f'defines the part "{name}" again')
            part = parts.setdefault(name, [])
        elif keyword.word == "INSTANCE":
            count += 1
            frame = _frame(keyword, count)
            name = keyword.options.get("PART", "").upper()
            if name not in parts:
                raise keyword.wrong(f'is of a part "{name}" that is not defined above it')
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


def _without_instances(text: str) -> Iterator[Keyword]:
    first = None
    for keyword in _blocks(text):
        if keyword.word == "PART":
            if first is not None:
                raise keyword.wrong(
                    f"comes twice (line {first.line}), and no *INSTANCE places either; write the "
                    "assembly too, or one flat deck"
                )
            first = keyword
        yield keyword


def _blocks(text: str) -> Iterator[Keyword]:
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
            head = Keyword(first, keyword.upper(), values)
            open_head = line if line.endswith(",") else ""
        elif head is not None:
            head.rows.append([each.strip() for each in line.rstrip(",").split(",")])
    if head is not None:
        yield head


def _frame(keyword: Keyword, number: int) -> Frame:
    """Return where an instance is: moved by its first line, then turned by its second."""
    name = keyword.options.get("NAME", "")
    if not name:
        raise keyword.wrong("has no NAME")
    try:
        rows = [[float(x or 0.0) for x in row] for row in keyword.rows]
        if not rows:
            return Frame(name, number)
        shift, rotation = np.array((rows[0] + [0.0] * 3)[:3]), np.eye(3)
        if len(rows) > 1:
            a, b, angle = np.array(rows[1][:3]), np.array(rows[1][3:6]), np.radians(rows[1][6])
            x, y, z = (b - a) / np.linalg.norm(b - a)
            cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
            rotation += np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross  # Rodrigues
            shift = rotation @ (shift - a) + a
    except (ValueError, IndexError) as error:
        raise keyword.wrong(f"cannot be read ({error})") from None
    return Frame(name, number, tuple(rotation.ravel().tolist()), tuple(shift.tolist()))
