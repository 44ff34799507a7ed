"""Taring: the mean of the first rows, read with no load, is taken off all others."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from service.formats.limits import excesses
from service.formats.mistakes import RowError
from service.formats.options import Options, Told
from service.formats.parsed import ParsedTable


def tared(pieces: Iterator[ParsedTable], options: Options, told: Told) -> Iterator[ParsedTable]:
    """Yield rows less the mean of the first `options.tare` good ones, which are not among them.

    What is checked against limits is what is left.
    """
    if not options.tare:
        yield from pieces
        return
    offset = None
    for piece in pieces:
        if offset is None:
            if len(piece) <= options.tare:
                message = f"tare={options.tare}, and only {len(piece)} good rows are there for it"
                told.mistakes.ruin(RowError(0, "tare", message))
                return
            offset = _means(piece, options.tare)
            told.tare = options.tare
            piece = piece.take(np.arange(len(piece)) >= options.tare)
        yield within_limits(_less(piece, *offset), options, told)


def _means(piece: ParsedTable, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean wrench and displacement of the first rows; 0 where nothing was measured."""
    moved = piece.displacement[:count]
    known = np.isfinite(moved)
    sums = np.where(known, moved, 0.0).sum(axis=0)
    return piece.wrench[:count].mean(axis=0), sums / np.maximum(known.sum(axis=0), 1)


def _less(piece: ParsedTable, wrench: np.ndarray, displacement: np.ndarray) -> ParsedTable:
    return replace(
        piece,
        wrench=piece.wrench - wrench,
        displacement=piece.displacement - displacement,
    )


def within_limits(piece: ParsedTable, options: Options, told: Told) -> ParsedTable:
    """Return the rows that no limit forbids; what is wrong with the others joins the mistakes."""
    good = np.ones(len(piece), dtype=bool)
    found = excesses(piece.wrench, piece.displacement, options.load_range, piece.uncertainty)
    for excess in found:
        good[excess.at] = False
        row = int(piece.row[excess.at])
        told.mistakes.append(RowError(row, told.label(excess.name), excess.message))
    told.mistakes.settle()
    return piece.take(good)
