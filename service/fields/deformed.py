"""The deformed surface of a component under any wrench, from the fields that its rows have."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wrenchbook.fea.element.equivalent_stress import von_mises
from wrenchbook.service.fields.blend import Blend
from wrenchbook.service.fields.codec import DamagedFieldsError
from wrenchbook.service.fields.record import RowFields, SurfaceGeometry
from wrenchbook.service.fields.shape import (
    Deformed,
    error_parts,
    largest_stress,
    rounding,
    stress_of_row,
    vertex_modes,
)
from wrenchbook.service.fields.store import FieldStore
from wrenchbook.service.library.component import Component
from wrenchbook.surrogate.field_weights import FieldWeights, nearest_rows
from wrenchbook.surrogate.kriging import Hyperparameters, SingularCovarianceError
from wrenchbook.surrogate.solver_error import SolverError
from wrenchbook.surrogate.table.rows import Rows, why_beyond

Floats = NDArray[np.float64]

MOST_ROWS = 60
"""Rows that a field is interpolated of: with slopes as good as all, and a factor of 0.02 s."""

BLEND_BYTES = 128 << 20
"""Of the fields that one component's interpolation holds; larger surfaces take fewer rows."""

LEAST_ROWS = 8
"""Rows taken however large their fields are: fewer give neither an answer nor an error."""

MOST_BLENDS = 2
"""Components whose interpolation is kept at once."""

THREADS = 2
"""Surfaces made at once: each may take a processor."""

FARTHEST = 2.0
"""Half ranges beyond an end of the load range: further out rows do not determine a surface."""

SAME = 1e-6
"""Of the load range: a wrench so near to a row's is the one that row was rounded from."""

WITHOUT_TOLERANCE = 0.01
"""Of the largest displacement of any row: a vertex's error bar allowed without a tolerance."""


class NoFieldsError(Exception):
    """No row of the component has a deformed surface; the message has the remedy."""

    def __init__(self, component: Component, why: str) -> None:
        super().__init__(_how_to(component, why))


class TooFarError(ValueError):
    """The wrench is so far beyond the load range that nothing is known there."""


class DeformedSurfaces:
    """Answers deformed surfaces, and keeps what the last ones were made of.

    Parameters
    ----------
    store : FieldStore
        Where the fields of rows are.

    Attributes
    ----------
    threads : ThreadPoolExecutor
        For callers that must not block: `answer` may take a second.
    """

    def __init__(self, store: FieldStore) -> None:
        self._store = store
        self._kept: OrderedDict[str, tuple[Any, Blend]] = OrderedDict()
        self._lock = threading.Lock()
        self.threads = ThreadPoolExecutor(THREADS, thread_name_prefix="deformed")

    def close(self) -> None:
        """Let go of the threads; questions that have not begun are dropped."""
        self.threads.shutdown(cancel_futures=True)

    def answer(
        self,
        component: Component,
        rows: Rows,
        wrench: Floats,
        hyperparameters: Hyperparameters | None = None,
        solver: SolverError | None = None,
        shares: Mapping[str, Sequence[float] | None] | None = None,
    ) -> Deformed:
        """Return the deformed surface under a wrench (6,), N and N·m.

        It reads files and may take a second: nothing for an event loop.

        Parameters
        ----------
        rows : Rows
            All rows of the component's table.
        hyperparameters : Hyperparameters, optional
            Of the table's kriging.
        solver : SolverError, optional
            The solver's own error; without it error bars are the interpolation error alone,
            see `Deformed.parts`.
        shares : mapping, optional
            Its shares at the interface under that wrench (`SolverError.parts`).

        Raises
        ------
        NoFieldsError
            If no row has fields.
        TooFarError
            If a load is over `FARTHEST` of the range beyond it.
        """
        acting = component.acting(np.asarray(wrench, dtype=float))
        _require_near(component, acting)
        if component.linear:
            found = self._linear(component, rows, acting)
        else:
            found = self._own(component, rows, acting) or self._between(
                component, rows, acting, hyperparameters
            )
        found = _whole(component, found, solver, shares)
        beyond = why_beyond(component.load_range, acting)
        if beyond and found.source != "row":
            return replace(found, coverage="outside", reason=beyond)
        return found

    def _linear(self, component: Component, rows: Rows, wrench: Floats) -> Deformed:
        try:
            row = self._store.linear(component.name, component.fingerprint)
            if row is None:
                raise NoFieldsError(component, "no solve has left its six unit fields yet")
            geometry = self._geometry(component, row)
        except DamagedFieldsError as error:
            raise NoFieldsError(component, str(error)) from error
        moved, stresses = row.displacement_slopes @ wrench, row.stress_slopes @ wrench
        if row.meta.get("weight"):
            solved = np.array(row.meta["wrench"])
            moved += row.displacement - row.displacement_slopes @ solved
            if len(stresses):
                stresses += row.stress - row.stress_slopes @ solved
        stress = largest_stress(component, geometry, stresses, 0.0)
        return Deformed(
            component=component.name,
            wrench=tuple(wrench.tolist()),
            geometry=geometry,
            displacement=moved,
            error=rounding(moved),
            stress=stress,
            source="linear",
            follows=vertex_modes(row.displacement_slopes, _any_compliance(component, rows)),
        )

    def _own(self, component: Component, rows: Rows, wrench: Floats) -> Deformed | None:
        """Return the surface of this wrench's own solve; None if there is none with fields."""
        apart = np.abs(rows.wrench - wrench) / component.load_range.scale
        near = apart.max(axis=1, initial=0.0) <= SAME
        for place in np.flatnonzero(near & (rows.fingerprint == component.fingerprint)).tolist():
            for row in self._readable(component, rows.wrench[place : place + 1]):
                found = self._stepped(component, row, wrench, int(rows.seq[place]))
                follows = vertex_modes(row.displacement_slopes, rows.compliance[place])
                return found and replace(found, follows=follows)
        return None

    def _stepped(
        self, component: Component, row: RowFields, wrench: Floats, number: int
    ) -> Deformed | None:
        """Return a row's fields, led by their slopes over the step from its wrench."""
        try:
            geometry = self._geometry(component, row)
        except DamagedFieldsError:
            return None
        step = wrench - np.array(row.meta["wrench"])
        moved = row.displacement_slopes @ step
        stress = stress_of_row(component, row)
        if step.any() and len(row.stress):
            change = row.stress_slopes @ step
            error = float(von_mises(change).max())
            stress = largest_stress(component, geometry, row.stress + change, error)
        whole = row.displacement + moved
        vertex_error = rounding(whole) + np.linalg.norm(moved, axis=1)
        loads = tuple(wrench.tolist())
        return Deformed(
            component.name, loads, geometry, whole, vertex_error, stress, "row", (number,)
        )

    def _between(
        self,
        component: Component,
        rows: Rows,
        wrench: Floats,
        hyperparameters: Hyperparameters | None,
    ) -> Deformed:
        """Return the interpolation of the rows that have fields."""
        places = self._having_fields(component, rows)
        with self._lock:  # one at a time: a new interpolation takes a processor and its memory
            blend = self._blend(component, rows.take(places), wrench, hyperparameters)
        fields = blend.at(wrench)
        error = fields.error
        if error is not None:
            error = np.maximum(error, rounding(fields.displacement))
        coverage, reason = _judged(component, blend, error)
        stress = None
        if fields.stress is not None:
            stress = largest_stress(component, blend.geometry, fields.stress, fields.stress_error)
        number, slopes = blend.nearest(wrench)
        return Deformed(
            component=component.name,
            wrench=tuple(wrench.tolist()),
            geometry=blend.geometry,
            displacement=fields.displacement,
            error=error,
            stress=stress,
            source="rows",
            rows=blend.rows,
            coverage=coverage,
            reason=reason,
            follows=vertex_modes(slopes, rows.compliance[np.flatnonzero(rows.seq == number)[0]]),
        )

    def _having_fields(self, component: Component, rows: Rows) -> NDArray[np.intp]:
        """Return the places of rows with fields, one for each wrench within the load range."""
        if not len(rows):
            raise NoFieldsError(component, "its table has no rows")
        inside = component.load_range.holds(rows.wrench)
        solved = np.flatnonzero((rows.fingerprint == component.fingerprint) & inside)
        wrenches = rows.wrench[solved]
        having = self._store.has(component.name, component.fingerprint, wrenches.tolist())
        if not having:
            why = f"none of its {len(rows)} rows has one; they were imported or solved before"
            raise NoFieldsError(component, why)
        grains = np.rint(wrenches[having] / (2 * SAME * component.load_range.scale))
        _, first = np.unique(grains, axis=0, return_index=True)
        return solved[having][np.sort(first)]

    def _blend(
        self,
        component: Component,
        rows: Rows,
        wrench: Floats,
        hyperparameters: Hyperparameters | None,
    ) -> Blend:
        """Return the interpolation of the rows nearest to a wrench; the last one if it is that."""
        chosen = nearest_rows(
            rows.wrench, wrench, component.load_range, self._most_rows(component, rows)
        )
        near, lengths = (
            rows.take(chosen),
            None if hyperparameters is None else hyperparameters.logarithms.tobytes(),
        )
        key = component.fingerprint, near.seq.tobytes(), lengths
        kept = self._kept.get(component.name)
        if kept is not None and kept[0] == key:
            self._kept.move_to_end(component.name)
            return kept[1]
        self._kept.pop(component.name, None)  # before its like takes as much memory again
        blend = self._made(component, near, hyperparameters)
        self._kept[component.name] = key, blend
        while len(self._kept) > MOST_BLENDS:
            self._kept.popitem(last=False)
        return blend

    def _most_rows(self, component: Component, rows: Rows) -> int:
        """Return how many rows' fields may be in memory at once."""
        for row in self._readable(component, rows.wrench):
            size = 7 * 8 * (row.displacement.size + row.stress.size)
            return min(MOST_ROWS, max(LEAST_ROWS, BLEND_BYTES // max(size, 1)))
        raise NoFieldsError(component, "the files of all rows are damaged")

    def _made(
        self, component: Component, rows: Rows, hyperparameters: Hyperparameters | None
    ) -> Blend:
        found: list[tuple[int, RowFields]] = []
        for place, wrench in enumerate(rows.wrench):
            found += [(place, row) for row in self._readable(component, wrench[None])]
        if not found:
            raise NoFieldsError(component, "the files of the nearest rows are damaged")
        digest = found[-1][1].meta["geometry"]  # a mesher of another version makes another mesh
        like = [(place, row) for place, row in found if row.meta["geometry"] == digest]
        kept = rows.take([place for place, _ in like])
        try:
            geometry = self._geometry(component, like[0][1])
            weights = FieldWeights.of(kept.wrench, component.load_range, hyperparameters)
        except (DamagedFieldsError, SingularCovarianceError) as error:
            raise NoFieldsError(component, str(error)) from error
        return Blend.of(geometry, weights, [row for _, row in like], tuple(kept.seq.tolist()))

    def _readable(self, component: Component, wrenches: Floats) -> Iterator[RowFields]:
        """Yield the fields of rows; those whose file is gone or damaged have none."""
        for wrench in wrenches.tolist():
            try:
                yield self._store.row(component.name, component.fingerprint, wrench)
            except DamagedFieldsError:
                continue

    def _geometry(self, component: Component, row: RowFields) -> SurfaceGeometry:
        return self._store.geometry(component.name, component.fingerprint, row.meta["geometry"])


def _require_near(component: Component, wrench: Floats) -> None:
    loads = component.load_range
    room = FARTHEST * loads.scale
    low, high = np.minimum(loads.low, 0.0) - room, np.maximum(loads.high, 0.0) + room
    if ((wrench < low) | (wrench > high)).any():
        beyond = why_beyond(loads, wrench)
        raise TooFarError(f"{beyond}: too far beyond it for a surface; ask nearer to the range")


def _any_compliance(component: Component, rows: Rows) -> Floats:
    """Return a linear component's compliance, the same of each row, (6, 6), SI; NaN without."""
    own = rows.compliance[rows.fingerprint == component.fingerprint]
    known = np.flatnonzero(np.isfinite(own).all(axis=(1, 2)))
    return own[known[0]] if len(known) else np.full((6, 6), np.nan)


def _whole(
    component: Component,
    shape: Deformed,
    solver: SolverError | None,
    shares: Mapping[str, Sequence[float] | None] | None,
) -> Deformed:
    """Return a surface whose error bars include the solver's error; coverage stays the table's."""
    if shape.error is None:
        return shape
    parts = error_parts(shape.error, shape.follows, solver, np.array(shape.wrench), shares)
    limit, total, within = component.tolerance, parts.total, None
    if limit is not None and parts.are_whole:
        within = bool(total.max(initial=0.0) <= limit.translation)
    return replace(shape, error=total, parts=parts, within_tolerance=within)


def _judged(component: Component, blend: Blend, error: Floats | None) -> tuple[str, str]:
    """Return the coverage of an interpolation, and the reason if it is not covered."""
    if error is None:
        count = len(blend.rows)
        return "thin", f"{count} row(s) with a surface: too few for an error bar"
    limit = component.tolerance
    allowed = limit.translation if limit else WITHOUT_TOLERANCE * blend.largest
    worst = float(error.max(initial=0.0))
    if worst > allowed:
        return "thin", f"a vertex may be wrong by {worst:.3g} m, over {allowed:.3g} m"
    return "covered", ""


def _how_to(component: Component, why: str) -> str:
    """Return why there is no surface, and how to get one."""
    name = component.name
    if not component.has_fea:
        return (
            f"{name!r} is a table without a finite-element setup: there is no surface to deform. "
            "Add the component as a bundle with a mesh."
        )
    return (
        f"{name!r} has no deformed surface yet: {why}. Each solve by the embedded solver leaves "
        f"one (a deck's own solver leaves none): POST this wrench to /v1/components/{name}/solve, "
        f"or ask for several by /v1/components/{name}/fill. A row without a surface gets one by "
        "being solved again: DELETE it from the table, then POST its wrench to /solve."
    )
