"""Convergence of a component's compliance with smaller cells, and the error of its mesh.

Two or three meshes give the change; three also give the order p at which it shrinks, and with it
the value at cells of size zero (Richardson 1911; Roache 1994). A linear problem is enough: error
bars use the mesh's error at small loads (`fea.accuracy.estimate`). `coarser` and `finer` make the
second mesh.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from wrenchbook.fea.component import build
from wrenchbook.fea.failure import SolveFailed
from wrenchbook.fea.mesh.refine import halved, refined
from wrenchbook.fea.mesh.sources import read_grouped
from wrenchbook.fea.solve import Solver
from wrenchbook.fea.spec.problems import BundleError
from wrenchbook.fea.spec.schema import FREEDOMS, LOADS, Bundle

_COARSER = (0.5, 2 / 3)
"""Ratios of cell sizes of the second mesh to the first, along each direction.

The next if one fails.

Its linear solve takes a sixth of the first's (generators) to a half (STEP parts).
"""


def coarser(solver: Solver) -> Solver | None:
    """Return the component on a coarser mesh, solved; None if none can be made.

    Mesh files have none: they cannot be meshed anew. The coarser mesh of a mesh of single cells is
    the mesh itself.
    """
    bundle = solver.component.bundle
    for factor in _COARSER:
        other = refined(bundle, factor)
        if other is None:
            return None
        try:
            second = Solver(build(other))
            _ = second.linear
        except (BundleError, SolveFailed):
            continue  # too coarse for the shape, or for reduced integration to hold it
        return second
    return None


FINER_UNKNOWNS = 30_000
"""Unknowns of a finer mesh that an estimate solves without a request: about a second."""


def finer(solver: Solver, max_unknowns: int | None = None, factor: float = 2.0) -> Solver | None:
    """Return the component with smaller cells; None if that has over `max_unknowns`.

    Generators and geometries make the mesh anew with cells `factor` times as small; a mesh file's
    cells are halved, its edges kept as they are.

    Raises BundleError if the mesh fails.
    """
    component = solver.component
    bundle = component.bundle
    limit = float("inf") if max_unknowns is None else max_unknowns
    if bundle.mesh is None:
        return None
    again = refined(bundle, factor)
    dependents = component.uncut_mesh.dependents
    tied = sum(len(tie.nodes) for tie in component.ties)
    if dependents is not None and len(dependents.nodes) > tied:
        return None  # a deck's equations name no nodes of a finer mesh
    # Unknowns grow by the square if cells of thin parts are refined in a plane alone.
    if (factor if again else 2.0) ** 2 * component.mesh.unknowns > limit:
        return None
    model = build(again) if again is not None else build(bundle, halved(component.uncut_mesh))
    return Solver(model) if model.mesh.unknowns <= limit else None


FILE = "convergence.json"
"""File in the bundle's folder: the study of `converge`, for the error bars of this setup."""

MAX_UNKNOWNS = 350_000
"""Unknowns of the finest mesh of a study without a request: about half a minute and 4 GB."""

_STEP = 1.5
"""Ratio of cell sizes if a generator or a geometry is meshed anew; a file's cells are halved."""

MIN_RATIO = 1.1
"""Least ratio of the cell sizes of two meshes: the difference of nearer meshes is their
irregularity."""


class Study(NamedTuple):
    """Compliances on meshes from the component's to the finest."""

    nodes: list[int]  # number of nodes of each mesh
    sizes: list[float]  # size of each mesh's cells, the cube root of their mean volume, m
    # Shape (meshes, 6 i, k): m/N, rad/N, m/(N·m), rad/(N·m), and by further inputs
    compliance: np.ndarray

    @property
    def lacking(self) -> np.ndarray:
        """Error of the component's mesh, shape (6 i, k).

        The finest mesh is assumed to have the remaining error of first order, the slowest: it
        governs where stresses are singular, at clamped and at re-entrant edges.
        """
        coarsest, before, last = self.compliance[0], self.compliance[-2], self.compliance[-1]
        return last - coarsest + (last - before) / (self.sizes[-2] / self.sizes[-1] - 1)

    @property
    def order(self) -> np.ndarray:
        """Observed order of each freedom's response to the load on it, (6 i,).

        It is NaN with two meshes, and where changes differ in sign or do not shrink.
        """
        order = np.full(self.compliance.shape[1], np.nan)
        if len(self.sizes) < 3:
            return order
        values = np.diagonal(self.compliance, axis1=1, axis2=2)
        first, last = np.diff(values[-3:], axis=0)
        for i in np.flatnonzero(first * last > 0):
            order[i] = _order(first[i] / last[i], *self.sizes[-3:])
        return order

    @property
    def extrapolated(self) -> np.ndarray:
        """Freedoms' responses to their loads at cells of size zero, (6 i,); NaN without order."""
        values = np.diagonal(self.compliance, axis1=1, axis2=2)
        ratio = self.sizes[-2] / self.sizes[-1]
        return values[-1] + (values[-1] - values[-2]) / (ratio**self.order - 1)


def _order(change: float, first: float, second: float, third: float) -> float:
    """Return p of (h1^p - h2^p) / (h2^p - h3^p) = change, by bisection; NaN out of 0.1 to 10."""
    low, high = 0.1, 10.0

    def excess(p: float) -> float:
        return (first**p - second**p) / (second**p - third**p) - change

    if excess(low) > 0 or excess(high) < 0:
        return float("nan")
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if excess(middle) > 0 else (middle, high)
    return low


def convergence_study(bundle: Bundle, finer_meshes: Sequence[Path] = ()) -> Study:
    """Solve the component on its mesh and on finer meshes.

    finer_meshes: one or two files with the bundle's groups, in the unit of its mesh, each finer
    than the one before. Without them cells are halved, twice where that makes at most
    `MAX_UNKNOWNS`.

    Raises ValueError if a mesh is not finer, or none can be made; BundleError or SolveFailed if a
    mesh cannot be read, lacks a group, or cannot be solved.
    """
    solvers = [Solver(build(bundle))]
    assert bundle.mesh is not None  # else it cannot be built
    for path in finer_meshes:
        try:
            solvers.append(Solver(build(bundle, read_grouped(path, bundle.mesh))))
        except BundleError as error:
            named = [replace(each, where=f"{path.name}: {each.where}") for each in error.problems]
            raise BundleError(named) from None
    while not finer_meshes and len(solvers) < 3:
        refined = finer(solvers[-1], MAX_UNKNOWNS if len(solvers) > 1 else None, _STEP)
        if refined is None:
            break
        solvers.append(refined)

    volumes = [np.concatenate([cells for _, cells in solver.volumes]) for solver in solvers]
    sizes = [float(np.cbrt(cells.mean())) for cells in volumes]
    for coarse, fine, fine_solver in zip(sizes, sizes[1:], solvers[1:], strict=False):
        if coarse < MIN_RATIO * fine:
            nodes = len(fine_solver.component.uncut_mesh.points)
            message = f"the mesh of {nodes} nodes, of {1e3 * fine:.4g} mm, is not finer than"
            raise ValueError(
                f"{message} the {1e3 * coarse:.4g} mm of the mesh before; give a mesh with cells "
                "at most 0.9 times as large"
            )

    compliance = np.array([solver.linear.compliance for solver in solvers])
    return Study([len(solver.component.uncut_mesh.points) for solver in solvers], sizes, compliance)


def write(bundle: Bundle, study: Study) -> Path:
    """Write the study to the bundle's folder, for the error bars; return its path.

    Besides ``nodes``, ``sizes`` and ``lacking`` of `Study` the file has for people, by responses in
    ``outputs`` (uz/Fz, m/N, and so on; locked ones are left out): ``values``, shape (meshes, n),
    ``order`` and ``extrapolated``, both with null for unknown, and ``first_lacks``.
    """
    moved = np.flatnonzero(np.diagonal(study.compliance[0]) > 0)
    content = {
        "fingerprint": bundle.fingerprint,
        "nodes": study.nodes,
        "sizes": study.sizes,
        "outputs": [names_of(bundle)[i] for i in moved],
        "values": np.diagonal(study.compliance, axis1=1, axis2=2)[:, moved].tolist(),
        "order": _or_null(study.order[moved]),
        "extrapolated": _or_null(study.extrapolated[moved]),
        "first_lacks": np.diagonal(study.lacking)[moved].tolist(),
        "lacking": study.lacking.tolist(),
    }
    path = bundle.folder / FILE
    scratch = path.with_suffix(".part")  # a table's builder may read the study at this moment
    scratch.write_text(json.dumps(content), encoding="utf-8")
    return scratch.replace(path)


def names_of(bundle: Bundle) -> list[str]:
    """Return the names of freedoms' responses to the loads on them, such as tool.uz/Fz; (6 i,)."""
    prefixes = [f"{interface.name}." if bundle.others else "" for interface in bundle.interfaces]
    pairs = list(zip(FREEDOMS, LOADS, strict=True))
    return [f"{name}{freedom}/{load}" for name in prefixes for freedom, load in pairs]


def _or_null(values: np.ndarray) -> list[float | None]:
    return [float(value) if np.isfinite(value) else None for value in values]


def stored(bundle: Bundle, shape: tuple[int, ...]) -> tuple[np.ndarray, str] | None:
    """Return the stored error for this setup, of this shape, and its basis; None without a study.

    Raises ValueError if the file is damaged.
    """
    if not (bundle.folder / FILE).is_file():
        return None
    try:
        content: dict[str, Any] = json.loads((bundle.folder / FILE).read_text(encoding="utf-8"))
        if content["fingerprint"] != bundle.fingerprint:
            return None
        error = np.array(content["lacking"], dtype=float)
        first, *others = map(int, content["nodes"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ValueError(f"{FILE} is damaged ({error}); run wrenchbook converge again") from None
    if error.shape != shape or not np.isfinite(error).all():
        raise ValueError(f"{FILE} is of an earlier component; run wrenchbook converge again")
    meshes = " and ".join(map(str, others))
    return error, f"finer meshes of {meshes} nodes beside this mesh of {first}, at six unit loads"
