"""Displacements, error bars and coverage of a packed table on arrays: surrogate/kernel in short."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ..errors import InvalidArgument
from .axes import OFF_HULL, Axes, inputs_of
from .kriging import Kriging

# Numbers in a table's flags: METHODS of surrogate/answer.py.
METHODS = ("griddata", "additive", "tangent", "kriging", "linear", "nearest")
BATCHED = ("kriging", "griddata", "additive", "linear")
COVERED, THIN, OUTSIDE = 0, 1, 2
ADDITIVE, MISSED, KRIGING = 1, 2, 4  # bits of what errors are measured from: wb_internal.h
ROUNDING = 1e-12  # of an answer's size: wb_answer.c


class Answers(NamedTuple):
    """The answers to wrenches (k, n), or to one (n,).

    Attributes
    ----------
    displacement, error : array, shape (k, m), m and rad
        NaN where unknown. The error bar is the one of `Table.batch`.
    coverage : array of int, shape (k,)
        0 is covered, 1 thin, 2 outside.
    """

    displacement: Any
    error: Any
    coverage: Any


class Evaluator:
    """A function of wrenches (k, n) or (n,), SI, in the order of ``table.space.inputs``.

    `jax.evaluator` and `torch.evaluator` make one. It answers by interpolation alone, also where
    `Table.batch` takes the row at a wrench, which it does only where the method is not covered.
    Wrenches that are not finite are outside, with NaN.
    """

    def __init__(self, own: Any, table: Any, method: str | None, tolerance: Any) -> None:
        arrays = table.arrays()
        self.name, self.own, self.xp = table.name, own, own.xp
        self._arrays, self.table_space = arrays, table.space
        names = ("scale", "small", "ends", "tolerance", "limit", "vector_limit", "locked")
        self.space = {name: own.put(arrays[f"space/{name}"]) for name in names}
        self.free = own.put(1.0 - arrays["space/locked"])
        count = int(arrays["space/sizes"][2])
        limit = None if tolerance is None else table._allowed(tolerance)
        self.groups = [_Group(self, k, method, limit) for k in range(count)]
        names = ("mesh", "square", "one_over", "stiffness")
        self.solver = {name: own.put(arrays[f"solver/{name}"]) for name in names}
        self.flags = arrays["solver/flags"].tolist()
        self.none = not (arrays["solver/mesh"].any() or arrays["solver/square"].any())
        self.none = self.none and not self.flags[0]
        zero, rig = arrays.get("solver/zero"), arrays.get("space/rig_error")
        self.zero = None if zero is None else own.put(zero)
        self.rig = None if rig is None else own.put(rig)
        self.scene = {
            name: own.put(arrays[f"scene/{name}"])
            for name in ("ends", "varying", "slopes")
            if f"scene/{name}" in arrays
        }
        self._value = own.differentiable(self._values, self._slopes)
        self._judgement = own.batched(self._judge)

    def __call__(self, wrenches: Any) -> Answers:
        """Return displacements, error bars and coverage; only displacements have derivatives."""
        w, shape = self._rows(wrenches)
        moved = self._value(w)
        error, coverage, lost = self._judgement(self.own.stop(w), self.own.stop(moved))
        moved = self.xp.where(lost[:, None], np.nan, moved)
        moved, error = (one.reshape(*shape, one.shape[1]) for one in (moved, error))
        return Answers(moved, error, coverage.reshape(shape))

    def displacement(self, wrenches: Any) -> Any:
        """Return the displacements alone, shape (k, m) or (m,), m and rad.

        They are estimates where the table does not cover a wrench, however large.
        """
        w, shape = self._rows(wrenches)
        found = self._value(w)
        return found.reshape(*shape, found.shape[1])

    def derivative(self, wrenches: Any) -> Any:
        """Return du/dw, shape (k, m, n) or (m, n), SI: what differentiation gives, in one call."""
        w, shape = self._rows(wrenches)
        found = self._slopes(w)
        return found.reshape(*shape, *found.shape[1:])

    def _rows(self, wrenches: Any) -> tuple[Any, tuple[int, ...]]:
        """Return wrenches as an array (k, n), SI, and the shape that answers have before (m,)."""
        w = self.own.of(wrenches)
        inputs = self.free.shape[0]
        if w.ndim not in (1, 2) or w.shape[-1] != inputs:
            raise InvalidArgument(
                f"wrenches of {self.name} have the shape ({inputs},) or (k, {inputs}), "
                f"not {tuple(w.shape)}: the order of the inputs is table.space.inputs"
            )
        return w.reshape(-1, inputs), tuple(w.shape[:-1])

    def _acting(self, w: Any) -> Any:
        """Return inputs (k, n), SI, without those on locked freedoms."""
        return self.xp.where(self.free > 0, w, 0.0)

    def _values(self, w: Any) -> Any:
        w, xp = self._acting(w), self.xp
        found = xp.full_like(w[:, :1] + self.space["limit"], np.nan)
        for group in self.groups:
            found = xp.where(group.outputs, group.value(w), found)
        if self.scene:
            off = (w < self.scene["ends"][0]) | (w > self.scene["ends"][1])
            found = xp.where(
                (off & (self.scene["varying"] == 0)).any(axis=1)[:, None], np.nan, found
            )
        return found

    def _off_scene(self, w: Any) -> Any:
        """Return which inputs (k, n), SI, lie beyond those of the table's scene."""
        return (w < self.scene["ends"][0]) | (w > self.scene["ends"][1])

    def _slopes(self, w: Any) -> Any:
        w, xp = self._acting(w), self.xp
        found = xp.full_like(w[:, None, :] + self.solver["mesh"], np.nan)
        for group in self.groups:
            found = xp.where(group.outputs[:, None], group.slopes(w), found)
        if self.scene:
            found = xp.where(self.scene["slopes"] == 0, np.nan, found)
        return xp.where((self.free == 0) & ~xp.isnan(found), 0.0, found)

    def _judge(self, w: Any, moved: Any) -> tuple[Any, Any, Any]:
        """Return errors (k, m), m and rad, coverage (k,), and whether answers are given up (k,)."""
        xp, w = self.xp, self._acting(w)
        error, coverage = moved * np.nan, self.own.whole(moved[:, 0] != moved[:, 0]) * 0
        for group in self.groups:
            own, state = group.judge(w, moved)
            error = xp.where(group.outputs, own, error)
            coverage = xp.maximum(coverage, state)
        if self.scene:
            off = self._off_scene(w).any(axis=1)
            error = xp.where(off[:, None], np.nan, error)
            coverage = xp.where(off | xp.isnan(moved).all(axis=1), OUTSIDE, coverage)
        if not self.none:
            error = error + self._widening(w, moved)
        if self.rig is not None:
            error = error + self.rig
        if not self.flags[4]:
            for group in self.groups:
                error = xp.where(group.solved, np.nan, error)
        lost = (coverage != COVERED) & self._beyond_limits(moved)
        strange = ~xp.isfinite(w).all(axis=1)
        lost, coverage = lost | strange, xp.where(strange, OUTSIDE, coverage)
        return xp.where(lost[:, None], np.nan, error), coverage, lost

    def _widening(self, w: Any, moved: Any) -> Any:
        """Return the solver's share of errors, (k, m), m and rad: wb_reply.c, widen."""
        xp, solver = self.xp, self.solver
        size = abs(w if self.zero is None else w - self.zero)
        most = xp.clip(self.own.largest(size * solver["one_over"], 1), 0.0, None)
        small = size @ solver["mesh"].T
        more = solver["square"] * (most * most)[:, None]
        if self.flags[0] > 1:
            tangent = self._slopes(w)
            pushed = moved @ solver["stiffness"].T
            lacking = abs(xp.einsum("kqn,kn->kq", tangent, pushed))
            known = xp.isfinite(lacking).all(axis=1) & (abs(tangent).sum(axis=(1, 2)) > 0)
            more = xp.where(known[:, None], xp.clip(lacking - small, 0.0, None), more)
        return small + more

    def _beyond_limits(self, moved: Any) -> Any:
        """Return where no table may hold a displacement (k, m), m and rad: 20 degrees, 10 m."""
        xp = self.xp
        found = (abs(moved) > self.space["limit"]).any(axis=1)
        for k, first in enumerate(self._arrays["space/vector_first"].tolist()):
            three = xp.where(xp.isnan(moved), 0.0, moved)[:, first : first + 3]
            found = found | (xp.sqrt((three**2).sum(axis=1)) > self.space["vector_limit"][k])
        return found


class _Group:
    """The outputs that the same rows hold."""

    def __init__(self, whole: Evaluator, number: int, method: str | None, limit: Any) -> None:
        prefix, own = f"g{number}/", whole.own
        arrays = {
            k.removeprefix(prefix): v for k, v in whole._arrays.items() if k.startswith(prefix)
        }
        flags = arrays["flags"].tolist()
        self.own, self.xp, self.space = own, own.xp, whole.space
        self.reference, self.knows_interaction, self.rest_unknown = flags[1], flags[2], flags[3]
        self.exact, self.used = bool(flags[4]), bool(flags[5])
        self.method = method or METHODS[flags[0]]
        _check(whole.name, self.method, arrays, whole.table_space)
        self.outputs = own.put(arrays["outputs"].astype(bool))
        allowed = arrays["allowed"] if limit is None else np.array(limit)
        self.allowed = own.put(np.where(arrays["outputs"], allowed, np.inf))
        fit = _below(arrays, "fit/")
        self.fit = {name: own.put(one) for name, one in fit.items() if name != "rows"}
        self.parts: dict[str, Kriging] = {}
        for name in ("kriging", "missed"):
            if f"{name}/x" in arrays:
                self.parts[name] = Kriging(own, _below(arrays, f"{name}/"))
        if "axes/vertex" in arrays:
            small = whole._arrays["space/small"]
            self.axes = Axes(own, _below(arrays, "axes/"), fit, small)
        most = ROUNDING * abs(fit["matrix"]) @ whole._arrays["space/scale"]
        solved = self.method == "linear" and self.exact
        self.solved = own.put((fit["bar"] <= most) & solved & arrays["outputs"].astype(bool))

    def value(self, w: Any) -> Any:
        """Return displacements (k, m), m and rad; meaningful for the group's outputs."""
        if not self.used:
            return self.xp.full_like(w[:, :1] + self.allowed, np.nan)
        if self.method == "kriging":
            return self.parts["kriging"].values(w)
        if self.method == "linear":
            found = w @ self.fit["matrix"].T
            return found + self.fit["offset"] if "offset" in self.fit else found
        return self.axes.value(w, self.method == "additive")

    def slopes(self, w: Any) -> Any:
        """Return derivatives (k, m, n), SI; meaningful for the group's outputs."""
        if not self.used:
            return self.xp.full_like(w[:, None, :] + self.fit["matrix"], np.nan)
        if self.method == "kriging":
            return self.parts["kriging"].slopes(w)
        if self.method == "linear":
            return w[:, None, :] * 0.0 + self.fit["matrix"]
        return self.axes.slopes(w, self.method == "additive")

    def judge(self, w: Any, moved: Any) -> tuple[Any, Any]:
        """Return interpolation errors (k, m), m and rad, NaN if unknown, and coverage (k,)."""
        xp = self.xp
        beyond = ((w < self.space["ends"][0]) | (w > self.space["ends"][1])).any(axis=1)
        coverage = xp.where(beyond, OUTSIDE, COVERED)
        if not self.used:
            return moved * np.nan, coverage * 0 + OUTSIDE
        if self.method == "kriging" and self.reference & KRIGING:
            error = self.parts["kriging"].errors(w)
        elif self.method == "linear":
            error, unknown = self._linear(w, moved)
            coverage = xp.where(unknown, OUTSIDE, coverage)
        elif self.method == "kriging":
            error = self._referred(w, moved)[0]
        else:
            error, state = self._referred(w, moved)
            coverage = xp.where(state >= OFF_HULL, OUTSIDE, xp.where(state > 0, THIN, COVERED))
        return self._lowered(w, error, coverage)

    def _linear(self, w: Any, moved: Any) -> tuple[Any, Any]:
        """Return errors (k, m), m and rad, of the compliance, and where it lacks a load (k,)."""
        xp, fit = self.xp, self.fit
        size = abs(w) @ abs(fit["matrix"]).T
        if "offset" in fit:
            size = size + abs(fit["offset"])
        error = fit["bar"] + ROUNDING * size
        if not self.exact:
            error = xp.maximum(self._referred(w, moved)[0], error)
        unknown = ((fit["known"] == 0) & (abs(w) > self.space["small"])).any(axis=1)
        return xp.where(unknown[:, None], np.nan, error), unknown

    def _referred(self, w: Any, moved: Any) -> tuple[Any, Any]:
        """Return |answer - best estimate| + its error, (k, m), m and rad, and the axes' state."""
        xp, by_axes = self.xp, self.method in ("griddata", "additive")
        composed: Any = self.axes.compose(w) if by_axes or self.reference & ADDITIVE else None
        if self.reference & KRIGING:
            best, error = self.parts["kriging"].values(w), self.parts["kriging"].errors(w)
        else:
            best, squares = composed.moved, composed.squares
            if self.reference & MISSED:
                best = best + self.parts["missed"].values(w)
                squares = squares + self.parts["missed"].errors(w) ** 2
            error = xp.sqrt(squares)
        error = abs(moved - best) + error
        if not by_axes:
            return error, None
        off = (composed.state >= OFF_HULL)[:, None]
        return xp.where(off, xp.maximum(xp.sqrt(composed.squares), error), error), composed.state

    def _lowered(self, w: Any, error: Any, coverage: Any) -> tuple[Any, Any]:
        """Return errors (k, m), m and rad, and the coverage (k,) that they leave."""
        xp, loaded = self.xp, abs(w) > self.space["small"]
        if not self.knows_interaction:
            several = loaded[:, 0] | True
            for axis in range(3):
                foreign = [k for k in range(w.shape[1]) if k not in inputs_of(axis)]
                several = several & loaded[:, foreign].any(axis=1)
            coverage = xp.where((coverage == COVERED) & several, THIN, coverage)
        if self.rest_unknown:
            at_rest = ~loaded.any(axis=1)
            coverage = xp.where((coverage < OUTSIDE) & at_rest, OUTSIDE, coverage)
        over = (self.outputs & ~(error <= self.allowed)).any(axis=1)
        coverage = xp.where((coverage == COVERED) & over, THIN, coverage)
        known = (~self.outputs | xp.isfinite(error)).all(axis=1)
        return xp.where(known[:, None], error, np.nan), coverage


def _below(arrays: dict[str, Any], prefix: str) -> dict[str, Any]:
    return {k.removeprefix(prefix): v for k, v in arrays.items() if k.startswith(prefix)}


def _check(name: str, method: str, arrays: Any, space: Any) -> None:
    """Raise `InvalidArgument` if a group of outputs has not the method."""
    flags, axes = arrays["flags"].tolist(), "axes/vertex" in arrays
    reference, exact, used = flags[1], flags[4], flags[5]
    has = {
        "kriging": "kriging/x" in arrays and bool(reference),
        "linear": bool(exact or reference),
        "griddata": axes and bool(reference),
        "additive": axes and bool(reference),
    }
    if has.get(method) or (method in BATCHED and not used):
        return
    usable = ", ".join(one for one, known in has.items() if known) or "none: it has too few rows"
    if method in ("griddata", "additive") and not space.is_default:
        count = len(space.inputs)
        why = f"{method} exists for one wrench at one interface alone; {name} has {count} inputs"
    elif method in BATCHED:
        why = f"the table of {name} has no {method}"
    else:
        why = f"{method!r} does not answer in batches ({', '.join(BATCHED)} do)"
    raise InvalidArgument(f"{why}. Methods of this table in batches: {usable}")
