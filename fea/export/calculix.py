"""Write a component as a CalculiX input deck.

``python -m wrenchbook.fea.export.calculix BUNDLE > plate.inp`` prints it.

The deck is complete: mesh, materials, supports, rigid interfaces and one step that takes the wrench
from $FX $FY $FZ $MX $MY $MZ, of an interface with a name from $NAME.FX and so on, and the
temperature, where it is an input, from $TEMPERATURE. It is the start of a ``[deck]`` that an expert
then extends (contact, plasticity), and the example of ``data/components/plate_ccx``.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import assert_never

import numpy as np

from wrenchbook.fea.bundle.read import FILE_NAME, BundleError, bundle_in
from wrenchbook.fea.component import AttachedInterface, ComponentModel, build
from wrenchbook.fea.mesh.io.translated import rows_of
from wrenchbook.fea.spec.material import Orthotropic
from wrenchbook.fea.spec.problems import BundleProblem
from wrenchbook.fea.spec.schema import ACCELERATIONS, FREEDOMS, PLACEHOLDERS, TEMPERATURE

# Their nodes are in the same order as those of `fea.mesh.mesh`.
_ELEMENTS = {"hex20": "C3D20R", "tet10": "C3D10", "wedge15": "C3D15"}
_MIN_COMPONENT = 1e-12  # component of a unit vector; smaller ones are roundoff

# CalculiX halves increments that are too large. Its default tolerance leaves errors of up to 5e-3
# in small rotations.
_NONLINEAR = (
    "*STEP, NLGEOM, INC=1000",
    "*STATIC",
    "0.5, 1., 1e-5, 0.5",
    "*CONTROLS, PARAMETERS=FIELD",
    "1e-7, 1e-7",
)
_LINEAR = ("*STEP", "*STATIC")


def deck_of(component: ComponentModel, comments: Iterable[str] = ()) -> str:
    """Return the deck of a component with a rigid coupling, in metres, newtons and pascals.

    Its global axes are the interface frame's, so the wrench and the motion need no rotation. The
    printed motion is that of the sets REF (translation) and ROT (rotation vector), for the reader
    "calculix-dat"; of an interface with a name REF_NAME and ROT_NAME.

    comments: first lines of the deck.

    Raises BundleError if CalculiX has no counterpart: a distributed coupling, whose mean motion it
    does not report, interfaces of different axes, or cells without an element type.
    """
    problems = []
    for interface in component.interfaces:
        if interface.coupling != "rigid":
            message = (
                f'CalculiX does not print the motion of a "{interface.coupling}" coupling; export '
                'the component with coupling = "rigid"'
            )
            problems.append(BundleProblem(f"{interface.key}.coupling", message))
        if not np.array_equal(interface.axes, component.axes):
            message = "must equal those of the first interface, as a deck has one frame; copy them"
            problems.append(BundleProblem(f"{interface.key}.axes", message))
    for bushing in component.frames:
        if bushing.coupling != "rigid":
            message = (
                'cannot be exported, since a deck has no such spring; write coupling = "rigid"'
            )
            problems.append(BundleProblem(f"{bushing.key}.coupling", message))
    if component.temperature_rise is not None:
        message = "cannot be exported; leave the field out and write *TEMPERATURE into the deck"
        problems.append(BundleProblem("inputs.temperature.field", message))
    for block in component.mesh.blocks:
        if block.kind not in _ELEMENTS:
            known = ", ".join(_ELEMENTS)
            message = f"CalculiX has no element for {block.kind} cells; mesh with one of {known}"
            problems.append(BundleProblem("mesh", message))
    if problems:
        raise BundleError(problems)
    lines = [*(f"** {comment}" for comment in comments), *_body(component), *_step(component)]
    return "\n".join(lines) + "\n"


def _body(component: ComponentModel) -> Iterator[str]:
    """Yield everything above the step."""
    points = component.mesh.points @ component.axes.T
    yield "*NODE, NSET=ALL"
    yield from (f"{i}, {_numbers(point)}" for i, point in enumerate(points, start=1))
    for i, interface in enumerate(component.interfaces):
        at = _numbers(component.axes @ interface.point)
        yield f"*NODE, NSET={_set('REF', interface)}\n{len(points) + 2 * i + 1}, {at}"
        yield f"*NODE, NSET={_set('ROT', interface)}\n{len(points) + 2 * i + 2}, {at}"
    yield from _elements(component)
    yield from _materials(component)
    if component.fixed_nodes.size:
        yield "*NSET, NSET=FIXED"
        yield from rows_of(map(str, component.fixed_nodes + 1))
    yield from _sliding(component)
    yield from _dependents(component)
    yield from _springs(component)
    for i, attached in enumerate(component.interfaces):
        ref = len(points) + 2 * i + 1
        yield f"*NSET, NSET={_set('SECTION', attached)}"
        yield from rows_of(map(str, attached.section.node_ids + 1))
        yield f"*RIGID BODY, NSET={_set('SECTION', attached)}, REF NODE={ref}, ROT NODE={ref + 1}"
    if component.temperature is not None:
        reference = _numbers([component.temperature.reference])
        yield f"*INITIAL CONDITIONS, TYPE=TEMPERATURE\nALL, {reference}"
    yield "*BOUNDARY"
    if component.fixed_nodes.size:
        yield "FIXED, 1, 3"
    for interface in component.interfaces:
        yield from (_freedom(name, interface) for name in interface.locked)


def _springs(component: ComponentModel) -> Iterator[str]:
    """Yield each frame as a rigid body, and a spring for each eigenvector of a stiffness.

    The spring is on a node of its own, whose displacement is the eigenvector's combination of a
    frame's six freedoms, or of their differences between two frames.
    """
    if component.joints and component.analysis.nonlinear:
        yield "** The axes of springs between two groups do not turn here."
    # Two nodes of each interface and frame, for translation and rotation, follow the mesh's.
    node = len(component.mesh.points) + 2 * len(component.interfaces) + 1
    element = sum(len(block) for block in component.mesh.blocks) + 1
    first = node
    for i, frame in enumerate(component.frames):
        at = _numbers(component.axes @ frame.point)
        yield f"*NODE\n{node}, {at}\n{node + 1}, {at}\n*NSET, NSET=BUSHING{i}"
        yield from rows_of(map(str, frame.section.node_ids + 1))
        yield f"*RIGID BODY, NSET=BUSHING{i}, REF NODE={node}, ROT NODE={node + 1}"
        node += 2

    for ends, stiffness in component.springs:
        frame = component.frames[ends[0]]
        at = _numbers(component.axes @ frame.point)
        signs = (1.0,) if len(ends) == 1 else (-1.0, 1.0)  # the second end relative to the first
        rotation = np.kron(np.eye(2), frame.axes @ component.axes.T)
        sizes, motions = np.linalg.eigh(stiffness)
        for size, motion in zip(sizes, motions.T, strict=True):
            if size <= 0:
                continue
            terms = []
            for end, sign in zip(ends, signs, strict=True):
                for freedom, x in enumerate(sign * (motion @ rotation)):
                    half, axis = divmod(freedom, 3)  # half 1: the frame's second node, of rotations
                    if abs(x) > _MIN_COMPONENT:
                        terms.append((first + 2 * end + half, axis + 1, x))
            yield f"*NODE\n{node}, {at}\n*BOUNDARY\n{node}, 2, 3"
            yield from _equation([(node, 1, -1.0), *terms])
            yield f"*ELEMENT, TYPE=SPRING1, ELSET=K{element}\n{element}, {node}"
            yield f"*SPRING, ELSET=K{element}\n1\n{_numbers([size])}"
            node, element = node + 1, element + 1


def _dependents(component: ComponentModel) -> Iterator[str]:
    """Yield the equations of dependent nodes."""
    if (dependents := component.mesh.dependents) is None:
        return
    for node in dependents.nodes.tolist():
        row = dependents.map[[node]].tocoo()
        terms = list(zip(row.col.tolist(), row.data.tolist(), strict=True))
        for axis in (1, 2, 3):
            yield from _equation([(node + 1, axis, -1.0), *((n + 1, axis, w) for n, w in terms)])


def _equation(terms: list[tuple[int, int, float]]) -> Iterator[str]:
    """Yield an equation of nodes, axes and factors, the dependent one first."""
    rows = [f"{at}, {axis}, {_numbers([x])}" for at, axis, x in terms]
    yield f"*EQUATION\n{len(rows)}"
    yield from (", ".join(rows[j : j + 4]) for j in range(0, len(rows), 4))


def _materials(component: ComponentModel) -> Iterator[str]:
    """Yield materials M0, M1, ... with the sections of the element sets E0, E1, ..."""
    for i, material in enumerate(component.materials):
        yield f"*MATERIAL, NAME=M{i}"
        if isinstance(material, Orthotropic):
            constants = [*material.youngs_moduli, *material.poisson_ratios, *material.shear_moduli]
            # Eight numbers a line, the ninth on the next.
            yield "*ELASTIC, TYPE=ENGINEERING CONSTANTS"
            yield f"{_numbers(constants[:8])}\n{_numbers(constants[8:])}"
        elif material.law == "isotropic" or not component.analysis.nonlinear:
            # For any law: CalculiX solves a hyperelastic deck as nonlinear.
            yield f"*ELASTIC\n{_numbers([material.youngs_modulus, material.poisson_ratio])}"
        elif material.law == "neo-hookean":
            shear = material.youngs_modulus / (2 * (1 + material.poisson_ratio))
            bulk = material.youngs_modulus / (3 * (1 - 2 * material.poisson_ratio))
            yield f"*HYPERELASTIC, NEO HOOKE\n{_numbers([shear / 2, 2 / bulk])}"
        else:
            assert_never(material.law)
        heavy = component.accelerated or component.analysis.gravity is not None
        if heavy and material.density is not None:
            yield f"*DENSITY\n{_numbers([material.density])}"
        if component.temperature is not None:
            values = material.thermal_expansion or (0.0, 0.0, 0.0)
            kind, count = ("", 1) if material.orthotropic is None else (", TYPE=ORTHO", 3)
            yield f"*EXPANSION, ZERO={component.temperature.reference:.12e}{kind}"
            yield _numbers(values[:count])
        orientation = ""
        if material.orthotropic is not None:
            yield from _orientation(i, material.orthotropic, component.axes)
            orientation = f", ORIENTATION=O{i}"
        yield f"*SOLID SECTION, ELSET=E{i}, MATERIAL=M{i}{orientation}"


def _set(kind: str, interface: AttachedInterface) -> str:
    """Return a set's name: REF, ROT or SECTION, with the interface's name if it has one."""
    return f"{kind}_{interface.name}".upper() if interface.name else kind


def _sliding(component: ComponentModel) -> Iterator[str]:
    """Yield the conditions of sliding nodes: a boundary condition along an axis, or an equation."""
    nodes, held = component.guided
    for node, projector in zip(nodes + 1, component.axes @ held @ component.axes.T, strict=True):
        # Each held direction makes one displacement depend on the others: its largest component.
        held_count = round(np.trace(projector))
        dependent = np.argsort(-np.diagonal(projector))[:held_count]
        rows = np.linalg.solve(projector[np.ix_(dependent, dependent)], projector[dependent])
        for axis, row in zip(dependent, rows, strict=True):
            others = [i for i in range(3) if i not in dependent and abs(row[i]) > _MIN_COMPONENT]
            if others:
                yield from _equation([(node, i + 1, row[i]) for i in (axis, *others)])
            else:
                yield f"*BOUNDARY\n{node}, {axis + 1}"


def _orientation(number: int, orthotropic: Orthotropic, axes: np.ndarray) -> Iterator[str]:
    """Yield directions by a point on x and a point on y, or by two points of a cylinder's axis."""
    if orthotropic.cylinder is not None:
        cylinder = orthotropic.cylinder
        point, axial = np.array([cylinder.point, cylinder.axis]) @ axes.T
        yield f"*ORIENTATION, NAME=O{number}, SYSTEM=CYLINDRICAL"
        yield _numbers([*point, *(point + axial)])
        return
    x, y, _ = np.array(orthotropic.axes) @ axes.T
    yield f"*ORIENTATION, NAME=O{number}\n{_numbers([*x, *y])}"


def _elements(component: ComponentModel) -> Iterator[str]:
    """Yield the cells, one set for each material."""
    number = 1
    for block, materials in zip(component.mesh.blocks, component.material_of_cells, strict=True):
        for i in range(len(component.materials)):
            chosen = block.nodes[materials == i]
            if len(chosen):
                full = block.kind == "hex20" and component.analysis.integration == "full"
                element = "C3D20" if full else _ELEMENTS[block.kind]
                yield f"*ELEMENT, TYPE={element}, ELSET=E{i}"
            for cell in chosen + 1:
                yield ",\n".join(rows_of(map(str, [number, *cell])))
                number += 1


def _step(component: ComponentModel) -> Iterator[str]:
    """Yield the step with the loads, and a step before it that tightens bolts, if there are any."""
    start = _NONLINEAR if component.analysis.nonlinear else _LINEAR
    if component.bolts:
        yield "** Bolts are tightened in a first step. Displacements count from before it."
        slips = [
            (bolt, int(np.abs(component.axes @ bolt.axis).argmax())) for bolt in component.bolts
        ]
        yield from (*start, "*CLOAD")
        for bolt, axis in slips:  # across its axis the slip is held, or an equation determines it
            load = -bolt.bolt.force / (component.axes @ bolt.axis)[axis]
            yield f"{bolt.slip + 1}, {axis + 1}, {_numbers([load])}"
        yield "*END STEP"
        yield from start
        fixed = [(bolt.slip + 1, axis + 1) for bolt, axis in slips if bolt.bolt.keeps == "length"]
        if fixed:
            yield "*BOUNDARY, FIXED"
            yield from (f"{node}, {axis}, {axis}" for node, axis in fixed)
    else:
        yield from start

    yield from _pulls(component)
    yield "*CLOAD"
    for interface in component.interfaces:
        for name, placeholder in zip(FREEDOMS, placeholders(interface.name), strict=True):
            if name in interface.locked:
                yield f"** {placeholder} acts on a freedom that is held"
            else:
                yield f"{_freedom(name, interface)}, {placeholder}"
    if component.temperature is not None:
        yield f"*TEMPERATURE\nALL, {further_placeholder(TEMPERATURE)}"
    for attached in component.interfaces:
        for kind in ("REF", "ROT"):
            yield f"*NODE PRINT, NSET={_set(kind, attached)}\nU"
    yield "*END STEP"


def _pulls(component: ComponentModel) -> Iterator[str]:
    """Yield gravity, and the accelerations that are inputs, on all cells."""
    pulls = []
    if component.analysis.gravity is not None:
        gravity = component.axes @ np.array(component.analysis.gravity)
        size = float(np.linalg.norm(gravity))
        pulls.append((_numbers([size]), gravity / size))
    if component.accelerated:
        names = map(further_placeholder, ACCELERATIONS)
        pulls += zip(names, component.axes.T, strict=True)
    used = {int(i) for block in component.material_of_cells for i in np.unique(block)}
    if pulls:
        yield "*DLOAD"
    for size, direction in pulls:
        yield from (f"E{i}, GRAV, {size}, {_numbers(direction)}" for i in sorted(used))


def placeholders(name: str) -> tuple[str, ...]:
    """Return the placeholders of an interface's wrench, its name empty for a single interface."""
    return tuple(f"${name}.{word[1:]}" if name else word for word in PLACEHOLDERS)


def further_placeholder(name: str) -> str:
    """Return the placeholder of a further input, in the bundle's unit."""
    return f"${name.upper()}"


def _freedom(name: str, interface: AttachedInterface) -> str:
    """Return the node set and the axis, 1 to 3, of a freedom such as "ux" or "rz"."""
    kind = "REF" if name.startswith("u") else "ROT"
    return f"{_set(kind, interface)}, {'xyz'.index(name[1]) + 1}"


def _numbers(values: Iterable[float]) -> str:
    """Return numbers with all the digits that CalculiX reads: 20 characters each."""
    return ", ".join(f"{value:.12e}" for value in values)


def main(arguments: list[str] | None = None) -> int:
    """Print the deck of the bundle that the arguments name; return the exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m wrenchbook.fea.export.calculix", description=__doc__
    )
    parser.add_argument(
        "bundle", type=Path, help="a bundle's folder, or a .toml file like its component.toml"
    )
    path = parser.parse_args(arguments).bundle
    try:
        component = build(bundle_in(path / FILE_NAME if path.is_dir() else path))
        origin = f"Made by: python -m wrenchbook.fea.export.calculix {path.name}"
        units = "Metres, newtons, pascals; the axes are those of the interface frame."
        sys.stdout.write(deck_of(component, (component.bundle.title, origin, units)))
    except BundleError as error:
        print(error, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
