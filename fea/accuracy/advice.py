"""Warnings about a solver error that exceeds the tolerance, each with a remedy.

They need no mesh and no solver: a server of tables has the stored estimate alone.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from wrenchbook.fea.spec.problems import BundleProblem
from wrenchbook.fea.spec.schema import FREEDOMS

WHERE = "tolerance"
"""Key of these warnings; the newest estimate replaces earlier warnings."""

FINE = 0.01
"""Largest effect of straight edges across round surfaces without a warning, as a part of a
compliance."""

_WORTH_A_MESH = 30.0
"""Largest ratio by which smaller cells are a remedy: it means 27,000 times as many cells."""


def over_tolerance(
    solver_error: Mapping[str, Any] | None,
    translation: float = math.inf,
    rotation: float = math.inf,
) -> list[BundleProblem]:
    """Return warnings where a solver error is over a tolerance, m and rad.

    Without a tolerance only a part that buckles in its range is a warning: its answers are wrong
    whatever error is accepted.

    No solve lowers this error, so covered answers are beyond the tolerance too, each with an error
    bar that shows it. It is that at the full range, all loads at once, by the compliance.

    solver_error: the result of `fea.accuracy.estimate.accuracy_of`, or None.
    """
    if solver_error is None:
        return []
    allowed = np.repeat([translation, rotation], 3)
    checks = _mesh_too_coarse, _large_displacements, _buckles
    messages = [check(solver_error, allowed) for check in checks]
    return [BundleProblem(WHERE, message) for message in messages if message]


def _mesh_too_coarse(solver_error: Mapping[str, Any], allowed: np.ndarray) -> str:
    """Return the warning about the mesh, empty within the tolerance `allowed` (6,), m and rad."""
    if solver_error.get("mesh") is None:
        return ""
    errors = np.array(solver_error["mesh"]) @ np.array(solver_error["loads"])
    worst, excess = _worst(errors, allowed)
    if not worst > 1.0:
        return ""
    # Displacements converge with about the square of the cell size, because of edges and corners
    # where supports end. Rounded up to a tenth: a cell "1 times smaller" is no remedy.
    finer = float(np.ceil(np.round(10.0 * np.sqrt(worst), 6)) / 10.0)
    remedy = f"Make cells about {finer:.2g} times smaller"
    if finer > _WORTH_A_MESH:
        remedy = "Make cells much smaller"
    elif solver_error.get("cell_size") is not None:
        size = solver_error["cell_size"] / finer
        remedy += f", about {1e3 * size:.2g} mm" if size < 1.0 else f", about {size:.2g} m"
        remedy += " each"
    start = "the mesh is too coarse for the tolerance: at the full range its error may be"
    actions = f"{remedy}, widen [tolerance], or narrow {_range(solver_error)}"
    return f"{start} {excess}, and more solves do not reduce it. {actions}"


def _large_displacements(solver_error: Mapping[str, Any], allowed: np.ndarray) -> str:
    """Return the warning about a linear analysis, empty within the tolerance (6,), m and rad."""
    if solver_error.get("linearity") is None:
        return ""
    worst, excess = _worst(np.array(solver_error["linearity"]), allowed)
    message = (
        "the linear solver (nonlinear = false) neglects large displacements: at the full range "
        f"this error may be {excess}, and more solves do not reduce it. Set nonlinear = true in "
        f"[analysis], or narrow {_range(solver_error)}"
    )
    return message if worst > 1.0 else ""


def _buckles(solver_error: Mapping[str, Any], _: np.ndarray) -> str:
    """Return the warning about a part that buckles in its range, empty if it does not."""
    if (factor := solver_error.get("buckling")) is None or not factor < 1.0:
        return ""
    return (
        f"the part buckles at {factor:.3g} of the loads at a corner of the range; answers of "
        f"the linear solver are wrong beyond that load. Narrow {_range(solver_error)}, or set "
        "nonlinear = true in [analysis]"
    )


def _range(solver_error: Mapping[str, Any]) -> str:
    """Return the place of the load range: with several interfaces each has its own."""
    several = len(solver_error["loads"]) >= 2 * len(FREEDOMS)  # further inputs are four at most
    return "the range of its [[interface]]" if several else "[range]"


def straight_edges(solver_error: Mapping[str, Any]) -> list[BundleProblem]:
    """Return a warning where straight edges across round surfaces change more than `FINE`."""
    rounded = solver_error.get("rounded")
    if rounded is None or rounded["share"] <= FINE:
        return []
    remedy = "mesh it with curved second-order cells or more cells; error bars include it"
    return [BundleProblem("mesh.file", f"{rounded['basis']}: {remedy}")]


def _worst(errors: np.ndarray, allowed: np.ndarray) -> tuple[float, str]:
    """Return the largest ratio of error (6 i,) to tolerance (6,), and its text."""
    ratios = errors / np.resize(allowed, errors.shape)
    output = int(ratios.argmax())
    interface, freedom = divmod(output, len(FREEDOMS))
    worst = float(ratios[output])
    unit = "m" if freedom < 3 else "rad"
    where = f" of interface {interface + 1}" if len(errors) > len(FREEDOMS) else ""
    text = f"{errors[output]:.2g} {unit} in {FREEDOMS[freedom]}{where}"
    return worst, f"{text}, {float(f'{worst:.2g}'):g} times the tolerance"
