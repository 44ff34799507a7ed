"""Parts on coarse meshes as engineers make them, each with what finer ones of it answer.

Mesh files are grids of hexahedra, some cut into wedges, bent to the part's shape and written with
straight edges and without midside nodes; the finer ones have their edges on the shape.
"""

from dataclasses import replace
from typing import NamedTuple

import meshio
import numpy as np

from tests.fea.geometry import drawing
from wrenchbook.fea.bundle.read import read_bundle
from wrenchbook.fea.component import build
from wrenchbook.fea.mesh.element_order import second_order
from wrenchbook.fea.mesh.facets import outer_surface
from wrenchbook.fea.mesh.mesh import CellBlock, Mesh
from wrenchbook.fea.mesh.refine import refined
from wrenchbook.fea.solve import Solver

BUNDLE = """name = "part"
title = "A part"
[mesh]
{mesh}
[[material]]
region = "all"
{material}
[supports]
fixed = ["base"]
[interface]
section = "tip"
coupling = "rigid"
[analysis]
nonlinear = true
[range]
force = [{force}, {force}, {force}]
moment = [{moment}, {moment}, {moment}]
"""
FILE = 'file = "part.msh"\nunit = "mm"\norder = 2'
STEEL = "youngs_modulus = 210e9\npoisson_ratio = 0.3"
CARBON = """law = "orthotropic"
youngs_modulus = [9e9, 130e9, 9e9]
shear_modulus = [5e9, 3.5e9, 5e9]
poisson_ratio = [0.02, 0.4, 0.3]
cylinder = {point = [0, 0, 0], axis = [0, 0, 1]}"""
RUBBER = "youngs_modulus = 3e6\npoisson_ratio = {nu}"


class Shape(NamedTuple):
    """A grid and what becomes of it: `counts` of cells, `place` from the unit cube to mm.

    `holds` says, of cells' middles in the unit cube, which are there; `base` and `tip` of nodes.
    """

    counts: tuple[int, int, int]
    place: object
    base: object
    tip: object
    holds: object = None
    wedges: bool = False


def ends(axis):
    return (lambda p: p[:, axis] < 1e-9), (lambda p: p[:, axis] > 1 - 1e-9)


def pipe(inner, outer, length):
    def place(p):
        angle, radius = -2 * np.pi * p[:, 0], inner + (outer - inner) * p[:, 1]
        return np.stack([radius * np.cos(angle), radius * np.sin(angle), length * p[:, 2]], axis=1)

    return place


def disc(radius, height):
    """A square onto a disc, by an elliptical map."""

    def place(p):
        x, y = 2 * p[:, 0] - 1, 2 * p[:, 1] - 1
        return np.stack(
            [
                radius * x * np.sqrt(1 - y**2 / 2),
                radius * y * np.sqrt(1 - x**2 / 2),
                height * p[:, 2],
            ],
            axis=1,
        )

    return place


def scaled(*size):
    return lambda p: p * size


def of_frame(p):
    """Two legs and a lintel, two cells thick."""
    return (np.abs(p[:, 0] - 0.5) > 0.4) | (p[:, 2] > 1 - 1 / 12)


def of_clevis(p):
    """A foot, and two cheeks on it."""
    return (p[:, 2] < 0.4) | (np.abs(p[:, 1] - 0.5) > 0.25)


SHAPES = {
    "flexure, wedge15": (
        Shape((16, 4, 1), scaled(40, 12, 1), *ends(0), wedges=True), STEEL, (20, 0.2)),
    "portal frame": (
        Shape((20, 2, 24), scaled(120, 10, 144), lambda p: (p[:, 2] < 1e-9) & (p[:, 0] < 0.5),
              lambda p: (p[:, 2] < 1e-9) & (p[:, 0] > 0.5), of_frame), STEEL, (200, 5)),
    "CFRP tube": (Shape((16, 1, 10), pipe(18, 20, 200), *ends(2)), CARBON, (500, 20)),
    "rubber mount, nu 0.30": (Shape((4, 4, 3), disc(20, 25), *ends(2)), RUBBER.format(nu=0.30),
                              (20, 0.2)),
    "rubber mount, nu 0.45": (Shape((4, 4, 3), disc(20, 25), *ends(2)), RUBBER.format(nu=0.45),
                              (20, 0.2)),
    "rubber mount, nu 0.49": (Shape((4, 4, 3), disc(20, 25), *ends(2)), RUBBER.format(nu=0.49),
                              (20, 0.2)),
    "clevis, hex8": (
        Shape((4, 4, 5), scaled(30, 40, 50), ends(2)[0],
              lambda p: (p[:, 2] > 1 - 1e-9), of_clevis), STEEL, (500, 20)),
    "round tube": (Shape((16, 1, 8), pipe(19, 20, 80), *ends(2)), STEEL, (500, 20)),
}  # fmt: skip
GENERATED = {
    "stubby block": ('generator = "bar"\nlength = 0.03\nwidth = 0.06\nheight = 0.04\n'
                     "cells_along = 5\ncells_across = 4", "start", "end", STEEL, (1e4, 100)),
    "plate of 2 x 2 cells": ('generator = "plate"\nlength = 0.4\nwidth = 0.4\nthickness = 0.01\n'
                             "patch = 0.12\ncells = 2\nrings = 1\nlayers = 1", "rim", "patch",
                             STEEL, (1000, 100)),
}  # fmt: skip


def draw_ribbed_flange(path):
    """A disc of 90 mm, a pipe of 40 mm on it and four ribs between the two."""
    with drawing(path) as occ:
        disc, pipe = occ.addCylinder(0, 0, 0, 0, 0, 8, 45), occ.addCylinder(0, 0, 8, 0, 0, 42, 20)
        ribs = [(3, occ.addBox(0, -3, 8, 40, 6, 22)) for _ in range(4)]
        for i, rib in enumerate(ribs):
            occ.rotate([rib], 0, 0, 0, 0, 0, 1, i * np.pi / 2)
        (solid,), _ = occ.fuse([(3, disc)], [(3, pipe), *ribs])
        occ.cut([solid], [(3, occ.addCylinder(0, 0, -1, 0, 0, 60, 15))])


def draw_wishbone(path):
    """Two arms from two bushes to one: 160 mm long, 16 mm wide, 12 mm high."""
    with drawing(path) as occ:
        arms = [(3, occ.addBox(0, -8, 0, 170, 16, 12)) for _ in range(2)]
        for arm, angle in zip(arms, (0.35, -0.35), strict=True):
            occ.rotate([arm], 0, 0, 0, 0, 0, 1, angle)
        (solid,), _ = occ.fuse([(3, occ.addCylinder(0, 0, 0, 0, 0, 12, 22))], arms)
        occ.cut([solid], [(3, occ.addCylinder(0, 0, -1, 0, 0, 14, 10)),
                          (3, occ.addBox(150, -100, -1, 50, 200, 14))])  # fmt: skip


DRAWN = {
    "ribbed flange, STEP": (draw_ribbed_flange, 8e-3, 'base = {plane = "z", at = 0.0}',
                            'tip = {plane = "z", at = 0.05}', STEEL, (1000, 30)),
    "wishbone, STEP": (draw_wishbone, 8e-3, 'base = {plane = "x", at = 0.15}',
                       'tip = {radius = 0.01}',
                       STEEL, (1000, 30)),
}  # fmt: skip


def grid(shape, finer=1):
    """The shape's hexahedra or wedges in the unit cube, with the groups base and tip."""
    counts = np.array(shape.counts) * finer
    corners = np.stack(np.meshgrid(*[np.arange(n + 1) for n in counts], indexing="ij"), -1)
    points = corners.reshape(-1, 3) / counts
    steps = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0],
                      [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]])  # fmt: skip
    first = np.stack(np.meshgrid(*[np.arange(n) for n in counts], indexing="ij"), -1)
    cells = np.ravel_multi_index(
        tuple((first.reshape(-1, 1, 3) + steps).transpose(2, 0, 1)), tuple(counts + 1)
    )
    if shape.holds is not None:
        cells = cells[shape.holds(points[cells].mean(axis=1))]
    if shape.wedges:
        cells = cells[:, [[0, 1, 2, 4, 5, 6], [0, 2, 3, 4, 6, 7]]].reshape(-1, 6)
    kind = "wedge6" if shape.wedges else "hex8"
    groups = {name: np.flatnonzero(own(points)) for name, own in vars_of(shape)}
    return Mesh(points, (CellBlock(kind, cells),), node_groups=groups)


def vars_of(shape):
    return ("base", shape.base), ("tip", shape.tip)


def bent(shape, mesh):
    """The mesh with its nodes on the shape; nodes at one place, as round a tube, become one."""
    points = shape.place(mesh.points)
    _, first, number = np.unique(
        np.round(points, 9), axis=0, return_index=True, return_inverse=True
    )
    used = np.unique(number[np.concatenate([b.nodes.ravel() for b in mesh.blocks])])
    place = np.full(len(first), -1)
    place[used] = np.arange(len(used))
    blocks = tuple(CellBlock(b.kind, place[number[b.nodes]]) for b in mesh.blocks)
    groups = {k: np.unique(place[number[ids]]) for k, ids in mesh.node_groups.items()}
    groups = {name: ids[ids >= 0] for name, ids in groups.items()}
    return Mesh(points[first][used], blocks, node_groups=groups)


def write(mesh, path):
    """Write first-order cells and the faces of both groups as gmsh does."""
    (block,) = mesh.blocks
    kinds = {"hex8": "hexahedron", "wedge6": "wedge", "quad4": "quad", "tri3": "triangle"}
    cells, tags = [(kinds[block.kind], block.nodes)], [np.ones(len(block), int)]
    for kind, nodes in outer_surface(mesh.blocks).blocks:
        for tag, name in ((2, "base"), (3, "tip")):
            own = nodes[np.isin(nodes, mesh.node_groups[name]).all(axis=1)]
            if len(own):
                cells.append((kinds[kind], own))
                tags.append(np.full(len(own), tag))
    names = {"solid": [1, 3], "base": [2, 2], "tip": [3, 2]}
    data = {"gmsh:physical": tags, "gmsh:geometrical": tags}
    fields = {name: np.array(value) for name, value in names.items()}
    result = meshio.Mesh(mesh.points, cells, cell_data=data, field_data=fields)
    meshio.write(path, result, file_format="gmsh22", binary=False)


def of_shape(name, folder):
    """Return the bundle of a mesh file, solvers of cells a half and a third as large, and 3/2."""
    shape, material, (force, moment) = SHAPES[name]
    write(bent(shape, grid(shape)), folder / "part.msh")
    text = BUNDLE.format(mesh=FILE, material=material, force=force, moment=moment)
    (folder / "component.toml").write_text(text)
    bundle = read_bundle(folder)
    fine = []
    for finer in (2, 3):
        mesh = bent(shape, second_order(grid(shape, finer)))
        fine.append(Solver(build(bundle, replace(mesh, points=1e-3 * mesh.points))))
    return bundle, fine, 1.5


def made_again(name, folder):
    """The same of a generator or a geometry, which make their meshes again."""
    if name in GENERATED:
        mesh, base, tip, material, (force, moment) = GENERATED[name]
    else:
        draw, size, base_at, tip_at, material, (force, moment) = DRAWN[name]
        draw(folder / "part.step")
        mesh = f'file = "part.step"\nsize = {size}\n[mesh.groups]\n{base_at}\n{tip_at}'
        base, tip = "base", "tip"
    text = BUNDLE.format(mesh=mesh, material=material, force=force, moment=moment)
    text = text.replace('"base"', f'"{base}"').replace('"tip"', f'"{tip}"')
    (folder / "component.toml").write_text(text)
    bundle = read_bundle(folder)
    factors = (2.0, 3.0) if name in GENERATED else (1.5, 2.25)
    return bundle, [Solver(refined(bundle, factor)) for factor in factors], 1.5


def kinds():
    """Yield each part's name and its function: from name and folder to bundle, solvers, ratio."""
    for name in SHAPES:
        yield name, of_shape
    for name in (*GENERATED, *DRAWN):
        yield name, made_again
