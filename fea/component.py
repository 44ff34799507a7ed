"""From a bundle to what the solver takes: the mesh built and every group it names found."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from wrenchbook.fea.coupling.rotation import rotation_less_identity
from wrenchbook.fea.coupling.section import InterfaceSection, section_of_facets, section_of_nodes
from wrenchbook.fea.mesh.cad import mesh_geometry
from wrenchbook.fea.mesh.element_order import first_order_problems, second_order
from wrenchbook.fea.mesh.facets import facets_within, outer_surface
from wrenchbook.fea.mesh.generators import GENERATORS
from wrenchbook.fea.mesh.io.read import read_mesh
from wrenchbook.fea.mesh.mesh import Mesh
from wrenchbook.fea.mesh.quality import cell_problems
from wrenchbook.fea.spec.problems import BundleError, BundleProblem, suggest
from wrenchbook.fea.spec.schema import (
    FREEDOMS,
    Analysis,
    Bundle,
    Interface,
    Material,
    MeshSource,
    Sliding,
    Supports,
)

Array = np.ndarray

_ZERO = 1e-9
"""Of a projection or a singular value, relative: axes are written to about so many digits."""


class Mount(NamedTuple):
    """A bushing (`fea.spec.schema.Bushing`) with its nodes found; `point` has shape (3,), m."""

    section: InterfaceSection
    point: Array
    hold: Interface
    stiffness: Array


@dataclass(frozen=True, eq=False)
class ComponentModel:
    """A deformable part, ready to be solved; all in metres and pascals.

    Attributes
    ----------
    bundle
        What it was built from; its analysis, coupling and locked freedoms are below as well.
    mesh
        Every point belongs to a cell.
    materials, material_of_cells
        The materials, and for each block of the mesh an array of shape (m,) with the number of
        each cell's material.
    fixed_nodes
        Sorted nodes that do not move, shape (k,), int64.
    held
        Nodes that slide, none of them fixed or tied to the interface, sorted, shape (k,), and
        projectors on the directions in which each is held, in the mesh's axes, shape (k, 3, 3).
    mounts
        The bushings; no node is in two of them, in one and the section, or in one and fixed.
    section
        The interface's nodes with their area weights.
    point
        The interface's reference point, shape (3,), m.
    axes
        Shape (3, 3), row i is the direction of the interface frame's axis i.
    """

    bundle: Bundle
    mesh: Mesh
    materials: tuple[Material, ...]
    material_of_cells: tuple[Array, ...]
    fixed_nodes: Array
    section: InterfaceSection
    point: Array
    axes: Array
    coupling: str
    locked: tuple[str, ...]
    analysis: Analysis
    held: tuple[Array, Array] = (np.empty(0, dtype=np.int64), np.empty((0, 3, 3)))
    mounts: tuple[Mount, ...] = ()

    @property
    def supported_nodes(self) -> Array:
        """Nodes that any support holds, sorted, shape (k,), int64."""
        groups = [mount.section.node_ids for mount in self.mounts]
        return np.unique(np.concatenate([self.fixed_nodes, self.held[0], *groups]))


def build(bundle: Bundle, mesh: Mesh | None = None) -> ComponentModel:
    """Build the mesh of `bundle`, unless it is given, and resolve the groups it names.

    Raises
    ------
    BundleError
        If the bundle has nothing to solve, its mesh cannot be read, a group is not in the mesh, a
        cell has no material or two, or supports or interface cannot hold a body.
    """
    if bundle.mesh is None or bundle.interface is None or bundle.supports is None:
        message = "missing; a component without a [mesh] is a table and cannot be solved"
        raise BundleError([BundleProblem("mesh", message)])
    mesh = mesh_of(bundle.mesh) if mesh is None else mesh
    problems = cell_problems(mesh) + first_order_problems(mesh)
    material_of_cells = _materials(mesh, bundle.materials, problems)
    fixed = _fixed_nodes(mesh, bundle.supports, problems)
    held = _held(mesh, bundle.supports.sliding, fixed, problems)
    bushings = {f"supports.bushing[{i}].group": b for i, b in enumerate(bundle.supports.bushings)}
    holds = {"interface.section": bundle.interface} | {k: b.hold for k, b in bushings.items()}
    joints = _joints(mesh, holds, problems)
    _check_apart(fixed, {key: section for key, (section, _, _) in joints.items()}, problems)
    if problems:
        raise BundleError(problems)
    for key, joint in joints.items():
        held = _left_sliding(mesh, held, key, *joint)
    section, point, interface = joints["interface.section"]
    return ComponentModel(
        bundle=bundle,
        mesh=mesh,
        materials=bundle.materials,
        material_of_cells=material_of_cells,
        fixed_nodes=fixed,
        section=section,
        point=point,
        axes=interface.axes,
        coupling=interface.coupling,
        locked=interface.locked,
        analysis=bundle.analysis,
        held=held,
        mounts=tuple(Mount(*joints[key], own.stiffness) for key, own in bushings.items()),
    )


def mesh_of(source: MeshSource) -> Mesh:
    """Return the mesh of a bundle, each point used by a cell.

    Raises
    ------
    BundleError
        If the file cannot be read, or its geometry not be meshed.
    """
    if source.file is not None and source.geometry is not None:
        return mesh_geometry(source.file, source.geometry)
    if source.file is not None:
        mesh = read_mesh(source.file, source.unit)
        return mesh if source.order is None else second_order(mesh)
    if source.generator is None or source.parameters is None:
        raise ValueError("a mesh source needs a file or a generator with its parameters")
    return GENERATORS[source.generator](**source.parameters).mesh()


def _materials(
    mesh: Mesh, materials: tuple[Material, ...], problems: list[BundleProblem]
) -> tuple[Array, ...]:
    """Return each cell's material; "all" fills what no other material names."""
    numbers = tuple(np.full(len(block), -1) for block in mesh.blocks)
    named = [(i, m) for i, m in enumerate(materials) if m.region != "all"]
    for i, material in named:
        key = f"material[{i}].region"
        if material.region not in mesh.regions:
            groups = ["all", *mesh.regions]
            problems.append(_missing(key, material.region, "cell group", groups))
            continue
        cells = mesh.regions[material.region]
        if any((block[chosen] >= 0).any() for block, chosen in zip(numbers, cells, strict=True)):
            message = f'"{material.region}" shares cells with another material\'s region'
            problems.append(BundleProblem(key, message))
        for block, chosen in zip(numbers, cells, strict=True):
            block[chosen] = i
    _fill_the_rest(numbers, materials, problems)
    return numbers


def _fill_the_rest(
    numbers: tuple[Array, ...], materials: tuple[Material, ...], problems: list[BundleProblem]
) -> None:
    general = [i for i, material in enumerate(materials) if material.region == "all"]
    if len(general) > 1:
        problems.append(BundleProblem(f"material[{general[1]}].region", '"all" is there twice'))
    left = sum(int((block < 0).sum()) for block in numbers)
    if left and not general:
        message = f'{left} cells have no material; name their region or add one for "all"'
        problems.append(BundleProblem("material", message))
    for block in numbers:
        block[block < 0] = general[0] if general else 0


def _fixed_nodes(mesh: Mesh, supports: Supports, problems: list[BundleProblem]) -> Array:
    names = [(f"supports.fixed[{i}]", name) for i, name in enumerate(supports.fixed)]
    found = [_group_nodes(mesh, key, name, problems) for key, name in names]
    nodes = np.unique(np.concatenate([np.empty(0, dtype=np.int64), *found]))
    if (
        supports.sliding or supports.bushings
    ):  # then `fea.check.motions` tells whether all hold the part
        return nodes
    if all(len(ids) for ids in found) and not _spans_a_plane(mesh.points[nodes]):
        message = "its nodes lie on one line, about which the component can turn; fix more"
        problems.append(BundleProblem("supports.fixed", message))
    return nodes


def _held(
    mesh: Mesh, sliding: Iterable[Sliding], fixed: Array, problems: list[BundleProblem]
) -> tuple[Array, Array]:
    """Return the nodes that slide and the projectors on what holds each; fixed ones are none."""
    spans = np.zeros((len(mesh.points), 3, 3))
    for i, own in enumerate(sliding):
        nodes = _group_nodes(mesh, f"supports.sliding[{i}].group", own.group, problems)
        spans[nodes] += own.directions.T @ own.directions
    spans[fixed] = 0.0
    nodes = np.flatnonzero(spans.any(axis=(1, 2)))
    sizes, axes = np.linalg.eigh(spans[nodes])
    return nodes, (axes * (sizes > _ZERO)[:, None]) @ axes.swapaxes(1, 2)


def _joints(
    mesh: Mesh, holds: Mapping[str, Interface], problems: list[BundleProblem]
) -> dict[str, tuple[InterfaceSection, Array, Interface]]:
    """Return by key each section with its reference point, shape (3,), m, those found."""
    joints = {}
    for key, hold in holds.items():
        section = _section(mesh, key, hold, problems)
        if section is not None:
            point = section.centre if hold.point is None else hold.point
            joints[key] = section, point, hold
    return joints


def _left_sliding(
    mesh: Mesh,
    held: tuple[Array, Array],
    key: str,
    section: InterfaceSection,
    point: Array,
    own: Interface,
) -> tuple[Array, Array]:
    """Return the sliding nodes less those that a rigid coupling ties.

    Raises
    ------
    BundleError
        If locked freedoms do not hold a rigid section's sliding nodes, or all nodes of a
        distributed one slide, so that their mean is not free.
    """
    nodes, projectors = held
    shared = np.isin(nodes, section.node_ids)
    arms = (mesh.points[nodes[shared]] - point) @ own.axes.T
    if own.coupling == "rigid" and _stay(arms, own.axes @ projectors[shared] @ own.axes.T, own):
        return nodes[~shared], projectors[~shared]
    if own.coupling == "distributed" and shared.sum() < len(section.node_ids):
        return held
    message = (
        f"{shared.sum()} of its nodes slide by [supports], but its free motions would move them "
        "off; name fewer nodes, or lock these motions of a rigid interface (interface.locked)"
    )
    raise BundleError([BundleProblem(key, message)])


def _stay(arms: Array, held: Array, own: Interface) -> bool:
    """Return whether motions of an interface leave nodes at `arms`, (s, 3), where `held` says."""
    active = np.array([name not in own.locked for name in FREEDOMS])
    motion = active * np.array([0.3, 0.5, 0.7, 0.2, 0.6, 0.4])  # any: metres, radians
    moved = motion[:3] + arms @ rotation_less_identity(motion[3:]).T
    off = np.abs(held @ moved[:, :, None]).max(initial=0.0)
    return bool(off <= _ZERO * max(np.abs(arms).max(initial=0.0), 1.0))


def _section(
    mesh: Mesh, key: str, interface: Interface, problems: list[BundleProblem]
) -> InterfaceSection | None:
    nodes = _group_nodes(mesh, key, interface.section, problems)
    if not len(nodes):
        return None
    if not _spans_a_plane(mesh.points[nodes]):
        message = f'"{interface.section}" lies on one line, so it has no rotation; take a face'
        problems.append(BundleProblem(key, message))
    if interface.section in mesh.facet_groups:
        return section_of_facets(mesh.points, mesh.facet_groups[interface.section])
    facets = facets_within(outer_surface(mesh.blocks), nodes)
    if facets.blocks:
        return section_of_facets(mesh.points, facets, nodes)
    return section_of_nodes(mesh.points, nodes)


def _group_nodes(mesh: Mesh, key: str, name: str, problems: list[BundleProblem]) -> Array:
    """Return the nodes of a facet group or node group; none, and a problem, if there is none."""
    if name in mesh.facet_groups:
        return mesh.facet_groups[name].node_ids
    if name in mesh.node_groups:
        return np.unique(mesh.node_groups[name])
    groups = [*mesh.facet_groups, *mesh.node_groups]
    if name in mesh.regions:
        message = f'"{name}" is a group of cells; name a group of facets or nodes{_listed(groups)}'
        problems.append(BundleProblem(key, message))
    else:
        problems.append(_missing(key, name, "facet or node group", groups))
    return np.empty(0, dtype=np.int64)


def _missing(key: str, name: str, kind: str, groups: list[str]) -> BundleProblem:
    message = f'the mesh has no {kind} "{name}"{suggest(name, groups)}{_listed(groups)}'
    return BundleProblem(key, message)


def _listed(groups: list[str]) -> str:
    return f" (it has {', '.join(groups)})" if groups else " (it has none at all)"


def _check_apart(
    fixed: Array, sections: Mapping[str, InterfaceSection], problems: list[BundleProblem]
) -> None:
    taken = {"fixed by [supports]": fixed}
    for key, section in sections.items():
        for what, nodes in taken.items():
            shared = len(np.intersect1d(nodes, section.node_ids))
            if shared:
                message = f"{shared} of its nodes are {what}; the two must not touch"
                problems.append(BundleProblem(key, message))
        taken[f"in {key}"] = section.node_ids


def _spans_a_plane(points: Array) -> bool:
    """Return whether points do not all lie on one line."""
    if len(points) < 3:
        return False
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(spread[1] > 1e-9 * spread[0])
