"""A column whose mesh is too stiff, and what it lacks for that: by formula, at any push."""

import numpy as np

from tests.surrogate.law import build
from wrenchbook.surrogate.solver_error import SolverError
from wrenchbook.surrogate.table.rows import LoadRange, Rows


def column(pushed, stiffer=0.0):
    """A column of stiffness 1 at its tip, which buckles at a push of 1 and shortens as it bends.

    Rows (k, 6) of F_x = -push and F_z = 0.01: its u_z, and u_x of second order, with tangents.
    """
    wrench, moved, tangent = np.zeros((len(pushed), 6)), np.zeros((len(pushed), 6)), []
    for row, push in enumerate(pushed):
        stiffness = 1.0 + stiffer - push
        side = 0.01 / stiffness
        wrench[row, [0, 2]], moved[row, [0, 2]] = (-push, 0.01), (-0.5 * side**2, side)
        slopes = np.zeros((6, 6))
        slopes[2, [0, 2]] = -side / stiffness, 1.0 / stiffness
        slopes[0] = -side * slopes[2]
        tangent.append(slopes)
    return Rows.of(wrench, moved, compliance=tangent, source=["fea"] * len(pushed))


SHORT = 0.004  # of the column's compliance: what its mesh lacks
SOFT = {
    "mesh": np.diag([0, 0, SHORT, 0, 0, 0]).tolist(),
    "mesh_stiffness": np.diag([0, 0, SHORT, 0, 0, 0]).tolist(),
    "loads": [1.0, 1.0, 0.01, 1.0, 1.0, 1.0],
}


def softening_table(told=SOFT):
    """Build a table of such rows up to 0.85 of the buckling load."""
    span = LoadRange(-np.ones(6), np.ones(6))
    return build(column(np.linspace(0.0, 0.85, 18)), span, solver_error=SolverError(told))
