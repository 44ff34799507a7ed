"""Components on supports of every kind, made from meshes of boxes, for tests."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.validation.clamped import attached
from wrenchbook.fea.bundle.read import bundle_of
from wrenchbook.fea.component import build
from wrenchbook.fea.solve import Solver

TABLE = {
    "name": "part",
    "title": "A part",
    "mesh": {"generator": "bar", "length": 1.0, "width": 0.02, "height": 0.02},
    "analysis": {"nonlinear": False},
    "range": {"force": [1, 1, 1], "moment": [1, 1, 1]},
}
PLANES = [
    {"group": "x0", "directions": ["x"]},
    {"group": "y0", "directions": ["y"]},
    {"group": "z0", "directions": ["z"]},
]


def part(mesh, folder, supports, *, young=3e9, poisson=0.3, nonlinear=False, **interface):
    """Build a component from a mesh and the tables of its bundle."""
    table = TABLE | {
        "supports": supports,
        "material": [{"region": "all", "youngs_modulus": young, "poisson_ratio": poisson}],
        "interface": {"section": "z1", "coupling": "rigid"} | interface,
        "analysis": {"nonlinear": nonlinear},
    }
    return build(bundle_of(table, folder), mesh)


def turned(one, rotation):
    """The component carried elsewhere with all its mesh; the frame of the interface goes along."""
    nodes, held = one.sliding
    moved = replace(
        one,
        mesh=replace(one.mesh, points=one.mesh.points @ rotation.T),
        sliding=(nodes, rotation @ held @ rotation.T),
    )
    place = rotation @ one.interfaces[0].point
    return attached(moved, point=place, axes=one.axes @ rotation.T)


def stress(one, wrench):
    """Return the Cauchy stresses at all points, shape (p, 6), Pa, and the solution."""
    solver = Solver(one)
    result = solver.solve(wrench)
    return solver.stresses(result), result


def largest(difference, size):
    return float(np.abs(difference).max() / np.abs(size).max())
