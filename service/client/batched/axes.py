"""The triangulations of a packed table on arrays: wb_axes.c, wb_hull.c, wb_compose.c of the kernel.

Simplices are found by testing all of them, and points off a hull by all of its facets.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

CLEAN = 1e-9  # of the range: below it a load counts as none (wb_axes.c)
ON_HULL = 1e-9  # of the range: a point that far beyond the hull counts as on it (wb_walk.c)
ROUNDINGS = 10  # of a number: what barycentric coordinates lose, where that is more than ON_HULL
WEAK, DEGENERATE, OFF_HULL, NO_ROWS = 1, 2, 9, 10  # wb_internal.h
TESTS = 1 << 20  # simplices and facets times wrenches at once: some 100 MB


class Part(NamedTuple):
    """What an axis or a moment alone answers.

    Attributes
    ----------
    outputs, rest : array, shape (k, 6), m and rad
        The displacement and its error.
    slopes : array, shape (k, 6, 3) of an axis, (k, 6) of a moment, SI
    state : array of int, shape (k,)
    """

    outputs: Any
    rest: Any
    slopes: Any
    state: Any


class Composed(NamedTuple):
    """Three axes together: wb_composed. Shapes (k, 6) and (k, 3), m and rad, and (k,)."""

    moved: Any
    squares: Any
    own: Any
    state: Any


def inputs_of(axis: int) -> list[int]:
    """Return the places of an axis' three loads."""
    return [axis, 3 + (axis + 1) % 3, 3 + (axis + 2) % 3]


class Axes:
    """The three axes of a table of the default space.

    Parameters
    ----------
    own : Backend
    arrays : mapping
        Those of surrogate/packed/axes_arrays.py.
    fit : mapping
        ``matrix`` (6, 6), ``bar`` (6) and ``known`` (6) of the fitted compliance, SI.
    small : ndarray, shape (6,), N and N·m
        Loads below it count as none.
    """

    def __init__(self, own: Any, arrays: Mapping[str, Any], fit: Any, small: Any) -> None:
        self.own, self.xp = own, own.xp
        self.rest, self.small = own.put(arrays["rest_point"]), own.put(small)
        self.axes = [_Axis(own, arrays, fit, axis) for axis in range(3)]
        self.cuts = [_cuts(own, arrays, moment) for moment in range(3)]
        self.known = fit["known"].astype(bool).tolist()
        self.matrix, self.bar = own.put(fit["matrix"]), own.put(fit["bar"])

    def value(self, w: Any, additive: bool) -> Any:
        """Return the displacement (k, 6), m and rad, under wrenches (k, 6), N and N·m."""
        found = self.compose(w)
        if additive:
            return found.moved
        return self.xp.concatenate((found.own, found.moved[:, 3:]), axis=1)

    def compose(self, w: Any) -> Composed:
        """Return the axes and single moments together, under wrenches (k, 6), N and N·m."""
        xp, loaded = self.xp, abs(w) > self.small
        zero = xp.zeros_like(w)
        moved, squares, times = zero, zero, zero[:, 0]
        own = [zero[:, 0] + self.rest[0, axis] for axis in range(3)]
        states = [self.own.whole(zero[:, 0] > 0)] * 3
        for axis in range(3):
            force, first, second = (loaded[:, load] for load in inputs_of(axis))
            needs, part = force | (first & second), self.axes[axis].read(w)
            own[axis] = xp.where(needs, part.outputs[:, axis], own[axis])
            states[axis] = xp.where(needs, part.state, 0)
            moved, squares = self._add(moved, squares, part, xp.where(needs, 1.0, zero[:, 0]))
            times = times + needs
        for m in range(3):
            active, alone, base = loaded[:, 3 + m], self._alone(m, w[:, 3 + m]), (m + 2) % 3
            count = xp.where(active, -1.0, zero[:, 0])
            for axis, other in ((base, 3 + (m + 1) % 3), ((m + 1) % 3, 3 + (m + 2) % 3)):
                takes = active & ~(loaded[:, axis] | loaded[:, other])
                count = count + takes
                own[axis] = xp.where(takes, alone.outputs[:, axis], own[axis])
                worse = xp.maximum(states[axis], alone.state)
                states[axis] = xp.where(takes, worse, states[axis])
            worse = xp.maximum(states[base], alone.state)
            states[base] = xp.where(count != 0, worse, states[base])
            moved, squares = self._add(moved, squares, alone, count)
            times = times + count
        rest = Part(self.rest[0] + zero, self.rest[1] + zero, None, None)
        moved, squares = self._add(moved, squares, rest, 1.0 - times)
        state = xp.maximum(xp.maximum(states[0], states[1]), states[2])
        return Composed(moved, squares, xp.stack(own, axis=1), state)

    def _add(self, moved: Any, squares: Any, part: Part, times: Any) -> tuple[Any, Any]:
        """Return sums (k, 6), m and rad, and their squared errors, with a part so often more."""
        times, xp = times[:, None], self.xp
        wide = times * part.rest
        return (
            xp.where(times != 0, moved + times * part.outputs, moved),
            xp.where(times != 0, squares + wide * wide, squares),
        )

    def slopes(self, w: Any, additive: bool) -> Any:
        """Return the derivative (k, 6, 6), SI, of the law with all axes and moments in it."""
        xp = self.xp
        columns = [xp.zeros_like(w) for _ in range(6)]
        for axis in range(3):
            takes = self.own.put(np.arange(6) >= (0 if additive else 3)) | (
                self.own.arange(6) == axis
            )
            slopes = self.axes[axis].read(w).slopes
            for place, load in enumerate(inputs_of(axis)):
                columns[load] = columns[load] + xp.where(takes, slopes[:, :, place], 0.0)
        takes = self.own.put(np.arange(6) >= (0 if additive else 3))
        for m in range(3):
            slopes = self._alone(m, w[:, 3 + m]).slopes
            columns[3 + m] = columns[3 + m] - xp.where(takes, slopes, 0.0)
        return xp.stack(columns, axis=2)

    def _alone(self, moment: int, amount: Any) -> Part:
        """Return the answer to one moment (k,), N·m, alone: wb_compose.c, read_alone."""
        xp, slope = self.xp, self.matrix[:, 3 + moment]
        zero = xp.zeros_like(amount)[:, None]
        rest = abs(amount)[:, None] * abs(slope) + self.bar
        if not self.known[3 + moment]:
            rest = xp.where(amount[:, None] != 0, np.nan, rest)
        outputs = self.rest[0] + amount[:, None] * slope
        found: Any = (outputs, rest, zero + slope)
        state = self.own.whole(zero[:, 0] > 0) + NO_ROWS
        for cut in self.cuts[moment]:
            part = cut.read(amount)
            better = (state >= OFF_HULL) & (part.state < state)
            if part.outputs is not None:
                both = zip(part[:3], found, strict=True)
                found = [xp.where(better[:, None], new, old) for new, old in both]
            state = xp.where(better, part.state, state)
        return Part(found[0], found[1], found[2], state)


class _Cut:
    """The answers to one moment alone by one axis: piecewise polynomials."""

    def __init__(self, own: Any, cut: Mapping[str, Any], scale: float, error: Any) -> None:
        self.own, self.xp, self.scale = own, own.xp, scale
        self.error = own.put(error)
        self.arrays = {name: own.put(one) for name, one in cut.items()}

    def read(self, amount: Any) -> Part:
        """Return what the moment (k,), N·m, gives; None without stretches of one moment alone."""
        xp, a = self.xp, self.arrays
        stretches = a["state"].shape[0]
        if not stretches:
            return Part(None, None, None, self.own.whole(amount != amount) + OFF_HULL)
        along, stations = amount / self.scale, a["stations"]
        place = (stations <= along[:, None]).sum(axis=1) - 1
        place = xp.clip(place, 0, stretches - 1)
        off = (along < stations[0] - ON_HULL) | (along > stations[-1] + ON_HULL)
        y = (along - stations[place])[:, None]
        values, stated, unit = a["outputs"][place], a["stated"][place], a["unit"][place]
        unit = xp.clip(unit[:, :1] + y * (unit[:, 1:2] + y * unit[:, 2:]), 0.0, None)
        rest = stated[:, 0] + y * stated[:, 1]
        rest = rest + xp.sqrt(self.error[0] + self.error[1] * unit * unit)
        state = xp.where(off, OFF_HULL, a["state"][place])
        slopes = values[:, 1] / self.scale
        return Part(values[:, 0] + y * values[:, 1], rest, slopes, state)


def _cuts(own: Any, arrays: Mapping[str, Any], moment: int) -> list[_Cut]:
    found = []
    for which in range(2):
        names = ("stations", "outputs", "stated", "unit", "state")
        if f"cut{moment}{which}/state" in arrays:
            axis = (moment + (1 if which else 2)) % 3
            cut = {name: arrays[f"cut{moment}{which}/{name}"] for name in names}
            scale = float(arrays["floats"][axis, 1 + which])
            found.append(_Cut(own, cut, scale, arrays["error"][axis]))
    return found


class _Axis:
    """One axis' triangulation."""

    def __init__(self, own: Any, arrays: Mapping[str, Any], fit: Any, axis: int) -> None:
        self.own, self.xp, self.loads = own, own.xp, inputs_of(axis)
        self.dimension = int(arrays["ints"][axis, 0])
        self.matrix, self.bar = own.put(fit["matrix"][:, self.loads]), own.put(fit["bar"])
        self.known = own.put(fit["known"][self.loads].astype(bool))
        self.rest_point = own.put(arrays["rest_point"][0])
        if self.dimension < 0:
            return
        floats, first = arrays["floats"][axis], arrays["simplex_first"]
        ours = slice(int(first[axis]), int(first[axis + 1]))
        basis = floats[6:15].reshape(3, 3).copy()
        basis[self.dimension :] = 0.0
        self.scale, self.origin, self.basis = (
            own.put(one) for one in (floats[:3], floats[3:6], basis)
        )
        self.slack = max(float(floats[15]), ROUNDINGS * own.rounding)
        self.on_hull = max(ON_HULL, ROUNDINGS * own.rounding)
        self.untold = bool(arrays["together"][axis] < arrays["left_out"][3])
        simplex = arrays["simplex"][ours]
        vertex = np.ascontiguousarray(simplex[:, :4]).view(np.int32)[:, :4].copy()
        vertex[:, 3] = vertex[:, self.dimension]
        vertex[:, self.dimension : 3] = 0
        maps, anchors = simplex[:, 4:13].reshape(-1, 3, 3), simplex[:, 13:]
        self.vertex, self.maps, self.anchors = own.put(vertex), own.put(maps), own.put(anchors)
        ways = [maps[:, corner] for corner in range(self.dimension)]  # of the coordinates of all
        self.tests = [(own.put(way.T), own.put((way * anchors).sum(axis=1))) for way in ways]
        self.state = own.put(arrays["state"][ours].astype(np.int32))
        self.degenerate = own.put(arrays["state"][ours] == DEGENERATE)
        self.error = own.put(arrays["error"][axis])
        points = arrays["vertex"]
        self.place, self.values, self.uncertainty = (
            own.put(one) for one in (points[:, :3], points[:, 4:10], points[:, 10:])
        )
        self.point_slopes = own.put(arrays["slopes"])
        self._off_span(own, basis, fit, floats[:3])
        outer = np.einsum("scj,ji->sci", maps[:, : self.dimension], basis)
        rises = points[vertex[:, : self.dimension], 4:10] - points[vertex[:, 3], None, 4:10]
        self.slopes = own.put(np.einsum("scq,sci->sqi", rises, outer))
        facets = arrays["facets"][arrays["facet_first"][axis] : arrays["facet_first"][axis + 1]]
        self.behind = own.put(facets[:, 3] - ours.start)
        corners = points[facets[:, : max(self.dimension, 1)], :3]
        self.corners = [own.put(corners[:, k]) for k in range(corners.shape[1])]

    def _off_span(self, own: Any, basis: Any, fit: Any, scale: Any) -> None:
        """Keep the slopes (6, 3) off the span of the points, NaN by loads that the fit lacks."""
        along = basis.T @ basis if self.dimension < 3 else np.eye(3)
        off = np.eye(3) - along
        off[abs(off) <= CLEAN] = 0.0
        slopes = scale * fit["matrix"][:, self.loads] @ off.T
        unknown = ((off != 0) & ~fit["known"][self.loads].astype(bool)).any(axis=1)
        self.off_slopes = own.put(np.where(unknown, np.nan, slopes))
        self.along = own.put(along)

    def read(self, w: Any) -> Part:
        """Return the axis' part under wrenches (k, 6), N and N·m; slopes by its three loads."""
        own, xp, loads = self.own, self.xp, w[:, self.loads]
        if self.dimension < 0:
            return self._guess(loads)
        x = loads / self.scale
        flat = self._flat(x)
        foot = x if self.dimension == 3 else self.origin + flat @ self.basis
        tests = self.state.shape[0] + 8 * self.behind.shape[0]
        size = max(TESTS // tests, 1)
        found, in_plane, at = own.chunks(self._search, size, flat, foot)
        inside = in_plane
        if self.dimension < 3:
            inside = inside & (abs(x - foot) <= self.slack).all(axis=1)
            at = xp.where(in_plane[:, None], foot, at)
        at = xp.where(inside[:, None], x, own.stop(at))
        shares = self._shares(found, self._flat(at))
        vertex = self.vertex[found]
        values = xp.einsum("kc,kcq->kq", shares, self.values[vertex])
        rest = xp.einsum("kc,kcq->kq", shares, self.uncertainty[vertex])
        unit = (shares * ((at[:, None, :] - self.place[vertex]) ** 2).sum(axis=2)).sum(axis=1)
        unit = xp.clip(0.5 * unit, 0.0, None)[:, None]
        rest = rest + xp.sqrt(self.error[0] + self.error[1] * (unit * unit))
        blended = xp.einsum("kc,kcqi->kqi", shares, self.point_slopes[vertex]) @ self.along
        step = x - at
        more = xp.einsum("kqi,ki->kq", blended, step)
        values, rest = values + more, rest + abs(more)
        if self.dimension < 3:
            values, rest = self._off_plane(step, inside, values, rest)
        slopes = xp.where(inside[:, None, None], self.slopes[found], blended)
        state = self.state[found]
        if self.untold:
            several = (abs(x) > CLEAN).sum(axis=1) > 1
            state = xp.where(several, xp.clip(state, WEAK, None), state)
        state = xp.where(inside, state, OFF_HULL)
        return Part(values, rest, (slopes + self.off_slopes) / self.scale, state)

    def _guess(self, loads: Any) -> Part:
        """Return the fitted compliance's part: the axis has no rows."""
        xp = self.xp
        size = abs(loads) @ abs(self.matrix).T + self.bar
        unknown = ((loads != 0) & ~self.known).any(axis=1)
        rest = xp.where(unknown[:, None], np.nan, size)
        state = self.own.whole(unknown & ~unknown) + NO_ROWS
        slopes = self.matrix + xp.zeros_like(size)[:, :, None]
        return Part(self.rest_point + loads @ self.matrix.T, rest, slopes, state)

    def _flat(self, x: Any) -> Any:
        return x if self.dimension == 3 else (x - self.origin) @ self.basis.T

    def _shares(self, simplex: Any, flat: Any) -> Any:
        apart = flat - self.anchors[simplex]
        first = self.xp.einsum("kcj,kj->kc", self.maps[simplex], apart)
        return self.xp.concatenate((first, 1.0 - first.sum(axis=1)[:, None]), axis=1)

    def _search(self, flat: Any, place: Any) -> tuple[Any, Any, Any]:
        """Return the simplex (k,), whether it holds the point, and the hull's nearest (k, 3)."""
        xp, own = self.xp, self.own
        if not self.dimension:
            whole = own.whole(flat[:, 0] != flat[:, 0])
            return whole, whole == 0, place
        first = [flat @ way - start for way, start in self.tests]
        least = 1.0 - sum(first)
        for share in first:
            least = xp.minimum(least, share)
        least = xp.where(self.degenerate, -np.inf, least)
        best = xp.argmax(least, axis=1)
        inside = own.along(least, best[:, None], 1)[:, 0] >= -self.on_hull
        near = self._on_facets(place)
        away = ((near - place[:, None, :]) ** 2).sum(axis=2)
        facet = xp.argmin(away, axis=1)
        at = own.along(near, facet[:, None, None] + own.arange(3) * 0, 1)[:, 0]
        return xp.where(inside, best, self.behind[facet]), inside, at

    def _on_facets(self, x: Any) -> Any:
        """Return the nearest points (k, f, 3) of the hull's facets to points (k, 3)."""
        xp, corners = self.xp, self.corners
        x = x[:, None, :]
        if len(corners) == 1:
            return corners[0] + xp.zeros_like(x)
        best = _on_stretch(xp, corners[0], corners[1], x)
        if len(corners) == 2:
            return best
        e, f, apart = corners[1] - corners[0], corners[2] - corners[0], x - corners[0]
        ee, ef, ff = (e * e).sum(axis=-1), (e * f).sum(axis=-1), (f * f).sum(axis=-1)
        pe, pf, area = (apart * e).sum(axis=-1), (apart * f).sum(axis=-1), ee * ff - ef * ef
        s, t = (ff * pe - ef * pf) / area, (ee * pf - ef * pe) / area
        away = ((best - x) ** 2).sum(axis=-1)
        for edge in (1, 2):
            place = _on_stretch(xp, corners[edge], corners[(edge + 1) % 3], x)
            own = ((place - x) ** 2).sum(axis=-1)
            best = xp.where((own < away)[:, :, None], place, best)
            away = xp.minimum(own, away)
        foot = corners[0] + s[:, :, None] * e + t[:, :, None] * f
        holds = (s >= 0) & (t >= 0) & (s + t <= 1)
        return xp.where(holds[:, :, None], foot, best)

    def _off_plane(self, step: Any, inside: Any, values: Any, rest: Any) -> tuple[Any, Any]:
        """Return values and errors (k, 6), m and rad, with the step off what the points span."""
        xp = self.xp
        off = step - step @ self.along
        takes = ((abs(off) > CLEAN).any(axis=1) & ~inside)[:, None]
        unknown = ((abs(off) > CLEAN) & ~self.known).any(axis=1)[:, None]
        loads = off * self.scale
        wide = rest + (abs(loads) @ abs(self.matrix).T + self.bar)
        values = xp.where(takes, values + loads @ self.matrix.T, values)
        return values, xp.where(takes, xp.where(unknown, np.nan, wide), rest)


def _on_stretch(xp: Any, a: Any, b: Any, x: Any) -> Any:
    """Return the nearest points (k, f, 3) of stretches from a to b (f, 3), dimensionless."""
    along = b - a
    length = xp.clip((along * along).sum(axis=-1), LEAST_LENGTH, None)
    share = xp.clip(((x - a) * along).sum(axis=-1) / length, 0.0, 1.0)
    return a + share[:, :, None] * along


LEAST_LENGTH = 1e-30  # squared, of a stretch of the hull: one of no length has no direction
