"""LabVIEW measurement files (.lvm) to records (NI: Specification for the LabVIEW Measurement File).

Segments follow the header of the file: a header of tags, the names of the channels, rows. The X
values, mostly times, are one column, a column before each channel, or no column: then they follow
from ``X0`` and ``Delta_X``. Segments of the same channels are joined.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from itertools import chain
from pathlib import Path

from wrenchbook.service.formats.cells import Digits
from wrenchbook.service.formats.columns import Columns
from wrenchbook.service.formats.csv import encoding_of, lines_of, records_of
from wrenchbook.service.formats.header import Record, with_unit
from wrenchbook.service.formats.options import Mistakes, Options, ParsedTable, ReadReport
from wrenchbook.service.formats.text import CellFormat, read_records

MAGIC = b"LabVIEW Measurement"
_HEAD = 4096  # bytes: the header of a file with a long description
_SEPARATORS = re.compile(r"^(Separator|Decimal_Separator|X_Columns)([\t,;])(\S+)", re.MULTILINE)
_X, _COMMENT, _END = "X_Value", "Comment", "***End_of_Header***"
_SPECIAL, _SPECIAL_END = "***Start_Special***", "***End_Special***"
# Tags with which the header of a segment may begin.
_TAGS = {"Channels", "Samples", "Notes", "Test_Name", "Test_Numbers", "Test_Series", "Date", "Time"}
_TAGS |= {"X_Dimension", "X_Unit_Label", "X0", "Delta_X", "Y_Dimension", "Y_Unit_Label"}
_TAGS |= {"UUT_M/N", "UUT_Name", "UUT_S/N"}


def read_lvm(path: Path, options: Options, report: ReadReport) -> Iterator[ParsedTable]:
    """Yield the good rows of a LabVIEW file in pieces; mistakes are added to `report`.

    The channels are columns, in the unit of ``Y_Unit_Label``; the X value is ``time`` and a comment
    is ``note`` unless `options` state otherwise.
    """
    with path.open("rb") as content:
        head = content.read(_HEAD).decode("utf-8", "replace").partition(_END)[0]
    tags = {tag: (mark, value) for tag, mark, value in _SEPARATORS.findall(head)}
    delimiter, mark = (tags.get("Separator", "\t")[0], tags.get("Decimal_Separator", "  ")[1])
    cell_format = CellFormat(mark == ",") if options.decimal is None and mark in ".," else None
    has_x = tags.get("X_Columns", ("", "One"))[1] != "No"
    try:
        with path.open("rb") as content:
            lines = records_of(lines_of(content, encoding_of(path)), 1, delimiter)
            records = _rows(_without_special(lines), has_x, options.columns, report.mistakes)
            line, labels = next(records, (0, [""]))
            known = {_X: "time"} if labels[0].startswith(f"{_X} [") else {}
            known |= {_COMMENT: "note"} if _COMMENT in labels else {}
            options = replace(options, mapping={**known, **options.mapping})
            yield from read_records(chain([(line, labels)], records), options, report, cell_format)
    except ValueError as error:
        line = getattr(error, "line", 0)
        report.mistakes.ruin(line, "file", f"is no readable LabVIEW file: {error}")


def _without_special(records: Iterator[Record]) -> Iterator[Record]:
    """Leave out the special blocks, which are data of the program that wrote the file.

    Raises ValueError if a block has no end.
    """
    for line, cells in records:
        if cells[0].strip() != _SPECIAL:
            yield line, cells
        elif not any(inner[0].strip() == _SPECIAL_END for _, inner in records):
            raise ValueError(f"the special block of line {line} has no {_SPECIAL_END}")


def _rows(
    records: Iterator[Record], has_x: bool, columns: Columns, mistakes: Mistakes
) -> Iterator[Record]:
    """Yield the labels, then the rows of all segments; raises ValueError if channels differ."""
    tags: dict[str, list[str]] = {}
    more_x: set[int] = set()  # indices of the X columns of further channels
    first = None  # the labels of the first segment
    place = "tags"  # then "labels", then "rows"
    clock = None  # X0 and Delta_X, if they stand for a column
    count = 0  # rows of the segment
    for line, cells in records:
        key = cells[0].strip()
        if place != "tags" and key in _TAGS:
            tags = {key: cells}
            place = "tags"
        elif place == "tags":
            tags[key] = cells
            place = "labels" if key == _END else "tags"
        elif place == "labels":
            labels, clock = _segment(cells, tags, has_x, columns)
            more_x = {at for at, cell in enumerate(cells) if at and cell.strip() == _X}
            place = "rows"
            count = 0
            if first is None:
                yield line, labels
            elif labels != first:
                raise ValueError(
                    f"the segment of line {line} has {', '.join(labels)}, but the first has "
                    f"{', '.join(first)}; save each in its own file"
                )
            first = labels
        elif values := {cells[at].strip() for at in more_x if at < len(cells)} - {"", key}:
            message = f"the channels have different times, {key} is {', '.join(sorted(values))}"
            mistakes.add(line, _X, f"{message}; resample them to one X column")
        else:
            time = [Digits(clock[0] + count * clock[1])] if clock else cells[:1]
            rest = enumerate(cells[1:], 1)
            yield line, time + ["" if at in more_x else cell for at, cell in rest]
            count += 1


def _segment(
    cells: list[str], tags: dict[str, list[str]], has_x: bool, columns: Columns
) -> tuple[list[str], tuple[float, float] | None]:
    """Return the labels of a line of names, with units, and X0 and Delta_X if no column has them.

    Raises ValueError if the tags above are those of other channels, or of several clocks.
    """
    names = [" ".join(cell.split()) for cell in cells]
    while names and not names[-1]:
        names.pop()
    # Indices of the names that are channels.
    channels = {at for at, name in enumerate(names) if name not in ("", _X, _COMMENT)}

    def values(tag: str) -> dict[int, str]:
        """Return the value of each channel, which stands in its column."""
        texts = {at: cell.strip() for at, cell in enumerate(tags.get(tag, [])) if at}
        texts = {at: value for at, value in texts.items() if value}
        for at in sorted(texts.keys() - channels):
            known = ", ".join(f"{names[each]} in {each + 1}" for each in sorted(channels))
            raise ValueError(
                f"{tag} has {texts[at]!r} in column {at + 1}, but that column has no channel name "
                f"(channels: {known}); name the channel in the line of labels, or clear the cell"
            )
        return texts

    units = values("Y_Unit_Label")
    labels = [with_unit(name, units.get(at, ""), columns) for at, name in enumerate(names)]
    labels = [label if label != _X else "" for label in labels]  # further X columns have no name
    if names[0] != _X or not set(values("X_Dimension").values()) <= {"Time"}:
        return [names[0], *labels[1:]], None

    labels[0] = f"{_X} [{next(iter(values('X_Unit_Label').values()), 's')}]"
    starts, steps = values("X0"), values("Delta_X")
    timed = starts.keys() | steps.keys() if starts and steps else ()
    clocks = {(starts.get(at, "none"), steps.get(at, "none")) for at in timed}
    if len(clocks) > 1:
        pairs = " and ".join(f"{x0}, {step}" for x0, step in sorted(clocks)[:2])
        raise ValueError(
            f"X0 and Delta_X differ between its channels: {pairs}; resample them to one time"
        )
    if not (clocks or has_x):
        raise ValueError("it has no X column, nor X0 and Delta_X; export it with an X column")
    if has_x:
        return labels, None
    ((x0, delta_x),) = clocks
    try:
        return labels, (float(x0.replace(",", ".")), float(delta_x.replace(",", ".")))
    except ValueError:
        raise ValueError(
            f"X0 is {x0!r} and Delta_X is {delta_x!r}, but both must be numbers; correct them"
        ) from None
