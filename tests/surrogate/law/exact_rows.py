"""Where a table does not cover a wrench, the row at or near it answers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tests.surrogate.law.answer import Answer, Batch, within
from wrenchbook.surrogate.answer import COVERED, THIN
from wrenchbook.surrogate.build import STEEPER, Group
from wrenchbook.surrogate.kernel.reasons import UNKNOWN_ERROR
from wrenchbook.surrogate.table.rows import Floats, Rows, acting, acting_wrench


class Beside(NamedTuple):
    """What a row says of a wrench near its own: (6,) each, m and rad.

    Attributes
    ----------
    displacement, error : ndarray
    growth : ndarray
        The part of the error that the distance from the row brings; 0 at the row.
    """

    displacement: Floats
    error: Floats
    growth: Floats


class RowLaw:
    """The answers of a table's rows at their own wrenches.

    Parameters
    ----------
    group : Group
        A row within its load range answers for no wrench beyond it, nor the other way round.
    """

    def __init__(self, group: Group) -> None:
        self.index, self.steepest, self._locked = group.row_index, group.steepest, group.locked
        self.wrenches, self.told = group.rows.wrench, group.merged.rows
        self.owner, self.uncertainty = group.merged.owner, group.row_uncertainty
        self._range = group.load_range

    def instead_of(
        self, wrench: Sequence[float], found: Answer, allowed: Sequence[float]
    ) -> Answer:
        """Return what the row at or beside a wrench, N and N·m, says, or else what was found.

        Parameters are those of `at`.
        """
        told = self.at(wrench, allowed)
        if told is None:
            return found
        moved, error = tuple(told.displacement.tolist()), tuple(told.error.tolist())
        if (np.isnan(told.error) & np.isfinite(told.displacement)).any():
            return Answer(moved, None, "thin", UNKNOWN_ERROR, "row")
        return Answer(moved, error, "covered", "", "row")

    def at(self, wrench: Sequence[float], allowed: Sequence[float]) -> Beside | None:
        """Return what the row at or beside a wrench (6,), N and N·m, says, if one does.

        Parameters
        ----------
        allowed : sequence of 6 floats, m and rad
            What the distance from the row may add to its bar.
        """
        wrench = acting_wrench(wrench, self._locked)
        place = self._place(wrench)
        return None if place < 0 else self._told_by(place, np.array(wrench, dtype=float), allowed)

    def put_into(self, asked: Floats, found: Batch, allowed: Sequence[float]) -> Batch:
        """Where wrenches (n, 6), N and N·m, are not covered, take the rows at or beside them."""
        doubtful, asked = np.flatnonzero(found.coverage != COVERED), acting(asked, self._locked)
        rows = self.index.indices(asked[doubtful])
        for place, row in zip(doubtful[rows >= 0], rows[rows >= 0].tolist(), strict=True):
            if (told := self._told_by(row, asked[place], allowed)) is not None:
                found.displacement[place], found.error[place] = told.displacement, told.error
                unknown = np.isnan(told.error) & np.isfinite(told.displacement)
                found.coverage[place] = THIN if unknown.any() else COVERED
        return found

    def _place(self, wrench: Sequence[float]) -> int:
        return int(self.index.indices(np.array([wrench], dtype=float))[0])

    def near(self, wrenches: Floats) -> NDArray[np.bool_]:
        """Return at or beside which wrenches (k, 6), N and N·m, there is a row, shape (k,)."""
        return self.index.indices(acting(wrenches, self._locked)) >= 0

    def wrench_at(self, wrench: Sequence[float]) -> Floats | None:
        """Return the wrench (6,), N and N·m, of the row at or beside one, if there is one."""
        place = self._place(acting_wrench(wrench, self._locked))
        return None if place < 0 else self.wrenches[place]

    def tangent(self, wrench: Sequence[float]) -> Floats:
        """Return the tangent (6, 6), SI, of the row at or near a wrench (6,); NaN if none has."""
        place = self._place(acting_wrench(wrench, self._locked))
        if place < 0:
            return np.full(self.told.compliance.shape[1:], np.nan)
        found = self.told.compliance[self.owner[place]].copy()
        locked = list(self._locked)
        found[..., locked] = np.where(np.isnan(found[..., locked]), np.nan, 0.0)
        return found

    def has(self, wrench: Sequence[float]) -> bool:
        """Return whether the row at or beside a wrench (6,), N and N·m, has just that."""
        own = self.wrench_at(wrench)
        return own is not None and bool((own == acting(wrench, self._locked)).all())

    def _told_by(self, place: int, wrench: Floats, allowed: Sequence[float]) -> Beside | None:
        """Return what a row says of a wrench (6,), N and N·m, if it is that or may stand for it."""
        told, pair = self._beside(place, wrench), np.stack((wrench, self.wrenches[place]))
        inside = self._range.holds(pair)
        return told if inside[0] == inside[1] and within(told.growth.tolist(), allowed) else None

    def _beside(self, place: int, wrench: Floats) -> Beside:
        """Return what a row, or the one that it became, says of a wrench (6,), N and N·m."""
        own, owner = self.wrenches[place], int(self.owner[place])
        return beside(
            self.told, owner, self.uncertainty[owner], own, wrench, self._range.scale, self.steepest
        )


def beside(
    rows: Rows,
    place: int,
    uncertainty: Floats,
    own: Floats,
    wrench: Floats,
    scale: Floats,
    steepest: Floats,
) -> Beside:
    """Return what the row at a place says of a wrench that is its own or within 1e-6 of it.

    Parameters
    ----------
    own, wrench : ndarray, shape (6,), N and N·m
        The row's wrench and the asked one.
    scale : ndarray, shape (6,), N and N·m
        Of the load range.
    steepest : ndarray, shape (6,), m and rad
        See `Group`.
    """
    displacement = rows.displacement[place]
    unread = np.isnan(displacement)  # of a table cut to a scene
    error = np.where(unread, np.nan, uncertainty)
    step = wrench - own
    if not step.any():
        return Beside(displacement, error, np.zeros(6))
    moved = rows.compliance[place] @ step
    reach, far = np.abs(np.stack((step, own)) / scale).max(axis=1)
    slope = steepest
    if far > 0.0:
        most = np.fmax.reduce(np.abs(displacement).reshape(2, 3), axis=1)
        slope = np.fmax(slope, STEEPER / far * np.repeat(most, 3))
    if not slope.any():  # one row at rest: nothing tells what a load does
        slope = np.full(6, np.nan)
    known = np.isfinite(moved)
    growth = np.where(unread, 0.0, np.where(known, np.abs(moved), slope * reach))
    return Beside(displacement + np.where(known, moved, 0.0), error + growth, growth)


def sources_at(rows: Rows, wrenches: Sequence[Floats | None]) -> str | None:
    """Return the sources of the rows that have any of some wrenches (6,), each once, or None."""
    same = np.zeros(len(rows), dtype=bool)
    for wrench in wrenches:
        if wrench is not None:
            same |= (rows.wrench == wrench).all(axis=1)
    return ", ".join(dict.fromkeys(rows.source[same].tolist())) if same.any() else None
