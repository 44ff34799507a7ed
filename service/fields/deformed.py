"""The deformed surface of a component under any wrench, from the stored fields of its rows."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np

from wrenchbook.fea.tensors import von_mises
from wrenchbook.service.fields.blend import ARRAYS, Blend
from wrenchbook.service.fields.record import DamagedFieldsError, RowFields, SurfaceGeometry
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
from wrenchbook.surrogate.table.rows import NEAR, Floats, Rows, why_beyond

# Rows of an interpolation: by their slopes as accurate as all rows, with a factorisation of 20 ms.
MAX_ROWS = 60
BLEND_BYTES = 128 << 20  # memory of one component's interpolation; larger surfaces use fewer rows
MIN_ROWS = 8  # rows of an interpolation, for any size of their fields
MAX_BLENDS = 2  # components whose interpolation is in memory at once
THREADS = 2  # surfaces computed at once: each may use a processor
# Half ranges beyond an end of the load range: farther away rows do not determine a surface.
FARTHEST = 2.0
# Largest error bar of a vertex without a tolerance: part of the largest displacement of any row.
WITHOUT_TOLERANCE = 0.01
MAX_LISTED = 10  # rows in a message: more would hide its remedy
_FLOAT_BYTES = 8


class NoFieldsError(Exception):
    """No row gives a deformed surface: none has fields, or the stored fields are `unusable`.

    `rows`: the numbers of the rows whose files are damaged.
    """

    def __init__(
        self, component: Component, why: str, *, unusable: bool = False, rows: Sequence[int] = ()
    ) -> None:
        name = component.name
        solve = f"Solve wrenches that have no row: POST /v1/components/{name}/solve"
        if rows:
            more = ", ..." if len(rows) > MAX_LISTED else ""
            numbers = ", ".join(map(str, rows[:MAX_LISTED])) + more
            text = (
                f"no stored surface of {name!r} can be used: {why} (row{'s' * (len(rows) > 1)} "
                f"{numbers}). To make one again: DELETE /v1/components/{name}/table/{rows[0]}, "
                f"then POST /v1/components/{name}/solve with that row's wrench"
            )
        elif unusable:
            text = f"the stored surfaces of {name!r} cannot be used: {why}. {solve}"
        elif component.has_fea:
            text = (
                f"{name!r} has no deformed surface yet: {why}. {solve} or .../fill. For the "
                f"surface of a row, DELETE /v1/components/{name}/table/ROW first"
            )
        else:
            text = (
                f"{name!r} is a table without a finite-element setup, so it has no surface. Add "
                "the component as a bundle with a mesh"
            )
        super().__init__(text)


class TooFarError(ValueError):
    """The wrench is more than `FARTHEST` half ranges beyond the load range."""


class DeformedSurfaces:
    """Deformed surfaces of a data directory; caches the interpolations of `MAX_BLENDS` components.

    `threads` is for callers that must not block: `answer` may take a second.
    """

    def __init__(self, store: FieldStore) -> None:
        self._store = store
        # By component, with the key of its rows and hyperparameters; the last used is last.
        self._blends: OrderedDict[str, tuple[Any, Blend]] = OrderedDict()
        self._lock = threading.Lock()
        self.threads = ThreadPoolExecutor(THREADS, thread_name_prefix="deformed")

    def close(self) -> None:
        """Shut the threads down; requests that have not begun are cancelled."""
        self.threads.shutdown(cancel_futures=True)

    def answer(
        self,
        component: Component,
        rows: Rows,
        wrench: Floats,
        hyperparameters: Hyperparameters | None = None,
        solver: SolverError | None = None,
        at_interface: Mapping[str, Sequence[float] | None] | None = None,
    ) -> Deformed:
        """Return the deformed surface under a wrench (6,), N and N·m, from all rows of the table.

        It reads files and may take a second: do not call it in an event loop. `solver` is the
        solver's error, `at_interface` its error bars at the interface under that wrench
        (`SolverError.parts`); without them error bars are the interpolation error alone, see
        `Deformed.parts`.

        Raises NoFieldsError if no row has usable fields, TooFarError if a load is more than
        `FARTHEST` half ranges beyond the load range.
        """
        acting = component.acting(np.asarray(wrench, dtype=float))
        load_range = component.load_range
        margin = FARTHEST * load_range.scale
        beyond = why_beyond(load_range, acting)
        low = np.minimum(load_range.low, 0.0) - margin
        high = np.maximum(load_range.high, 0.0) + margin
        is_too_far = (acting < low) | (acting > high)
        if is_too_far.any():
            load = int(is_too_far.argmax())
            ends = f"{component.space.input_names[load]} {low[load]:.6g} to {high[load]:.6g}"
            raise TooFarError(f"{beyond}, too far away for a surface; give a load within {ends}")

        if component.linear:
            surface = self._linear(component, rows, acting)
        else:
            surface = self._of_solve(component, rows, acting)
            if surface is None:
                surface = self._interpolated(component, rows, acting, hyperparameters)
        if surface.error is not None:  # the coverage stays that of the table
            parts = error_parts(surface.error, surface.modes, solver, acting, at_interface)
            limit = component.tolerance
            total = parts.total
            within = None
            if limit is not None and parts.are_complete:
                within = bool(total.max(initial=0.0) <= limit.translation)
            surface = replace(surface, error=total, parts=parts, within_tolerance=within)
        if beyond and surface.source != "row":
            return replace(surface, coverage="outside", reason=beyond)
        return surface

    def _linear(self, component: Component, rows: Rows, wrench: Floats) -> Deformed:
        """Return the surface of a linear component: its fields of unit loads times the wrench."""
        try:
            row = self._store.linear(component.name, component.fingerprint)
            if row is None:
                raise NoFieldsError(component, "no solve has stored fields of unit loads")
            geometry = self._geometry(component, row)
        except DamagedFieldsError as error:
            raise NoFieldsError(component, str(error), unusable=True) from error
        moved, stresses = row.displacement_slopes @ wrench, row.stress_slopes @ wrench
        if row.meta.get("weight"):  # displaced at zero load too
            solved = np.array(row.meta["wrench"])
            moved += row.displacement - row.displacement_slopes @ solved
            if len(stresses):
                stresses += row.stress - row.stress_slopes @ solved

        stress = largest_stress(component, geometry, stresses, 0.0)
        # All rows of a linear component have the same compliance; NaN if no row has one.
        compliances = rows.compliance[rows.fingerprint == component.fingerprint]
        known = compliances[np.isfinite(compliances).all(axis=(1, 2))]
        compliance = known[0] if len(known) else np.full((6, 6), np.nan)
        return Deformed(
            component=component.name,
            wrench=tuple(wrench.tolist()),
            geometry=geometry,
            displacement=moved,
            error=rounding(moved),
            stress=stress,
            source="linear",
            modes=vertex_modes(row.displacement_slopes, compliance),
        )

    def _of_solve(self, component: Component, rows: Rows, wrench: Floats) -> Deformed | None:
        """Return the surface of a solve at this wrench; None without a solve that has fields."""
        distance = np.abs(rows.wrench - wrench) / component.load_range.scale
        is_near = distance.max(axis=1, initial=0.0) <= NEAR
        is_current = rows.fingerprint == component.fingerprint
        for index in np.flatnonzero(is_near & is_current).tolist():
            row = self._read_row(component, rows.wrench[index])
            if row is None:
                continue
            try:
                geometry = self._geometry(component, row)
            except DamagedFieldsError:
                return None

            # The row's fields, extrapolated by their slopes from its wrench to this one.
            step = wrench - np.array(row.meta["wrench"])
            moved = row.displacement_slopes @ step
            stress = stress_of_row(component, row)
            if step.any() and len(row.stress):
                change = row.stress_slopes @ step
                error = float(von_mises(change).max())
                stress = largest_stress(component, geometry, row.stress + change, error)
            displacement = row.displacement + moved
            return Deformed(
                component=component.name,
                wrench=tuple(wrench.tolist()),
                geometry=geometry,
                displacement=displacement,
                error=rounding(displacement) + np.linalg.norm(moved, axis=1),
                stress=stress,
                source="row",
                rows=(int(rows.seq[index]),),
                modes=vertex_modes(row.displacement_slopes, rows.compliance[index]),
            )
        return None

    def _interpolated(
        self,
        component: Component,
        rows: Rows,
        wrench: Floats,
        hyperparameters: Hyperparameters | None,
    ) -> Deformed:
        """Return the surface between the rows in range that have fields, one for each wrench."""
        if not len(rows):
            raise NoFieldsError(component, "its table has no rows")
        is_inside = component.load_range.holds(rows.wrench)
        solved = np.flatnonzero((rows.fingerprint == component.fingerprint) & is_inside)
        wrenches = rows.wrench[solved]
        with_fields = self._store.find(component.name, component.fingerprint, wrenches.tolist())
        if not with_fields:
            raise NoFieldsError(
                component,
                f"no row has fields (rows: {len(rows)}; solves of its present setup within the "
                f"load range: {len(solved)})",
            )
        cells = np.rint(wrenches[with_fields] / (2 * NEAR * component.load_range.scale))
        _, first = np.unique(cells, axis=0, return_index=True)
        distinct = rows.take(solved[with_fields][np.sort(first)])

        with self._lock:  # one at a time: a new interpolation takes a processor and its memory
            blend = self._blend(component, distinct, wrench, hyperparameters)
        fields = blend.at(wrench)
        error = fields.error
        if error is not None:
            error = np.maximum(error, rounding(fields.displacement))
        limit = component.tolerance
        allowed = limit.translation if limit else WITHOUT_TOLERANCE * blend.largest
        reason = ""
        if error is None:
            reason = f"too few surfaces for an error bar ({len(blend.rows)}); solve more"
        elif (worst := float(error.max(initial=0.0))) > allowed:
            reason = f"a point may be wrong by {worst:.3g} m, over {allowed:.3g} m; solve more"

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
            coverage="thin" if reason else "covered",
            reason=reason,
            modes=vertex_modes(slopes, rows.compliance[np.flatnonzero(rows.seq == number)[0]]),
        )

    def _blend(
        self,
        component: Component,
        rows: Rows,
        wrench: Floats,
        hyperparameters: Hyperparameters | None,
    ) -> Blend:
        """Return the interpolation of the rows nearest to a wrench, from the cache if it has it."""
        readable = (self._read_row(component, row_wrench) for row_wrench in rows.wrench)
        first = next((row for row in readable if row is not None), None)
        if first is None:
            raise NoFieldsError(component, "all are damaged", rows=rows.seq.tolist())
        row_bytes = ARRAYS * _FLOAT_BYTES * (first.displacement.size + first.stress.size)
        limit = min(MAX_ROWS, max(MIN_ROWS, BLEND_BYTES // max(row_bytes, 1)))
        near = rows.take(nearest_rows(rows.wrench, wrench, component.load_range, limit))

        lengths = None if hyperparameters is None else hyperparameters.logarithms.tobytes()
        key = component.fingerprint, near.seq.tobytes(), lengths
        cached = self._blends.get(component.name)
        if cached is not None and cached[0] == key:
            self._blends.move_to_end(component.name)
            return cached[1]
        self._blends.pop(component.name, None)  # freed before the next takes as much memory

        near_rows = ((k, self._read_row(component, each)) for k, each in enumerate(near.wrench))
        read = {k: row for k, row in near_rows if row is not None}
        if not read:
            why = "those nearest to this wrench are damaged"
            raise NoFieldsError(component, why, rows=near.seq.tolist())
        # Another version of a mesher makes another mesh; all rows must have that of the last.
        mesh = read[max(read)].meta["geometry"]
        same_mesh = {index: row for index, row in read.items() if row.meta["geometry"] == mesh}
        used, fields = near.take([*same_mesh]), [*same_mesh.values()]

        try:
            geometry = self._geometry(component, fields[0])
            weights = FieldWeights.of(used.wrench, component.load_range, hyperparameters)
        except (DamagedFieldsError, SingularCovarianceError) as error:
            raise NoFieldsError(component, str(error), unusable=True) from error
        blend = Blend.of(geometry, weights, fields, tuple(used.seq.tolist()))
        self._blends[component.name] = key, blend
        while len(self._blends) > MAX_BLENDS:
            self._blends.popitem(last=False)
        return blend

    def _read_row(self, component: Component, wrench: Floats) -> RowFields | None:
        """Return the fields of the row at a wrench (6,); None if its file cannot be read."""
        try:
            return self._store.row(component.name, component.fingerprint, wrench.tolist())
        except DamagedFieldsError:
            return None

    def _geometry(self, component: Component, row: RowFields) -> SurfaceGeometry:
        return self._store.geometry(component.name, component.fingerprint, row.meta["geometry"])
