"""Estimate of the solver's error, as stored with a table: discretisation and linearity.

The answers of a linear component are the first term of a series in the wrench. The second term is
known by its derivatives, which need no further solve. Nonlinear solves show the size of all later
terms, which begin with the cube: at the corner of the range where each interface turns most, and at
its opposite, since what pulls stiffens and what pushes buckles. A part that stiffens moves less and
less, so its error grows in the end with the load, as the linear answer does. So

    error bar(w) = |w H w| / 2 + remainder(corner) s(w)^3 (1 + b) / (1 + b s(w)^2)

with the second derivatives H, s the largest load over its range, and the saturation b, which solves
at parts of the corner show. A part that its weight or bolts move at no load, or that has more than
eight inputs, has no H. The remainder is then all of it, and each of its powers is one less.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from wrenchbook.fea.accuracy.advice import FINE
from wrenchbook.fea.accuracy.convergence import FINER_UNKNOWNS, MIN_RATIO, coarser, finer, stored
from wrenchbook.fea.accuracy.mesh_error import recovered_error
from wrenchbook.fea.accuracy.roundness import roundness
from wrenchbook.fea.failure import SolveFailed
from wrenchbook.fea.mesh.quality import edge_lengths
from wrenchbook.fea.solve import Solver
from wrenchbook.fea.spec.problems import BundleError
from wrenchbook.fea.spec.schema import FREEDOMS, Bundle, DeclaredRange

_LOAD_FRACTIONS = (0.125, 1.0)
"""Parts of the largest wrench for nonlinear solves: their remainders give the saturation. From an
eighth the law holds a part k (u + c u^3) = F at 94 % of loads for any c, at all where the linear
answer is up to three times the true one. From a quarter these are 90 % and two times."""

_LAST_FRACTION = 0.98
"""Part of the load at which a solve ended that is solved too: a component softens most just before
it snaps through. `_REMAINDER_FACTOR` covers the last 2 %."""

_SAME_ROTATION = 0.99
"""Part of the largest rotation from which a corner counts as turning an interface as much."""

_MAX_GROWTH = 0.94
"""Upper bound of remainder over load at the smallest part, relative to that at the corner: at 1 the
remainder grows with the load from the start, and b is infinite."""

_MAX_MESH_CHANGE = 0.1
"""Largest relative change of a compliance between the coarser mesh and the component's for solves
on the coarser: the remainder of a part that stiffens grows with its fourth power, and 0.9^4 is 1 /
`_REMAINDER_FACTOR`."""

_BUCKLES_EARLY = 1.25
"""Buckling factor below which the corner itself is not solved, but half the buckling load."""

_REMAINDER_FACTOR = 1.5
"""Factor on the largest remainder of the corners, for all other wrenches (`make bench
NAME=linearity`)."""


@dataclass(frozen=True, eq=False)
class BeyondLinear:
    """Differences of a linear component's answers from nonlinear ones."""

    # Shape (6 i,), m and rad: at a load as large as its range, growing as the module says; NaN
    # where no nonlinear solve gave an answer.
    remainder: np.ndarray
    saturation: np.ndarray  # shape (6 i,): b of the module, 0 where the part does not stiffen
    # The part of a corner's wrench at which the component buckles or snaps through, at or below 10;
    # None beyond that. It is that of linear buckling (`fea.solver.buckling`), or where a nonlinear
    # solve ended if that is less.
    buckling: float | None
    why: str = ""  # the reason for which a nonlinear solve has no answer; often empty


_MAX_REPORTED = 10.0  # largest reported buckling factor: beyond it the extrapolation is meaningless


def beyond_linear(solver: Solver, loads: DeclaredRange) -> BeyondLinear:
    """Solve a linear component nonlinearly at the corners of its range where it moves most.

    solver: of the component, on any mesh of it.
    loads: the range of its inputs, relative to their values without an effect.

    Raises ValueError as `DeclaredRange.corners` if the range has too many loads.
    """
    compliance = solver.linear.compliance
    other = copy(solver)  # shares the equations and the factor of the undeformed part
    analysis = replace(solver.component.analysis, nonlinear=True)
    other.component = replace(solver.component, analysis=analysis)

    # The corners that turn, or else move, each interface most, and their opposites. Of corners that
    # turn it alike, the most loaded: a pull along a beam turns nothing, and stiffens its bending.
    corners = loads.corners()
    moved = (corners @ compliance.T).reshape(len(corners), -1, 2, 3)
    moves, turns = np.moveaxis(np.linalg.norm(moved, axis=3), 2, 0)
    size = np.where(turns.any(axis=0), turns, moves)
    largest = np.abs(corners).max(axis=0)
    one_over = np.divide(1.0, largest, out=np.zeros(len(largest)), where=largest > 0)
    loaded = np.abs(corners) @ one_over
    alike = (size >= _SAME_ROTATION * size.max(axis=0)) & size.any(axis=0)
    chosen = (alike * loaded[:, None] * size).argmax(axis=0)

    scaled = np.full((len(_LOAD_FRACTIONS), len(compliance)), np.nan)
    zero = solver.component.reference_inputs
    why = ""
    lowest = np.inf
    for index in {min(index, len(corners) - 1 - index) for index in chosen.tolist()}:
        pair = corners[index], corners[len(corners) - 1 - index]
        factors = list(solver.buckling(pair[0] + zero))
        if not np.allclose(pair[1], -pair[0]):
            factors[1] = solver.buckling(pair[1] + zero)[0]
        for corner, factor in zip(pair, factors, strict=True):
            at_corner, end, reason = _at_corner(other, corner, factor)
            scaled = np.fmax(scaled, at_corner)
            lowest = min(lowest, factor, end)
            why = why or reason

    # b such that the law has the ratio of its values at the smallest part and at the corner.
    powers = np.array(_LOAD_FRACTIONS)[:, None] ** (_order(solver) - 1)
    growth = np.divide(scaled[0], scaled[-1], out=np.ones(len(compliance)), where=scaled[-1] > 0)
    growth = np.clip(growth, 1.0, _MAX_GROWTH / powers[0])
    saturation = (growth - 1) / (1 - growth * powers[0])
    remainder = (
        _REMAINDER_FACTOR * (scaled * (1 + saturation * powers)).max(axis=0) / (1 + saturation)
    )
    buckling = float(lowest) if lowest <= _MAX_REPORTED else None
    return BeyondLinear(remainder, saturation, buckling, why)


def _order(solver: Solver) -> int:
    """Return the power of the load with which the remainder begins."""
    return 2 if solver.second_derivatives is None else 3


def _at_corner(
    solver: Solver, wrench: np.ndarray, buckling: float
) -> tuple[np.ndarray, float, str]:
    """Return a corner's remainders over powers of the load, the end and the reason of failures.

    The remainders have the shape (parts, 6 i), all of a corner that is not solved in all parts the
    largest. The end is the least part of the wrench at which a solve ended.
    """
    limit, why = 1.0, ""
    if buckling < _BUCKLES_EARLY:
        limit, why = 0.5 * buckling, f"it buckles at {buckling:.3g} of one"
    parts = [limit * part for part in _LOAD_FRACTIONS]
    second = solver.second_derivatives
    start = None
    end = np.inf
    scaled = []
    for part in parts:
        acting = part * wrench
        try:
            solution = solver.solve(acting + solver.component.reference_inputs, start=start)
        except SolveFailed as failure:
            why = why or failure.message
            if failure.load_factor is not None:
                end = min(end, part * failure.load_factor)
            if len(parts) == len(_LOAD_FRACTIONS):
                # At the first failure two smaller loads are added; the loop solves them next.
                parts += [0.5 * part, _LAST_FRACTION * part * (failure.load_factor or 0.25)]
            continue
        start = solution.state
        expected = solver.linear.compliance @ acting + solver.unloaded_displacements[0]
        if second is not None:
            expected += 0.5 * second @ acting @ acting
        remainder = np.abs(solution.displacement - expected) / part ** _order(solver)
        scaled.append(np.repeat(remainder.reshape(-1, 3).max(axis=1), 3))
    if why:
        none = np.full(len(solver.linear.compliance), np.nan)
        scaled = len(_LOAD_FRACTIONS) * [np.fmax.reduce([none, *scaled])]
    return np.array(scaled), end, why


_RECOVERED_FACTOR = 1.25
"""Safety factor on errors by recovered stresses: Roache's for three meshes, 1994."""

_TIE_FACTOR = 2.4
"""Further safety factor where a tie ends within facets, at edges of the mesh: stresses do not show
the distance of these edges from the tie's end. The error was up to 2.2 times that of the
stresses, of either sign. A finer mesh shows it in part: then the two are added. Where main
facets are larger than the tie, it is multiplied by their diagonal over the tie's size: of 42
blocks on plates the outputs inside rose from 53 to 96 %, at 2.3 times the error."""


def accuracy_of(solver: Solver) -> dict[str, Any]:
    """Return the estimated error of a component's answers.

    A study of this setup by `fea.accuracy.convergence` is used as it is. Else a second mesh is
    made: of a small mesh a finer mesh, of a large mesh a coarser mesh where possible. The
    difference of the two shows the first mesh's error as of first order, the slowest, at the ratio
    of cell sizes that the meshes really have where the error is
    (`fea.accuracy.mesh_error.RecoveredError.coarsening`). Beside a coarser mesh the error is the
    mean, entry by entry, of that and of the error of recovered stresses on the first mesh, with a
    margin; of large mesh files it is only the latter. Where a geometry has no second mesh, or none
    that is coarser where the error is, the error is unknown: ``mesh`` is None. The effect of a mesh
    file's straight edges on round surfaces is added (`roundness`): no refinement and no stress
    shows it. fea/README.md compares the results with refined meshes, and has the costs.

    Returns lists, numbers and texts, for i interfaces and k inputs:
    ``mesh``, (6 i, k), m and rad per unit of each input, not negative: the error bar at a wrench is
    this times the size of each input, from ``zero``, (k,), there if any is not 0.
    ``mesh_stiffness``, (k, 6 i), the inverse units, signed: the mesh's addition to the stiffness.
    ``mesh_basis``.
    ``rounded``, of a mesh file with straight edges across round surfaces: ``mesh``, their part of
    it, ``share``, its largest fraction of a compliance, and ``basis``.
    ``cell_size``, m: the median length of edges.
    ``loads``, (k,), SI: the largest of the range, 0 on locked freedoms.
    Of a linear component ``linearity``, (6 i,), m and rad, at the worst corner of the range, or
    None, ``buckling``, or None (see the module), and ``linearity_basis``; where they are known
    ``linearity_saturation``, (6 i,), ``second_derivatives``, (6 i, k, k), and beside these
    ``linearity_remainder``, (6 i,), m and rad.

    Raises SolveFailed if the component cannot be solved for small loads.
    """
    bundle = solver.component.bundle
    second = coarser(solver)
    result = {**_mesh(solver, second), **_largest(bundle)}
    mesh = solver.component.mesh
    lengths = [edge_lengths(mesh.points, block).ravel() for block in mesh.blocks]
    result["cell_size"] = float(np.median(np.concatenate(lengths)))
    if solver.component.analysis.nonlinear:
        return result
    return result | linearity_of(solver, second or solver, bundle.acting)


def linearity_of(solver: Solver, coarse: Solver, loads: DeclaredRange) -> dict[str, Any]:
    """Return the terms that a linear analysis neglects, in the form of `accuracy_of`.

    coarse: of a coarser mesh, or `solver` again; nonlinear solves use it unless it is far stiffer
    or softer.
    loads: as of `beyond_linear`.
    """
    fine, rough = (np.diag(each.compliance) for each in (solver, coarse))
    near = (np.abs(rough - fine) <= _MAX_MESH_CHANGE * fine).all()
    beyond = beyond_linear(coarse if near else solver, loads)
    second = solver.second_derivatives
    basis = "nonlinear solves at opposite corners of the load range"
    if beyond.why:
        basis += f", a part of them since {beyond.why}"
    result = {"linearity": None, "linearity_basis": basis, "buckling": beyond.buckling}
    if not np.isfinite(beyond.remainder).all():
        return result
    result["linearity_saturation"] = beyond.saturation.tolist()
    if second is None:
        return result | {"linearity": beyond.remainder.tolist()}
    corners = loads.corners()
    at_corners = 0.5 * np.einsum("jkl,ck,cl->cj", second, corners, corners, optimize=True)
    return result | {
        "linearity": (np.abs(at_corners).max(axis=0) + beyond.remainder).tolist(),
        "linearity_remainder": beyond.remainder.tolist(),
        "second_derivatives": second.tolist(),
        "linearity_basis": f"second derivatives at no load, and {basis}",
    }


def _mesh(solver: Solver, second: Solver | None) -> dict[str, Any]:
    """Return the mesh's error in the form of `accuracy_of`."""
    compliance = solver.linear.compliance
    errors, basis = _of_cells(solver, second)
    if not errors:
        return {"mesh": None, "mesh_basis": basis}
    round_ = roundness(solver)
    if round_ is None:
        return _report(compliance, np.array(errors), basis)
    errors.append(_ROUNDNESS_FACTOR * round_.change)
    # The effect of straight edges across round surfaces, and the number of cells round for 1 %.
    diagonal = np.diag(compliance)
    ratio = float(np.abs(np.diag(round_.change)[diagonal > 0] / diagonal[diagonal > 0]).max())
    cause = (
        f"straight edges across round surfaces, which turn by up to {np.degrees(round_.angle):.3g} "
        f"degrees a cell, change it by {100 * ratio:.2g} %"
    )
    if ratio > FINE:
        # The effect grows with the square of the angle.
        cells = int(np.ceil(2 * np.pi / (round_.angle * np.sqrt(FINE / ratio))))
        cause = f"{cause}; with {cells} cells round it is 1 %"
    report = _report(compliance, np.array(errors), f"{basis}; {cause}")
    rounded = {"mesh": np.abs(errors[-1]).tolist(), "share": ratio, "basis": cause}
    return report | {"rounded": rounded}


def _of_cells(solver: Solver, coarse: Solver | None) -> tuple[list[np.ndarray], str]:
    """Return the error by the size of cells, in parts (6 i, k), none if unknown, and its basis."""
    compliance, bundle = solver.linear.compliance, solver.component.bundle
    study = stored(bundle, compliance.shape)
    if study is not None:
        return [study[0]], study[1]

    # Half of the error of recovered stresses: the mean with half of another mesh's change.
    recovered = recovered_error(solver)
    by_stresses = 0.5 * _RECOVERED_FACTOR * recovered.total[: len(compliance)]
    is_cut = any(tie.cut or tie.within for tie in solver.component.ties)
    within = max((tie.within for tie in solver.component.ties), default=0.0)
    tied = _TIE_FACTOR * max(1.0, within) if is_cut else 1.0

    # A second mesh, finer if it can be solved, and the ratio of cell sizes, of larger to smaller.
    try:
        fine = finer(solver, FINER_UNKNOWNS)
        _ = fine and fine.linear  # solves now, so that a failure is caught here
    except (BundleError, SolveFailed):
        fine = None
    second = fine or coarse
    ratio = np.ones(compliance.shape[1])
    if second is not None:
        ratio = recovered.coarsening(second.component.mesh) ** (-1 if fine else 1)
    if second is None or ratio.min() < MIN_RATIO:
        size = "finer" if fine else "coarser"
        why = "no second mesh can be made"
        if second is not None:
            why = f"a {size} mesh is no {size} where the error is"
        if bundle.mesh is None or bundle.mesh.geometry is None:
            return [2 * tied * by_stresses], f"stresses recovered at six unit loads; {why}"
        return [], f"{why}; wrenchbook converge compares it with finer ones"

    # Ratio of an error of first order, the slowest, to the change between sizes of this ratio.
    scale = np.sqrt((ratio if fine else 1) / (ratio - 1))
    change = (compliance - second.linear.compliance) * np.outer(scale[: len(compliance)], scale)
    basis = (
        f"a {'finer' if fine else 'coarser'} mesh of {len(second.component.uncut_mesh.points)} "
        f"nodes beside this mesh of {len(solver.component.uncut_mesh.points)}, cells in the ratio "
        f"{np.median(ratio):.2g} where the error is"
    )
    if fine and not is_cut:
        return [-change], f"{basis}, at six unit loads"
    # A finer mesh shows the end of a tie in part, so both are added; else they make the mean.
    parts = [-change, by_stresses] if fine else [0.5 * change, tied * by_stresses]
    return parts, f"{basis}, and recovered stresses, at six unit loads"


_MIN_COUPLING_ERROR = 0.02
"""Lower bound of an entry's error, as a part of the root of the product of the two responses'
errors, its upper bound (Cauchy and Schwarz: the error's energy is not negative): the difference
of two meshes in an entry near zero, such as an entry of symmetry, is chance. For single loads on
STEP parts it raises the outputs inside from 50 to 76 % to over 90 %."""

_ROUNDNESS_FACTOR = 1.1
"""Safety factor on the effect of bending the edges: the bow leaves out the fourth power of the
angle, 2 % of the change at 30 degrees and 4 % at 40."""


def _report(compliance: np.ndarray, errors: np.ndarray, basis: str) -> dict[str, Any]:
    """Return the report of `errors`, shape (n, 6 i, k), the parts of the compliance's error."""
    mesh = np.abs(errors).sum(axis=0)
    roots = np.sqrt(np.diag(mesh))
    mesh[:, : len(roots)] += _MIN_COUPLING_ERROR * np.outer(roots, roots)
    report = {"mesh": mesh.tolist(), "mesh_basis": basis}
    # Loads on locked freedoms move nothing: they are left out of the inverse.
    loads = len(compliance)
    diagonal = np.diag(compliance)
    acting = diagonal > 0
    scale = np.sqrt(np.where(acting, diagonal, 1.0))
    block = np.ix_(acting, acting)
    stiffness = np.zeros((loads, loads))
    stiffness[block] = np.linalg.inv((compliance[:, :loads] / np.outer(scale, scale))[block])
    stiffness /= np.outer(scale, scale)
    # Further inputs are no generalised forces of an interface: their rows are zero.
    added = np.zeros(compliance.T.shape)
    added[:loads] = stiffness @ errors.sum(axis=0)[:, :loads] @ stiffness
    return report | {"mesh_stiffness": added.tolist()}


def accuracy_or_why(solver: Solver) -> dict[str, Any]:
    """Return the result of `accuracy_of`, or ``mesh`` None and the reason in ``mesh_basis``.

    A failure of the estimate must not prevent an answer: a coarser mesh can be too coarse for the
    shape, and memory can be exhausted.
    """
    try:
        return accuracy_of(solver)
    except SolveFailed as failure:
        why = f"the estimate failed: {failure.message}"
    except (BundleError, ValueError, ArithmeticError) as error:
        why = f"the estimate failed: {error}"
    except MemoryError:
        why = "the estimate failed: it needs more memory than this machine has"
    return {"mesh": None, "mesh_basis": why, **_largest(solver.component.bundle)}


def unknown_of_deck(bundle: Bundle) -> dict[str, Any]:
    """Return the report of a component with a deck, whose error is unknown."""
    why = "an outside solver's mesh: the deck's author knows how far it is off"
    return {"mesh": None, "mesh_basis": why, **_largest(bundle)}


def _largest(bundle: Bundle) -> dict[str, list[float]]:
    """Return ``loads``, the largest of each input in the range, 0 for loads on locked freedoms.

    ``zero`` has the inputs' values without an effect, if any is not 0. An error that grows with the
    square of the largest load must not grow with a load without effect.
    """
    largest = np.maximum(np.abs(bundle.acting.low), np.abs(bundle.acting.high))
    idle = [freedom in interface.locked for interface in bundle.interfaces for freedom in FREEDOMS]
    largest[: len(idle)][idle] = 0.0
    zero = [0.0] * len(bundle.range.low) + [scalar.reference for scalar in bundle.further]
    return {"loads": largest.tolist()} | ({"zero": zero} if any(zero) else {})
