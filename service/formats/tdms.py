"""TDMS files of LabVIEW: the channels of a group, each a column in its unit."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from wrenchbook.service.formats.cells import ContentError
from wrenchbook.service.formats.header import named_columns, readings_of, with_unit
from wrenchbook.service.formats.options import Options, ParsedTable, ReadReport
from wrenchbook.service.formats.text import PIECE, read_columns
from wrenchbook.service.formats.xlsx import chosen_sheet

_HEAD_BYTES = 28  # of a segment: tag, flags, version, and two lengths
_BIG_ENDIAN = 1 << 6  # flag, in the lowest byte, of big-endian numbers
_CUT_OFF = (
    "ends within a segment, because its writing or copying was cut off; copy it again, or "
    "export the complete rows as CSV"
)
_MAX_NAMED = 8  # channels in a message: more would hide its remedy


def read_tdms(path: Path, options: Options, report: ReadReport) -> Iterator[ParsedTable]:
    """Yield the good rows of a TDMS file: of the sheet's group, or the first with most columns.

    The channels are columns in the unit of ``unit_string``; waveforms have a time.
    """
    # Imported on first use, from the extra `rig`.
    from nptdms import TdmsFile

    _require_whole_segments(path)
    columns, mapping = options.columns, options.mapping
    with TdmsFile.open(path) as file:
        groups = {
            group.name: [channel for channel in group.channels() if len(channel)]
            for group in file.groups()
        }
        counts = {
            name: named_columns([channel.name for channel in group], columns, mapping)
            for name, group in groups.items()
            if group
        }
        best = {name for name, count in counts.items() if count == max(counts.values())}
        sheet = chosen_sheet(list(counts), options.sheet, [best.__contains__], report)
        report.ignored += [channel.name for channel in file[sheet].channels() if not len(channel)]
        yield from read_columns(_pieces(groups[sheet], options), options, report)


def _require_whole_segments(path: Path) -> None:
    """Raise ContentError if a TDMS file ends within a segment, whose rows nptdms drops in silence.

    Each segment begins with "TDSm", flags, version and the number of bytes behind this head (NI,
    "TDMS File Format Internal Structure"). A program that stopped leaves the number as -1.
    """
    size, start = path.stat().st_size, 0
    with path.open("rb") as file:
        while start < size:
            file.seek(start)
            head = file.read(_HEAD_BYTES)
            if len(head) < _HEAD_BYTES or not head.startswith(b"TDSm"):
                raise ContentError(_CUT_OFF)
            order = "big" if head[4] & _BIG_ENDIAN else "little"
            start += _HEAD_BYTES + int.from_bytes(head[12:20], order)
    if start > size:
        raise ContentError(_CUT_OFF)


def _pieces(
    channels: Sequence[Any], options: Options
) -> Iterator[tuple[list[str], list[np.ndarray]]]:
    """Yield labels and channels, `PIECE` rows at a time; with a time if there is a waveform."""
    columns = options.columns
    if len(channels) > columns.max_count:
        raise ContentError(
            f"its group has {len(channels)} channels, but at most {columns.max_count} are read; "
            "leave some out"
        )
    lengths = {len(channel) for channel in channels}
    if len(lengths) != 1:
        sizes = ", ".join(f"{channel.name} {len(channel)}" for channel in channels[:_MAX_NAMED])
        raise ContentError(f"its channels differ in length ({sizes}); resample them to one time")
    labels = [
        with_unit(channel.name, channel.properties.get("unit_string", ""), columns)
        for channel in channels
    ]
    waveform = ("start_time", "start_offset", "increment")
    times = {
        tuple(channel.properties.get(f"wf_{key}") for key in waveform): channel.name
        for channel in channels
        if channel.properties.get("wf_increment")
    }
    if len(times) > 1:
        (first_time, first_name), (next_time, next_name) = list(times.items())[:2]
        pairs = zip(waveform, first_time, next_time, strict=True)
        differing = ", ".join(f"wf_{key} {a} and {b}" for key, a, b in pairs if a != b)
        raise ContentError(
            f"the waveforms of {first_name} and {next_name} have different times ({differing}); "
            "resample them to one time"
        )

    names = [reading.column for label in labels for reading in readings_of(label, columns)]
    named = any(name.startswith("time") for name in (*names, *options.mapping.values()))
    has_clock = bool(times) and not named
    labels += ["time [s]"] if has_clock else []
    for at in range(0, lengths.pop(), PIECE):
        piece = [channel[at : at + PIECE] for channel in channels]
        if has_clock:
            (_, start, step), *_ = times
            piece.append((start or 0.0) + step * np.arange(at, at + len(piece[0])))
        yield labels, piece
