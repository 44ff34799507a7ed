"""Which rows of a file may stand in a component's table as what they say they are.

Rows of different setups are never mixed. A row with the component's own fingerprint is loaded
as what it says it is, with its tangent: so an export of solves comes back as solves. A row
with another fingerprint, or one that says it is a solve and names no setup, is refused rather
than loaded as measured: it would be a solve of another mesh under a false name, and whoever
knows better can write the other name into the file. A row without a fingerprint is a
measurement or a solve from elsewhere; its tangent is taken as its displacement is.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from service.formats.mistakes import RowError
from service.formats.options import Options, Told
from service.formats.parsed import ParsedTable

FEA = "fea"


def well_placed(
    pieces: Iterator[ParsedTable], options: Options, told: Told
) -> Iterator[ParsedTable]:
    """Yield the rows that may stand in the table of the setup `options.fingerprint`."""
    for piece in pieces:
        if options.fingerprint is None or not _may_be_misplaced(piece):
            yield piece
            continue
        good = np.ones(len(piece), dtype=bool)
        for place, error in _misplaced(piece, options.fingerprint):
            good[place] = False
            told.mistakes.append(error)
        told.mistakes.settle()
        yield piece.take(good)


def _may_be_misplaced(piece: ParsedTable) -> bool:
    return any(piece.fingerprint) or FEA in piece.source


def _misplaced(piece: ParsedTable, own: str) -> Iterator[tuple[int, RowError]]:
    pairs = zip(piece.fingerprint, piece.source, strict=True)
    for place, (fingerprint, source) in enumerate(pairs):
        if not fingerprint and source != FEA:
            continue
        row = int(piece.row[place])
        if fingerprint != own and (fingerprint or source == FEA):
            yield place, RowError(row, "fingerprint", _foreign(own, fingerprint))
        elif source == FEA and np.isnan(piece.displacement[place]).any():
            message = "a solve knows all six outputs; write them, or another source than fea"
            yield place, RowError(row, "source", message)


def _foreign(own: str, fingerprint: str) -> str:
    other = f"the setup {fingerprint}" if fingerprint else "a setup that the row does not name"
    return (
        f"is a solve of {other}, this component's setup is {own}; rows "
        "of different setups are never mixed. Leave the row out, or load it as measured: "
        "an empty fingerprint and another source"
    )
