"""Components and bundles of two interfaces, for tests."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.fea.boxes import box
from tests.fea.components import component
from tests.fea.pairs import moved, together
from tests.refusals import GOOD
from wrenchbook.fea.component import AttachedInterface
from wrenchbook.fea.coupling.section import section_of_facets

LINK = (GOOD / "link" / "component.toml").read_text("utf-8")


def deck_of(mesh, sets):
    """The text of a deck of one block of 20-node bricks, with sets of nodes by name."""
    lines = ["*NODE"]
    lines += [f"{i}, " + ", ".join(map(repr, p)) for i, p in enumerate(mesh.points.tolist(), 1)]
    lines.append("*ELEMENT, TYPE=C3D20R")
    cells = np.concatenate([block.nodes for block in mesh.blocks])
    for i, cell in enumerate((cells + 1).tolist(), 1):
        lines += [", ".join(map(str, [i, *cell[:10]])) + ",", ", ".join(map(str, cell[10:]))]
    for name, nodes in sets.items():
        lines += [f"*NSET, NSET={name}", *(f"{node + 1}," for node in nodes)]
    return "\n".join(lines) + "\n"


def two_cantilevers(folder):
    """Write a bundle of two beams apart, with an interface each.

    The loads of `b` begin at zero, so it has none at one of two opposite corners. It is pulled 0.1
    mm beside its axis, so at the corner that turns it most it is not pulled.
    """
    beams = [box("hex20", (8, 2, 2), (0.4, *ends)) for ends in ((0.02, 0.01), (0.01, 0.02))]
    mesh = together(beams[0], moved(beams[1], [0.0, 0.1, 0.0]))
    sets = {name: group.node_ids for name, group in mesh.facet_groups.items()}
    (folder / "beams.inp").write_text(deck_of(mesh, sets))
    text = 'name = "beams"\ntitle = "Beams"\nanalysis = {nonlinear = false}\n'
    text += 'mesh = {file = "beams.inp", unit = "m"}\nsupports = {fixed = ["a_x0", "b_x0"]}\n'
    text += '[[material]]\nregion = "all"\nyoungs_modulus = 70e9\npoisson_ratio = 0.3\n'
    loads = {"a": ((100, 20, 9), (1, 0.5, 0.5)), "b": ((100, 9, 20), (1, 0.5, 1.9))}
    for name, largest in loads.items():
        low = -1 if name == "a" else 0
        force, moment = ([[low * size, size] for size in sizes] for sizes in largest)
        text += f'[[interface]]\nname = "{name}"\nsection = "{name}_x1"\ncoupling = "rigid"\n'
        text += f"range = {{force = {force}, moment = {moment}}}\n"
    text += "point = [0.4, 0.1051, 0.01]\n"
    (folder / "component.toml").write_text(text)
    return folder


def rod_between_loads(folder):
    """Write a bundle of a rod of 1 m, fixed in its middle, with loads at both ends."""
    mesh = box("hex20", (2, 2, 12), (0.02, 0.02, 1.0))
    middle = np.flatnonzero(np.abs(mesh.points[:, 2] - 0.5) < 1e-9)
    sets = {
        "middle": middle,
        "low": mesh.facet_groups["z0"].node_ids,
        "high": mesh.facet_groups["z1"].node_ids,
    }
    (folder / "rod.inp").write_text(deck_of(mesh, sets))
    text = LINK[LINK.index("[[material]]") : LINK.index("[[interface]]")]
    loads = "range = {force = [20, 20, 5000], moment = [5, 5, 5]}"
    for name, section in (("left", "low"), ("right", "high")):
        text += f'[[interface]]\nname = "{name}"\nsection = "{section}"\ncoupling = "rigid"\n'
        text += loads + "\n"
    head = 'name = "rod"\ntitle = "Rod"\n[mesh]\nfile = "rod.inp"\nunit = "m"\n'
    text += '[supports]\nfixed = ["middle"]\n' + LINK[LINK.index("[analysis]") :]
    (folder / "component.toml").write_text(head + text)
    return folder


def with_second(part, section, *, coupling="rigid", point=None, axes=None, locked=()):
    """Return a component with another interface, "right", at a facet group; the first is "left"."""
    own = section_of_facets(part.mesh.points, part.mesh.facet_groups[section])
    place = own.centre if point is None else np.asarray(point, dtype=float)
    frame = np.eye(3) if axes is None else np.asarray(axes, dtype=float)
    right = AttachedInterface("interface[1]", "right", own, place, frame, coupling, tuple(locked))
    left = replace(part.interfaces[0], key="interface[0]", name="left")
    return replace(part, interfaces=(left, right))


def wobble(points):
    return points + 0.03 * np.sin(7 * points[:, [1, 2, 0]])


def column(first="rigid", second="rigid", *, nonlinear=False, warp=wobble, **right):
    """Return a column held at its waist with interfaces at both ends, on soft material."""
    mesh = box("hex20", (2, 2, 6), (1.0, 1.2, 4.0), warp=warp)
    part = component(mesh, section="z0", coupling=first, young=1.0, nonlinear=nonlinear)
    waist = mesh.facet_groups["y0"].node_ids
    waist = waist[np.abs(mesh.points[waist, 2] - 2.0) < 0.6]
    return with_second(replace(part, fixed_nodes=waist), "z1", coupling=second, **right)
