"""Checks of a table against laws of physics that hold for any component; they name violating rows.

Zero at zero load. A compliance that is symmetric (Maxwell and Betti) and positive. Work of a load
on its displacement that is positive, and grows from row to row along a ray and between neighbours.
Tangents that lead from a row to its neighbour. For several interfaces these hold for all their
loads together; the laws of work are for tables without further inputs, since heat works too.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial import KDTree
from scipy.special import ndtri, stdtrit

from ..calibration import LEVEL
from .compliance import ComplianceFit
from .rows import ZERO_LOAD, Floats, LoadRange, Rows, Tolerance
from .second_derivatives import symmetric_tangents
from .space import Space

# Parts of an output's largest value that count as zero and equal, and as linear.
ZERO, LINEAR = 1e-3, 1e-2
ASYMMETRY = 5e-2  # largest asymmetry of tangents: turning loads cause as much as the rotation
# Largest asymmetry of a solve's tangent by (F, mu): at the ends of their ranges the shipped
# components' are symmetric to 2e-11, but a linear deck's compliance may be off its solves by this
# much (fea/deck/solving.py).
SOLVED_ASYMMETRY = 1e-5
NEGATIVE = 1e-6  # part of the largest eigenvalue, or of an output: rounding of solvers
# Largest error of the step that the mean tangent of two neighbours predicts: a part of the step,
# and a part of an output's largest value, so that rounding does not decide on small steps.
TANGENT, SMALL_STEP = 0.5, 0.05
NEIGHBOURS = 3  # neighbours of each row with which it is compared
MAX_FARTHEST = 5  # examples of rows that deviate most from one matrix
NEAR = 1.0  # half load ranges: over longer steps a tangent changes by more than `TANGENT`
NEGLIGIBLE = 1e-2  # part of the largest translation or rotation: smaller outputs are not checked
MAX_LISTED = 50  # rows that a check lists
_OPEN = "within the uncertainty of the fit, so that only more rows show whether it is real"
_NOISY = "within the noise of the readings, so that only more rows show whether it is real"


def check_physics(
    rows: Rows, load_range: LoadRange, fit: ComplianceFit, tolerance: Tolerance | None = None
) -> dict[str, Any]:
    """Return all checks of the rows in the load range with every output, as JSON-able values.

    Deviations below the uncertainty of a row, and below the tolerance, violate no law: by default
    the tolerance is `ZERO` of the largest translation or rotation.
    """
    used = load_range.holds(rows.wrench)  # as for answers
    complete = rows.take(used & np.isfinite(rows.displacement).all(axis=1))
    if not len(complete):
        return {"rows_checked": 0, "ok": None, "checks": {}}
    space = load_range.space
    # Deviations that are within uncertainty, (m,), m and rad.
    if tolerance is None:
        noise = ZERO * space.largest_of_kind(np.abs(complete.displacement).max(axis=0))
    else:
        noise = np.where(space.is_rotation, tolerance.rotation, tolerance.translation)
    uncertain = np.nan_to_num(complete.uncertainty) + noise
    checks = {
        "zero_at_zero_load": _zero(complete, load_range, noise),
        "symmetric": _symmetric(complete, load_range, fit),
        "positive": _positive(complete, load_range, fit),
        "linear": _linear(complete, space, fit),
        "work": _work(complete, load_range, uncertain),
        "tangents": _tangents(complete, load_range, uncertain),
    }
    # Nonlinearity violates no law.
    broken = [check for name, check in checks.items() if name != "linear" and check["ok"] is False]
    return {"rows_checked": len(complete), "ok": not broken, "checks": checks}


def _sizes(rows: Rows, space: Space) -> Floats:
    """Return each output's largest value, (m,), at least `NEGLIGIBLE` of its kind's largest."""
    largest = np.abs(rows.displacement).max(axis=0)
    kinds = space.largest_of_kind(largest)
    return np.maximum(largest, np.maximum(NEGLIGIBLE * kinds, np.finfo(float).tiny))


def _listed(rows: Rows, wrong: np.ndarray) -> list[int]:
    return rows.seq[wrong][:MAX_LISTED].tolist()


def _zero(rows: Rows, load_range: LoadRange, noise: Floats) -> dict[str, Any]:
    """Check that rows at zero load are not displaced, each alone and on average."""
    space = load_range.space
    loads = (rows.wrench - space.zero) / load_range.scale
    unloaded = (np.abs(loads) <= ZERO_LOAD).all(axis=1)
    if not unloaded.any():
        return {"ok": None, "reason": "no row at zero load; add one without load", "rows": []}
    zero = rows.take(unloaded)
    size, stated = np.abs(zero.displacement), np.nan_to_num(zero.uncertainty)
    limit = ZERO * _sizes(rows, space) + noise
    half_widths = _half_widths_at_zero(zero, rows.take(~unloaded), loads[~unloaded])
    # Independent noise averages out; a stated uncertainty may be common to all rows.
    averaged = np.linalg.norm(half_widths, axis=0) / len(zero)
    averaged = np.where(stated.any(axis=0), half_widths.max(axis=0), averaged)
    shifted = (np.abs(zero.displacement.mean(axis=0)) > limit + averaged).any()
    over = (size > limit + stated).any(axis=1)
    wrong = (size > limit + half_widths).any(axis=1) | (over & shifted)
    is_open = bool(over.any() and not wrong.any())
    return {
        "ok": None if is_open else not wrong.any(),
        **({"reason": _NOISY} if is_open else {}),
        "displacement": dict(zip(space.output_names, size.max(axis=0).tolist(), strict=True)),
        "rows": _listed(zero, wrong),
    }


def _half_widths_at_zero(zero: Rows, loaded: Rows, loads: Floats) -> Floats:
    """Return half widths (n, m) of rows at zero load, together with their mean at `LEVEL`.

    Of a stated uncertainty, or of the residuals of the loaded rows from a line; 0 of solves.
    """
    statements = (len(zero) + 1) * zero.displacement.shape[1]
    line = np.column_stack((loads, np.ones(len(loaded))))
    residual = loaded.displacement - line @ np.linalg.lstsq(line, loaded.displacement)[0]
    noise = _noise(residual, line, statements)
    is_exact = (zero.is_solved | zero.has_tangent)[:, None]
    stated = np.nan_to_num(zero.uncertainty) / ndtri((1 + LEVEL) / 2) * ndtri(_together(statements))
    return np.where(stated > 0, stated, np.where(is_exact, 0.0, noise))


def _together(statements: int) -> float:
    """Return the one-sided level of each of several half widths that together hold at `LEVEL`."""
    return 1 - (1 - LEVEL) / 2 / statements  # Bonferroni


def _noise(residual: Floats, terms: Floats, statements: int) -> Floats:
    """Return half widths (m,) of readings, together at `LEVEL`, by residuals of a fit of terms.

    Infinite if there are no more readings than unknowns.
    """
    spare = len(residual) - int(np.linalg.matrix_rank(terms)) if len(residual) else 0
    if spare < 1:
        return np.full(residual.shape[1], np.inf)
    quantile = stdtrit(spare, _together(statements))
    return np.asarray(quantile * np.sqrt((residual**2).sum(axis=0) / spare))


def _energies(matrices: Floats, load_range: LoadRange) -> Floats:
    """Return compliances (..., m, n) in units of energy: load i times its displacement by load j.

    Shape (..., m, m): loads, of which there are as many as outputs, stand before other inputs.
    """
    scale = load_range.scale[: matrices.shape[-2]]
    return matrices[..., : len(scale)] * scale[:, None] * scale[None, :]


def _half_widths_of_mirrors(rows: Rows, load_range: LoadRange, fit: ComplianceFit) -> Floats:
    """Return half widths (m, m) of the differences of a fit's mirror energies, together at `LEVEL`.

    By the residuals of the rows from the fit; 0 of a compliance that is not fitted.
    """
    count = rows.displacement.shape[1]
    if fit.origin != "fitted":
        return np.zeros((count, count))
    scaled = (rows.wrench - load_range.space.zero) / load_range.scale
    residual = rows.displacement - rows.wrench @ fit.matrix.T - fit.offset
    noise = _noise(residual, scaled, max(1, count * (count - 1) // 2)) * load_range.scale[:count]
    # Of the entry of output i by load j, in energy. The part of a load that no row varies is 0.
    parts = np.diag(np.linalg.pinv(scaled.T @ scaled))[:count]
    entries = noise[:, None] ** 2 * np.maximum(parts, np.finfo(float).tiny)
    return np.asarray(np.sqrt(entries + entries.T))


def _asymmetry(energies: Floats) -> Floats:
    largest = np.abs(energies).max(axis=(-2, -1))
    differences = np.abs(energies - np.swapaxes(energies, -2, -1)).max(axis=(-2, -1))
    return differences / np.maximum(largest, np.finfo(float).tiny)


def _solved_asymmetry(rows: Rows, load_range: LoadRange) -> Floats:
    """Return the asymmetry of solves' tangents by work-conjugate loads, (n,).

    These loads are (F, mu) for a nonlinear solve and (F, M) for a linear one, in which rotations
    are small and mu is M. A row does not state its kind; a wrong tangent is symmetric in neither.
    """
    turned = symmetric_tangents(rows.wrench, rows.displacement, rows.compliance, load_range.space)
    energies = (_energies(tangent, load_range) for tangent in (rows.compliance, turned))
    return np.fmin(*map(_asymmetry, energies))


def _symmetric(rows: Rows, load_range: LoadRange, fit: ComplianceFit) -> dict[str, Any]:
    """Check the symmetry of tangents and of the fitted compliance."""
    energies = _energies(fit.matrix, load_range)
    loads = fit.known[: len(energies)]
    energies = np.where(np.outer(loads, loads), energies, 0.0)
    asymmetry = float(_asymmetry(energies))
    apart = np.abs(energies - energies.T)
    half_widths = _half_widths_of_mirrors(rows, load_range, fit)
    is_sure = apart > np.maximum(ASYMMETRY * np.abs(energies).max(), half_widths)
    known, solved = rows.has_tangent, rows.is_solved
    wrong = np.zeros(len(rows), dtype=bool)
    wrong[known] = _asymmetry(_energies(rows.compliance[known], load_range)) > ASYMMETRY
    solves = _solved_asymmetry(rows.take(known & solved), load_range)
    wrong[known & solved] = solves > SOLVED_ASYMMETRY
    broken, is_open = bool(wrong.any() or is_sure.any()), asymmetry > ASYMMETRY
    return {
        "ok": False if broken else None if is_open else True,
        **({"reason": _OPEN} if is_open and not broken else {}),
        "asymmetry": asymmetry,
        "allowed": ASYMMETRY,
        "asymmetry_of_solves": float(solves.max()) if len(solves) else None,
        "allowed_of_solves": SOLVED_ASYMMETRY,
        "rows": _listed(rows, wrong),
    }


def _extreme_eigenvalues(energies: Floats) -> tuple[Floats, Floats]:
    """Return the smallest and largest eigenvalues of the symmetric parts, (...)."""
    values = np.linalg.eigvalsh((energies + np.swapaxes(energies, -2, -1)) / 2)
    low = values[..., 0]
    high = np.maximum(values[..., -1], np.finfo(float).tiny)
    return np.asarray(low, dtype=float), np.asarray(high, dtype=float)


def _positive(rows: Rows, load_range: LoadRange, fit: ComplianceFit) -> dict[str, Any]:
    """Check that tangents and the fitted compliance are positive definite."""
    energies = _energies(fit.matrix, load_range)
    known = np.flatnonzero(fit.known[: len(energies)])
    energies = energies[np.ix_(known, known)]
    smallest, largest = np.float64(0), np.float64(1)
    if len(known):
        smallest, largest = _extreme_eigenvalues(energies)
    # An eigenvalue may be negative by as much as the fit's asymmetry, an error of the fit.
    fitted = min(ASYMMETRY, float(_asymmetry(energies))) if len(known) else 0.0
    with_tangent = rows.has_tangent
    wrong = np.zeros(len(rows), dtype=bool)
    low, high = _extreme_eigenvalues(_energies(rows.compliance[with_tangent], load_range))
    wrong[with_tangent] = low < -NEGATIVE * high
    names = load_range.space.input_names
    idle = np.abs(energies).max(axis=1, initial=0.0) < NEGATIVE * largest
    return {
        "ok": bool(smallest >= -max(NEGATIVE, fitted) * largest and not wrong.any()),
        "smallest_over_largest_eigenvalue": float(smallest / largest),
        "loads_without_influence": [names[load] for load in known[idle]],
        "rows": _listed(rows, wrong),
    }


def _linear(rows: Rows, space: Space, fit: ComplianceFit) -> dict[str, Any]:
    """Return how far the rows are from one matrix, and name the farthest."""
    known = ((rows.wrench == space.zero) | fit.known).all(axis=1)
    if not known.any() or fit.origin == "none":
        return {"ok": None, "reason": "the rows fix no compliance; vary each load", "rows": []}
    residual = np.abs(rows.displacement - rows.wrench @ fit.matrix.T - fit.offset) / _sizes(
        rows, space
    )
    residual = np.where(known[:, None], residual, 0.0)
    index = float(residual.max())
    farthest = np.argsort(-residual.max(axis=1))[:MAX_FARTHEST]
    ok = index <= LINEAR
    matrix = "one 6x6 compliance" if space.is_default else "one compliance"
    says = f"{matrix} describes all rows within {index:.2%} of each output's largest value"
    if not ok:
        says = f"the rows deviate from {matrix} by up to {index:.2%} of an output's largest value"
        says += "; use the table's answers in place of the matrix"
    return {
        "ok": ok,
        "index": index,
        "per_output": dict(zip(space.output_names, residual.max(axis=0).tolist(), strict=True)),
        "says": says,
        "rows": [] if ok else rows.seq[farthest].tolist(),
    }


def _work(rows: Rows, load_range: LoadRange, uncertain: Floats) -> dict[str, Any]:
    """Check that loads do positive work, alone and on the way to the nearest other row."""
    if load_range.space.scalars:
        return {"ok": None, "reason": "temperature and acceleration do work too", "rows": []}
    uncertainty = uncertain + NEGATIVE * _sizes(rows, load_range.space)
    work = (rows.wrench * rows.displacement).sum(axis=1)
    wrong = work < -(np.abs(rows.wrench) * uncertainty).sum(axis=1)
    backward = 0
    pairs = _neighbours(rows, load_range)
    if len(pairs):
        first, second = pairs.T
        step = rows.wrench[second] - rows.wrench[first]
        gain = (step * (rows.displacement[second] - rows.displacement[first])).sum(axis=1)
        back = gain < -(np.abs(step) * (uncertainty[first] + uncertainty[second])).sum(axis=1)
        backward = int(back.sum())
        # Of a pair that violates the law, the row in more such pairs is the wrong one.
        blamed = np.bincount(pairs[back].reshape(-1), minlength=len(rows))
        wrong |= blamed > 1
        lone = back & (blamed[first] < 2) & (blamed[second] < 2)
        wrong[np.unique(pairs[lone])] = True
    return {
        "ok": not wrong.any(),
        "least_work": float(work.min()),
        "pairs_that_give_work_back": backward,
        "rows": _listed(rows, wrong),
    }


def _tangents(rows: Rows, load_range: LoadRange, uncertain: Floats) -> dict[str, Any]:
    """Check that the mean of two neighbours' tangents leads from one to the other."""
    with_tangent = np.flatnonzero(rows.has_tangent)
    solved = rows.take(with_tangent)
    pairs = _neighbours(solved, load_range)
    if not len(pairs):
        return {"ok": None, "reason": "fewer than two tangents; solve more rows", "rows": []}
    steps = solved.wrench[pairs[:, 1]] - solved.wrench[pairs[:, 0]]
    near = np.linalg.norm(steps / load_range.scale, axis=1) <= NEAR
    if not near.any():
        return {"ok": None, "reason": "tangents too far apart; solve rows between", "rows": []}
    (first, second), step = pairs[near].T, steps[near]
    mean = (solved.compliance[first] + solved.compliance[second]) / 2
    moved = solved.displacement[second] - solved.displacement[first]
    residual = np.abs(moved - np.einsum("pij,pj->pi", mean, step))
    sizes = _sizes(solved, load_range.space)
    # Deviations within the uncertainties are no evidence.
    residual -= uncertain[with_tangent][first] + uncertain[with_tangent][second]
    over = (residual > TANGENT * np.abs(moved) + SMALL_STEP * sizes).any(axis=1)
    blamed = np.bincount(pairs[near][over].reshape(-1), minlength=len(solved))
    wrong = blamed > 1 if (blamed > 1).any() else blamed > 0
    return {
        "ok": not over.any(),
        "largest_miss": float((residual / sizes).max().clip(0.0)),
        "rows": _listed(solved, wrong),
    }


def _neighbours(rows: Rows, load_range: LoadRange) -> np.ndarray:
    """Return pairs of indices (p, 2): each row with the nearest rows of other wrenches."""
    if len(rows) < 2:
        return np.empty((0, 2), dtype=int)
    scaled = rows.wrench / load_range.scale
    count = min(1 + NEIGHBOURS, len(rows))
    far, near = KDTree(scaled).query(scaled, k=count)
    first = np.repeat(np.arange(len(rows)), count)
    distinct = np.asarray(far).reshape(-1) > ZERO_LOAD
    pairs = np.sort(np.stack((first, np.asarray(near).reshape(-1)), axis=1)[distinct], axis=1)
    return np.unique(pairs, axis=0)
