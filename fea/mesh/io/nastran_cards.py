"""Cards of a Nastran bulk data file, and numbers in their fields."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import NamedTuple

from wrenchbook.fea.spec.deck_text import DeckText
from wrenchbook.fea.spec.problems import MeshFileError

_EXPONENT = re.compile(r"(?<=[\d.])([+-]\d+)$")


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
        if any(fields[count + 1 :]):
            extra = [field for field in fields[count:] if field]
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
        return float(_EXPONENT.sub(r"e\1", field.upper().replace("D", "E") or "0"))
    except ValueError:
        raise MeshFileError(f'has "{field}" where a number must be; write a number') from None


def node_numbers(fields: list[str]) -> list[str]:
    """Return the numbers of a list, which may have first THRU last BY step."""
    fields = [text.upper() for text in fields if text]
    numbers: list[str] = []
    try:
        while fields:
            if fields[1:2] == ["THRU"]:
                has_step = fields[3:4] == ["BY"]
                step = int(fields[4]) if has_step else 1
                numbers += map(str, range(int(fields[0]), int(fields[2]) + 1, step))
                fields = fields[5 if has_step else 3 :]
            else:
                numbers.append(str(int(fields[0])))
                fields = fields[1:]
    except (ValueError, IndexError):
        message = f'lists "{", ".join(fields[:5])}"; write numbers, or first, THRU, last, BY, step'
        raise MeshFileError(message) from None
    return numbers
