"""Findings about the rows of a table file: a bounded sample of the rows, and its findings."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from wrenchbook.service.formats.options import Options
from wrenchbook.service.formats.rows import ParsedTable
from wrenchbook.surrogate.findings.find import MOST, find
from wrenchbook.surrogate.findings.finding import RigFinding
from wrenchbook.surrogate.table.rows import Rows


class FindingsSample:
    """Every k-th row of a file, at most twice as many as findings look at."""

    def __init__(self) -> None:
        self._parts: list[tuple[np.ndarray, ...]] = []
        self._stride, self._skip = 1, 0

    def add(self, piece: ParsedTable) -> None:
        """Take the next rows of the file."""
        part = piece.wrench, piece.displacement, piece.row
        self._parts.append(tuple(one[self._skip :: self._stride].copy() for one in part))
        self._skip = (self._skip - len(piece)) % self._stride
        if sum(len(one[2]) for one in self._parts) > 2 * MOST:
            self._thin()

    def _thin(self) -> None:
        joined = tuple(np.concatenate(one) for one in zip(*self._parts, strict=True))
        self._parts = [tuple(one[::2] for one in joined)]
        if len(joined[0]) % 2:  # the last row was kept: the next kept one is two strides on
            self._skip += self._stride
        self._stride *= 2

    def findings(self, options: Options, known: Sequence[RigFinding] = ()) -> list[dict[str, Any]]:
        """Return findings as JSON-able values; `rows` are places in the file, as of mistakes.

        `known` are those of the join of two logs; rows of a wrong join show nothing else. The other
        findings are on one wrench and its displacement: other spaces have none.
        """
        if known or not self._parts or options.load_range is None or not options.space.is_default:
            return [one.body() for one in known]
        wrench, moved, row = (np.concatenate(one) for one in zip(*self._parts, strict=True))
        rows = Rows.of(wrench, moved, seq=row)
        solved = None if options.solved is None else np.array(options.solved)
        found = find(rows, options.load_range, solved, linear=options.linear)
        return [one.body() for one in found]
