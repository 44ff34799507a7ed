"""Estimate of the solver's error, as stored with a table: discretisation and linearity."""

from __future__ import annotations

from typing import Any

import numpy as np

from wrenchbook.fea.accuracy.beyond_linear import beyond_linear
from wrenchbook.fea.accuracy.recovered import recovered_error
from wrenchbook.fea.accuracy.rounded import Roundness, roundness
from wrenchbook.fea.component import build
from wrenchbook.fea.failure import SolveFailed
from wrenchbook.fea.mesh.facets import EDGES
from wrenchbook.fea.mesh.mesh import Mesh
from wrenchbook.fea.mesh.refine import refined
from wrenchbook.fea.solve import Solver
from wrenchbook.fea.spec.problems import BundleError
from wrenchbook.fea.spec.schema import FREEDOMS, Bundle, DeclaredRange

Array = np.ndarray

_RECOVERED_ALONE = 1.25
"""On the recovered error without a second mesh: Roache's for three meshes, 1994."""


def accuracy_of(solver: Solver) -> dict[str, Any]:
    """Return what a component's own answers may be wrong by.

    Where a second mesh can be made the mesh's error is the mean, entry by entry, of what that
    changes and of what `recovered_error` finds; elsewhere the latter alone, with a margin. Either
    errs where the other does not: on a bracket of one tetrahedron a wall the change holds 7 errors
    of 10, on a block with round holes the recovered stresses 5. Their mean covered 98 of 100 on
    eight parts at 2.8 times the error, the larger of both 99 at 4.2 (`make bench NAME=mesh_error`).
    It costs a fifth to a half of a linear solve where a generator makes the mesh, 1.5 to 2.8 of
    one on STEP parts (most of it gmsh, which repairs coarse cells that curved edges fold); a linear
    component costs two nonlinear solves besides, on the coarser mesh if there is one. What straight
    edges of a mesh file change on round surfaces is added (`roundness`): no recovered stress tells.

    Returns
    -------
    dict
        ``mesh``: shape (6 i, k) for i interfaces and k inputs, as lists, not negative, m/N,
        m/(N·m), rad/N, rad/(N·m): the bar at a wrench is this times the size of each input, from
        ``zero`` (k numbers, where one is not 0). ``mesh_stiffness``: shape (k, 6 i), the inverse
        units: what the mesh adds to the stiffness, signed. ``mesh_basis``, in words.
        ``cell_size``: the middle one of all edges' lengths, m. ``loads``: the largest of the range,
        k numbers, SI, 0 on locked freedoms: the guide takes these. Of a linear component also
        ``linearity`` (six numbers, m and rad, or None)
        and ``buckling`` (or None): see `fea.accuracy.beyond_linear`; ``linearity_basis``.

    Raises
    ------
    SolveFailed
        If the component cannot be solved for small loads.
    """
    bundle = solver.component.bundle
    second = coarser(solver)
    result = {**_mesh(solver, second), **_largest(bundle)}
    result["cell_size"] = _cell_size(solver.component.mesh)
    if bundle is None or solver.component.analysis.nonlinear:
        return result
    return result | _linearity(second or solver, bundle.acting)


def _mesh(solver: Solver, second: Solver | None) -> dict[str, Any]:
    compliance = solver.linear.compliance
    recovered = recovered_error(solver)[: len(compliance)]
    if second is None:
        errors = [_RECOVERED_ALONE * recovered]
        basis = "stresses recovered at six unit loads; no second mesh can be made"
    else:
        errors = [0.5 * (compliance - second.linear.compliance), 0.5 * recovered]
        own, other = (len(one.component.mesh.points) for one in (solver, second))
        basis = (
            f"a coarser mesh of {other} nodes beside this one of {own}, and recovered stresses, at "
            "six unit loads"
        )
    round_ = roundness(solver)
    if round_ is not None:
        errors.append(_ROUND * round_.change)
        basis += f"; {_of_roundness(round_, compliance)}"
    return _report(compliance, np.array(errors), basis)


def _of_roundness(found: Roundness, compliance: Array) -> str:
    """Say what straight edges across round surfaces change, and which turn keeps it within 1 %."""
    own = np.diag(compliance)
    share = np.abs(np.diag(found.change)[own > 0] / own[own > 0]).max()
    words = (
        f"straight edges across round surfaces, which turn by up to {np.degrees(found.turn):.3g} "
        f"degrees a cell, change it by {100 * share:.2g} %"
    )
    if share <= _FINE:
        return words
    # The change grows with the square of the turn.
    cells = int(np.ceil(2 * np.pi / (found.turn * np.sqrt(_FINE / share))))
    return f"{words}; with {cells} cells round it is 1 %"


_ROUND = 1.1
"""On what bending the edges changes: the bow leaves out the fourth power of the turn, 2 % of the
change at 30 degrees and 4 % at 40."""

_FINE = 0.01
"""Of a compliance: what is asked of round surfaces."""


def _report(compliance: Array, errors: Array, basis: str) -> dict[str, Any]:
    """Return the report of `errors`, shape (n, 6 i, k), the parts of the compliance's error."""
    found = {"mesh": np.abs(errors).sum(axis=0).tolist(), "mesh_basis": basis}
    # Loads on locked freedoms move nothing: what remains is as stiff as it is without them.
    loads = len(compliance)
    diagonal = np.diag(compliance)
    acting = diagonal > 0
    scale = np.sqrt(np.where(acting, diagonal, 1.0))
    own = np.ix_(acting, acting)
    stiffness = np.zeros((loads, loads))
    stiffness[own] = np.linalg.inv((compliance[:, :loads] / np.outer(scale, scale))[own])
    stiffness /= np.outer(scale, scale)
    # Further inputs are no generalised forces of an interface: their rows are zero.
    added = np.zeros(compliance.T.shape)
    added[:loads] = stiffness @ errors.sum(axis=0)[:, :loads] @ stiffness
    return found | {"mesh_stiffness": added.tolist()}


def _cell_size(mesh: Mesh) -> float:
    """Return the median of the cells' edges, from corner to corner, m."""
    lengths = [
        np.linalg.norm(np.diff(mesh.points[block.nodes[:, pair]], axis=1), axis=2).ravel()
        for block in mesh.blocks
        for pair in EDGES[block.kind]
    ]
    return float(np.median(np.concatenate(lengths)))


def accuracy_or_why(solver: Solver) -> dict[str, Any]:
    """Return what `accuracy_of` does, or ``mesh`` None and in ``mesh_basis`` why not.

    A part that can be solved has an answer whatever happens here: a coarser mesh can be too coarse
    for the shape, and memory can end.
    """
    try:
        return accuracy_of(solver)
    except (SolveFailed, BundleError, ValueError, ArithmeticError, MemoryError) as error:
        why = f"the estimate failed: {str(error) or type(error).__name__}"
        return {"mesh": None, "mesh_basis": why, **_largest(solver.component.bundle)}


def unknown_of_deck(bundle: Bundle) -> dict[str, Any]:
    """Return the same of a component that an outside solver answers for: nothing is known."""
    words = "an outside solver's own mesh: the deck's author knows how far it is off"
    return {"mesh": None, "mesh_basis": words, **_largest(bundle)}


def _largest(bundle: Bundle | None) -> dict[str, list[float]]:
    """Return ``loads``, the largest of each input in the range, 0 where a guide takes it.

    And ``zero``, from where inputs count, if one is not 0. An error that grows with the square of
    the largest load must not grow with one that is not felt.
    """
    if bundle is None:
        return {"loads": [1.0] * len(FREEDOMS)}
    largest = np.maximum(np.abs(bundle.acting.low), np.abs(bundle.acting.high))
    idle = [one in own.locked for own in bundle.interfaces for one in FREEDOMS]
    largest[: len(idle)][idle] = 0.0
    zero = [0.0] * len(bundle.range.low) + [one.reference for one in bundle.further]
    return {"loads": largest.tolist()} | ({"zero": zero} if any(zero) else {})


def _linearity(solver: Solver, loads: DeclaredRange) -> dict[str, Any]:
    found = beyond_linear(solver, loads)
    known = bool(np.isfinite(found.deviation).all())
    basis = "nonlinear solves at two opposite corners of the load range"
    if found.why:
        basis += f", a part of them since {found.why}"
    return {
        "linearity": found.deviation.tolist() if known else None,
        "linearity_basis": basis,
        "buckling": found.buckling,
    }


COARSER = 0.5
"""Cells along each direction of the second mesh, over those of the first.

A linear solve of it takes a sixth of the first's (generators) to two thirds (STEP parts whose own
edges keep cells small). Its error is two to four times the
first's (first- to second-order convergence of the displacements, by the corners where loads and
supports end), so that what the two differ by holds what the first still lacks.
"""

_SMALLER = 0.75
"""Of the first mesh's nodes: one that has more tells nothing, its cells are the geometry's own."""


def coarser(solver: Solver) -> Solver | None:
    """Return the component on a coarser mesh; None if none can be made, or it is no smaller.

    Mesh files have none: only their author can mesh anew. Nor has a mesh of single cells, or one
    whose cells the geometry's own edges keep small.
    """
    bundle = solver.component.bundle
    if bundle is None:
        return None
    other = refined(bundle, COARSER)
    if other is None:
        return None
    try:
        found = Solver(build(other))
        if len(found.component.mesh.points) > _SMALLER * len(solver.component.mesh.points):
            return None
        _ = found.linear
    except (BundleError, SolveFailed):
        return None  # too coarse for the shape, or for reduced integration to hold it
    return found
