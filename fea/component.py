"""The component model of a bundle: its mesh, with every group that the bundle names resolved."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from wrenchbook.fea.coupling.section import InterfaceSection, section_of_facets, section_of_nodes
from wrenchbook.fea.mesh.bolts import BoltCut, cut_bolts
from wrenchbook.fea.mesh.element_order import first_order_problems
from wrenchbook.fea.mesh.facets import facets_within, outer_surface
from wrenchbook.fea.mesh.groups import group_nodes, missing
from wrenchbook.fea.mesh.io.temperature_field import shape_on
from wrenchbook.fea.mesh.mapping import cell_problems
from wrenchbook.fea.mesh.mesh import Mesh
from wrenchbook.fea.mesh.sources import mesh_of
from wrenchbook.fea.mesh.tie import TiedNodes, tie_surfaces
from wrenchbook.fea.spec.material import AnyMaterial
from wrenchbook.fea.spec.mesh_source import MeshSource
from wrenchbook.fea.spec.problems import BundleError, BundleProblem, point_text
from wrenchbook.fea.spec.schema import (
    ACCELERATIONS,
    FREEDOMS,
    TEMPERATURE,
    Analysis,
    Bundle,
    Interface,
    Joint,
    ScalarInput,
    Supports,
)
from wrenchbook.fea.tensors import rotation_less_identity

_ROUNDOFF = 1e-9
"""Relative size of projections, and relative width of a set of points: smaller values are
roundoff, since axes and coordinates are written to about as many digits."""
_ANY_MOTION = np.array([0.3, 0.5, 0.7, 0.2, 0.6, 0.4])
"""Motion of a section, m and rad: an arbitrary one, without a pattern by which parts of it could
cancel."""


@dataclass(frozen=True, eq=False)
class AttachedInterface:
    """An interface, or a bushing, with the nodes of its section in the mesh."""

    key: str  # key in the bundle: ``interface``, ``interface[1]``, ``supports.bushing[0]``
    name: str  # empty for a single interface
    section: InterfaceSection  # nodes of the interface with their weights
    point: np.ndarray  # reference point, shape (3,), m
    axes: np.ndarray  # shape (3, 3), row i is the direction of its frame's axis i
    coupling: str
    locked: tuple[str, ...]
    weights: str = "area"  # kind of its nodes' weights: "area", "equal" or "deck"

    @property
    def where(self) -> str:
        """The bundle's key of its nodes."""
        if self.key.startswith("supports."):
            return f"{self.key}.group"
        return f"{self.key}.{'groups' if self.key.startswith('spring[') else 'section'}"


@dataclass(frozen=True, eq=False)
class AttachedJoint:
    """A spring between two groups, or one rigid body of both."""

    # Both ends of a spring, at one point; the single frame of a rigid joint.
    ends: tuple[AttachedInterface, ...]
    stiffness: np.ndarray | None  # shape (6, 6), N/m, N/rad and N·m/rad; None for a rigid joint


@dataclass(frozen=True, eq=False)
class ComponentModel:
    """A deformable part, ready to be solved; all in metres and pascals."""

    bundle: Bundle  # the bundle from which it was built
    mesh: Mesh  # with bolts cut; every other point belongs to a cell
    # materials, material_of_cells: the materials, and for each block of the mesh an array of shape
    # (m,) with the number of each cell's material.
    materials: tuple[AnyMaterial, ...]
    material_of_cells: tuple[np.ndarray, ...]
    fixed_nodes: np.ndarray  # sorted nodes that do not move, shape (k,), int64
    interfaces: tuple[AttachedInterface, ...]  # in the order of their loads and displacements
    analysis: Analysis
    # Nodes that slide, none of them fixed or coupled to an interface, sorted, shape (k,), and
    # projectors on the directions in which each is held, in the mesh's axes, shape (k, 3, 3).
    sliding: tuple[np.ndarray, np.ndarray] = (np.empty(0, dtype=np.int64), np.empty((0, 3, 3)))
    # Each with its stiffness, shape (6, 6); no node is in two, in a section, or fixed
    bushings: tuple[tuple[AttachedInterface, np.ndarray], ...] = ()
    further: tuple[ScalarInput, ...] = ()  # the inputs after the loads
    # In the bundle's order; the mesh has their nodes at their final positions.
    ties: tuple[TiedNodes, ...] = ()
    # Shape (n,): the part of the temperature's rise at each node; None for 1 everywhere
    temperature_rise: np.ndarray | None = None
    joints: tuple[AttachedJoint, ...] = ()
    bolts: tuple[BoltCut, ...] = ()
    uncut: Mesh | None = None  # the mesh before bolts are cut; None without bolts

    @property
    def uncut_mesh(self) -> Mesh:
        """The mesh before bolts are cut; without bolts, `mesh`."""
        return self.uncut or self.mesh

    @property
    def frames(self) -> list[AttachedInterface]:
        """Frames that are no interfaces: those of bushings, then those of the ends of joints."""
        ends = [end for joint in self.joints for end in joint.ends]
        return [*(bushing for bushing, _ in self.bushings), *ends]

    @property
    def springs(self) -> list[tuple[tuple[int, ...], np.ndarray]]:
        """The stiffness of each spring, with the indices of the one or two frames it acts on."""
        springs: list[tuple[tuple[int, ...], np.ndarray]]
        springs = [((i,), stiffness) for i, (_, stiffness) in enumerate(self.bushings)]
        frame = len(springs)  # index of the first frame of a joint, see `frames`
        for joint in self.joints:
            if joint.stiffness is not None:
                springs.append(((frame, frame + 1), joint.stiffness))
            frame += len(joint.ends)
        return springs

    @property
    def guided(self) -> tuple[np.ndarray, np.ndarray]:
        """Nodes that slide, in the form of `sliding`, and the slips of bolts along their axes."""
        nodes, held = self.sliding
        guides = [np.eye(3) - np.outer(bolt.axis, bolt.axis) for bolt in self.bolts]
        held = np.array([*held, *guides]).reshape(-1, 3, 3)
        return np.append(nodes, np.array([bolt.slip for bolt in self.bolts], dtype=int)), held

    @property
    def temperature(self) -> ScalarInput | None:
        """The temperature, if it is an input; it is then the first after the loads."""
        for scalar in self.further:
            if scalar.name == TEMPERATURE:
                return scalar
        return None

    @property
    def is_preloaded(self) -> bool:
        """Whether self-weight or bolts, which always act, load the part at no wrench."""
        return self.analysis.gravity is not None or bool(self.bolts)

    @property
    def accelerated(self) -> bool:
        """Whether the acceleration is an input; it is then the last three."""
        return any(scalar.name in ACCELERATIONS for scalar in self.further)

    @property
    def reference_inputs(self) -> np.ndarray:
        """Inputs without effect: zero loads, shape (6 i,), and the references of the others."""
        loads = np.zeros(len(FREEDOMS) * len(self.interfaces))
        return np.append(loads, [scalar.reference for scalar in self.further])

    def warming(self, inputs: np.ndarray) -> float:
        """Return the temperature of inputs (k,), K from the reference; 0 if it is no input."""
        warm = self.temperature
        index = len(FREEDOMS) * len(self.interfaces)
        return 0.0 if warm is None else float(inputs[index] - warm.reference)

    @property
    def supported_nodes(self) -> np.ndarray:
        """Nodes that any support holds, sorted, shape (k,), int64."""
        groups = [bushing.section.node_ids for bushing, _ in self.bushings]
        return np.unique(np.concatenate([self.fixed_nodes, self.sliding[0], *groups]))

    @property
    def axes(self) -> np.ndarray:
        """Axes of the first interface, a row each, shape (3, 3): the frame of the equations."""
        return self.interfaces[0].axes

    @property
    def active(self) -> np.ndarray:
        """Indices of the freedoms that are not locked, six an interface, shape (k,), int64."""
        is_active = [
            name not in interface.locked for interface in self.interfaces for name in FREEDOMS
        ]
        return np.flatnonzero(is_active)


def build(bundle: Bundle, mesh: Mesh | None = None) -> ComponentModel:
    """Build the mesh of `bundle`, unless it is given, and find the groups that the bundle names.

    A mesh that is given has no bolts cut.

    Raises BundleError if the bundle has no mesh to solve, or a file, group, material or support is
    wrong.
    """
    source = _mesh_source(bundle)
    mesh = mesh_of(source) if mesh is None else mesh
    problems = first_order_problems(mesh)
    uncut = mesh
    mesh, bolts = cut_bolts(mesh, bundle.bolts, problems)
    material_of_cells = _material_numbers(mesh, bundle.materials, problems)

    supports = bundle.supports or Supports()
    fixed = _fixed_nodes(mesh, supports, problems)
    # The sum of d d^T over directions d that hold sliding nodes, (n, 3, 3), else zero.
    held = np.zeros((len(mesh.points), 3, 3))
    for i, support in enumerate(supports.sliding):
        nodes = group_nodes(mesh, f"supports.sliding[{i}].group", support.group, problems)
        held[nodes] += support.directions.T @ support.directions
    held[fixed] = 0.0
    interfaces, bushings, joints = _attach_all(bundle, mesh, supports, problems)
    ends = [end for joint in joints for end in joint.ends]
    frames = [*interfaces, *(bushing for bushing, _ in bushings), *ends]
    # Sliding nodes, and the projectors on their held directions.
    nodes = np.flatnonzero(held.any(axis=(1, 2)))
    sizes, axes = np.linalg.eigh(held[nodes])
    sliding = nodes, (axes * (sizes > _ROUNDOFF)[:, None]) @ axes.swapaxes(1, 2)
    for frame in frames:
        sliding = _free_sliding(mesh, sliding, frame, problems)

    # Ties move their nodes onto the main surfaces, and constrain them to these.
    held[fixed], held[sliding[0]] = np.eye(3), sliding[1]
    occupied = [(frame.where, frame.section.node_ids) for frame in frames]
    mesh, ties = tie_surfaces(mesh, bundle.ties, held, occupied, problems)
    for i, tie in enumerate(ties):
        not_tied = ~np.isin(sliding[0], tie.nodes)
        sliding = sliding[0][not_tied], sliding[1][not_tied]
        assert mesh.dependents is not None
        masters = mesh.dependents.map[tie.nodes].indices
        occupied.append((f"tie[{i}]", np.append(tie.nodes, masters)))

    problems = cell_problems(mesh) + problems
    _check_disjoint(mesh, fixed, frames, problems)
    _check_bolts(mesh, bolts, [("supports.fixed", fixed), *occupied], sliding, problems)
    _check_locked(bundle, interfaces, problems)
    if problems:
        raise BundleError(problems)

    materials, rise = bundle.materials, None
    if not any(scalar.name == TEMPERATURE for scalar in bundle.further):
        materials = tuple(replace(material, thermal_expansion=None) for material in materials)
    for scalar in bundle.further:
        if scalar.field is not None:  # only the temperature has a field
            rise = shape_on(mesh.points, scalar.field, scalar.reference)
    if bolts:  # ties move points of the mesh without cuts too, and make its nodes depend on others
        size = len(uncut.points)
        dependents = mesh.dependents and mesh.dependents.of_first(size)
        uncut = replace(uncut, points=mesh.points[:size], dependents=dependents)
    return ComponentModel(
        bundle=bundle,
        mesh=mesh,
        materials=materials,
        material_of_cells=material_of_cells,
        fixed_nodes=fixed,
        interfaces=tuple(interfaces),
        analysis=bundle.analysis,
        sliding=sliding,
        bushings=tuple(bushings),
        further=bundle.further,
        ties=ties,
        temperature_rise=rise,
        joints=tuple(joints),
        bolts=bolts,
        uncut=uncut if bolts else None,
    )


def _attach_all(
    bundle: Bundle, mesh: Mesh, supports: Supports, problems: list[BundleProblem]
) -> tuple[
    list[AttachedInterface], list[tuple[AttachedInterface, np.ndarray]], list[AttachedJoint]
]:
    """Return the interfaces, bushings with their stiffness, and joints of a bundle on its mesh."""
    is_single = len(bundle.interfaces) == 1
    interfaces = []
    for i, interface in enumerate(bundle.interfaces):
        table = "interface" if is_single else f"interface[{i}]"
        interfaces.append(_attach(mesh, f"{table}.section", interface, problems))
    bushings = []
    for i, bushing in enumerate(supports.bushings):
        end = _attach(mesh, f"supports.bushing[{i}].group", bushing.end(bushing.group), problems)
        bushings.append((end, bushing.stiffness))
    joints = [
        _join(mesh, f"spring[{i}].groups", joint, problems) for i, joint in enumerate(bundle.joints)
    ]
    return interfaces, bushings, joints


def _mesh_source(bundle: Bundle) -> MeshSource:
    """Return the mesh of a bundle; raise BundleError if it has none to solve."""
    tables = {  # beside a [deck], each of these tables is optional
        "mesh": bundle.mesh,
        "material": bundle.materials,
        "interface": bundle.interface,
        "supports": bundle.supports or any(interface.held for interface in bundle.interfaces),
    }
    absent = [name for name, value in tables.items() if not value]
    if bundle.mesh is not None and not absent:
        return bundle.mesh
    lacking = absent[0]
    brackets = "[[material]]" if lacking == "material" else f"[{lacking}]"
    message = f"is missing, so the component cannot be solved; add {brackets}"
    if lacking == "mesh" and bundle.deck is not None:
        message = (
            f"{bundle.name} is solved by its [deck], but this needs a [mesh]; name a component "
            "with a [mesh]"
        )
    raise BundleError([BundleProblem(lacking, message)])


def _material_numbers(
    mesh: Mesh, materials: tuple[AnyMaterial, ...], problems: list[BundleProblem]
) -> tuple[np.ndarray, ...]:
    """Return the index of each cell's material; "all" are cells that no other material names."""
    numbers = tuple(np.full(len(block), -1) for block in mesh.blocks)
    named = [(i, m) for i, m in enumerate(materials) if m.region != "all"]
    for i, material in named:
        key = f"material[{i}].region"
        if material.region not in mesh.regions:
            groups = ["all", *mesh.regions]
            problems.append(missing(key, material.region, "cell group", groups))
            continue
        cells = mesh.regions[material.region]
        before = np.concatenate([block[c] for block, c in zip(numbers, cells, strict=True)])
        taken = before[before >= 0]
        if taken.size:
            first = f'material[{taken[0]}], "{materials[taken[0]].region}"'
            message = f'"{material.region}" has {taken.size} cells of {first}; remove them from one'
            problems.append(BundleProblem(key, message))
        for block, chosen in zip(numbers, cells, strict=True):
            block[chosen] = i

    general = [i for i, material in enumerate(materials) if material.region == "all"]
    if len(general) > 1:
        message = f'repeats "all" of material[{general[0]}]; keep one of the two'
        problems.append(BundleProblem(f"material[{general[1]}].region", message))

    count = sum(int((block < 0).sum()) for block in numbers)
    if count and not general:
        pairs = zip(mesh.blocks, numbers, strict=True)
        nodes = np.concatenate([block.nodes[number < 0, 0] for block, number in pairs])
        message = (
            f"no material covers {count} of the {sum(map(len, numbers))} cells, such as the one "
            f'near {point_text(mesh.points[nodes[0]])} m; add a [[material]] with region = "all", '
            "or one with the region of these cells"
        )
        problems.append(BundleProblem("material", message))
    for block in numbers:
        block[block < 0] = general[0] if general else 0
    return numbers


def _fixed_nodes(mesh: Mesh, supports: Supports, problems: list[BundleProblem]) -> np.ndarray:
    """Return the fixed nodes, sorted, (k,); a problem if they alone hold the part, on one line."""
    names = [(f"supports.fixed[{i}]", name) for i, name in enumerate(supports.fixed)]
    groups = [group_nodes(mesh, key, name, problems) for key, name in names]
    nodes = np.unique(np.concatenate([np.empty(0, dtype=np.int64), *groups]))
    # `fea.check.mechanisms` checks all supports together.
    if not groups or supports.sliding or supports.bushings:
        return nodes
    if all(len(ids) for ids in groups) and not _spans_a_plane(mesh.points[nodes]):
        on_line = f"its {len(nodes)} nodes lie on one line, so the component can rotate"
        message = f"{on_line}; fix at least three that do not"
        problems.append(BundleProblem("supports.fixed", message))
    return nodes


def _attach(
    mesh: Mesh, key: str, interface: Interface, problems: list[BundleProblem]
) -> AttachedInterface:
    """Return an interface with its section, by area where its nodes bound faces."""
    nodes = group_nodes(mesh, key, interface.section, problems)
    if not len(nodes):
        section = InterfaceSection(nodes, np.empty(0), None, np.zeros(3))
    else:
        if not _spans_a_plane(mesh.points[nodes]):
            count = "has 1 node" if len(nodes) == 1 else f"has {len(nodes)} nodes on one line"
            message = (
                f'"{interface.section}" {count}, so it has no rotation; name the group of a face'
            )
            problems.append(BundleProblem(key, message))
        if interface.section in mesh.facet_groups:
            section = section_of_facets(mesh.points, mesh.facet_groups[interface.section])
        else:
            facets = facets_within(outer_surface(mesh.blocks), nodes)
            if facets.blocks:
                section = section_of_facets(mesh.points, facets, nodes)
            else:
                section = section_of_nodes(mesh.points, nodes)

    table = key.rpartition(".")[0]
    if interface.weights != "area" and len(nodes):
        section = replace(section, weights=_weights(mesh, table, interface, nodes, problems))
    return AttachedInterface(
        key=table,
        name=interface.name,
        section=section,
        point=section.centre if interface.point is None else interface.point,
        axes=interface.axes,
        coupling=interface.coupling,
        locked=interface.locked,
        weights=interface.weights,
    )


def _join(mesh: Mesh, key: str, joint: Joint, problems: list[BundleProblem]) -> AttachedJoint:
    """Return a joint with the nodes of its groups; by default its point is midway between them."""
    ends = [_attach(mesh, key, joint.end(group), problems) for group in joint.groups]
    if joint.point is None:
        middle = 0.5 * (ends[0].point + ends[1].point)
        ends = [replace(end, point=middle) for end in ends]
    if joint.rigid:
        nodes = np.concatenate([end.section.node_ids for end in ends])
        joint_section = section_of_nodes(mesh.points, nodes) if nodes.size else ends[0].section
        ends = [replace(ends[0], section=joint_section)]
    return AttachedJoint(tuple(ends), joint.stiffness)


def _check_bolts(
    mesh: Mesh,
    bolts: tuple[BoltCut, ...],
    occupied: list[tuple[str, np.ndarray]],
    sliding: tuple[np.ndarray, np.ndarray],
    problems: list[BundleProblem],
) -> None:
    """Note cuts whose nodes a key of `occupied` names too, or `sliding` holds along their axis."""
    for bolt in bolts:
        along = np.abs(sliding[1] @ bolt.axis).max(axis=1, initial=0.0) > _ROUNDOFF
        for key, nodes in (*occupied, ("supports.sliding", sliding[0][along])):
            shared = np.intersect1d(bolt.nodes, nodes)
            if not shared.size:
                continue
            away = "move the cut with point" if bolt.bolt.region else "name other facets as group"
            message = (
                f"{shared.size} nodes of its cut, such as the one at "
                f"{point_text(mesh.points[shared[0]])} m, also belong to {key}; {away}"
            )
            problems.append(BundleProblem(bolt.key, message))


def _weights(
    mesh: Mesh, key: str, interface: Interface, nodes: np.ndarray, problems: list[BundleProblem]
) -> np.ndarray:
    """Return equal weights, or the deck's of these nodes, shape (s,)."""
    weights = np.ones(len(nodes))
    message = ""
    if interface.coupling == "rigid":
        message = "has no effect on a rigid coupling, which takes no mean; leave weights out"
    elif interface.weights == "deck" and interface.section not in mesh.node_weights:
        message = f'the deck has no weights for "{interface.section}"; write "area" or "equal"'
    elif interface.weights == "deck":
        ids, sizes = mesh.node_weights[interface.section]
        inside = np.isin(ids, nodes)
        weights = np.zeros(len(nodes))
        weights[np.searchsorted(nodes, ids[inside])] = sizes[inside]
        if sizes[~inside].any():
            count = np.count_nonzero(sizes[~inside])
            message = (
                f"{count} weighted nodes are not defined, or in no solid cell; correct their "
                "numbers, or remove their weights"
            )
        elif not weights.sum() > 0:
            total = f"the deck weights add up to {weights.sum():g}, not above 0"
            message = f'{total}; correct them, or write "area" or "equal"'
        elif not _spans_a_plane(mesh.points[nodes[weights != 0]]):
            on_line = f"the {np.count_nonzero(weights)} nodes with weights lie on one line"
            message = f'{on_line}; weight three that do not, or write "area"'
    problems += [BundleProblem(f"{key}.weights", message)] if message else []
    return weights


def _free_sliding(
    mesh: Mesh,
    sliding: tuple[np.ndarray, np.ndarray],
    attached: AttachedInterface,
    problems: list[BundleProblem],
) -> tuple[np.ndarray, np.ndarray]:
    """Return the sliding nodes without those of a rigid coupling.

    It is a problem if locked freedoms do not hold a rigid section's sliding nodes, or if all nodes
    of a distributed section slide, so that their mean is not free.
    """
    nodes, projectors = sliding
    shared = np.isin(nodes, attached.section.node_ids)
    if not shared.any() or (
        attached.coupling == "distributed" and shared.sum() < len(attached.section.node_ids)
    ):
        return sliding
    arms = (mesh.points[nodes[shared]] - attached.point) @ attached.axes.T
    active = np.array([name not in attached.locked for name in FREEDOMS])
    motion = active * _ANY_MOTION
    moved = motion[:3] + arms @ rotation_less_identity(motion[3:]).T
    off = np.abs(projectors[shared] @ (moved @ attached.axes)[:, :, None]).max()
    slide = f"{shared.sum()} of its nodes slide by [supports]"
    if attached.coupling == "distributed":
        message = f"{slide}, which is all of them, so their mean is not free; let fewer nodes slide"
        problems.append(BundleProblem(attached.where, message))
    elif off > _ROUNDOFF * max(np.abs(arms).max(), 1.0):
        message = f"{slide}, but its free motions would move them along a held direction"
        message += "; let none of them slide"
        if attached.key.startswith("interface"):  # bushings and joints have no locked freedoms
            message += ", or lock those motions with locked"
        problems.append(BundleProblem(attached.where, message))
    return nodes[~shared], projectors[~shared]


def _check_disjoint(
    mesh: Mesh,
    fixed: np.ndarray,
    interfaces: list[AttachedInterface],
    problems: list[BundleProblem],
) -> None:
    """Note nodes of a section that are fixed, or in another section."""
    for interface in interfaces:
        nodes = interface.section.node_ids
        shared = np.intersect1d(fixed, nodes)
        if len(shared):
            at = point_text(mesh.points[shared[0]])
            message = (
                f"{len(shared)} of its {len(nodes)} nodes are fixed by [supports], such as the one "
                f"at {at} m; separate the two by cells, or narrow one with box, normal or inside "
                "in [mesh.groups.NAME]"
            )
            problems.append(BundleProblem(interface.where, message))
    for first, second in combinations(interfaces, 2):
        nodes = np.intersect1d(first.section.node_ids, second.section.node_ids)
        if nodes.size:
            message = (
                f'"{second.name or second.key}" shares {nodes.size} nodes with '
                f'"{first.name or first.key}", such as the one at '
                f"{point_text(mesh.points[nodes[0]])} m, but a node can be in one only; narrow one "
                "section"
            )
            problems.append(BundleProblem(second.where, message))


def _check_locked(
    bundle: Bundle, interfaces: list[AttachedInterface], problems: list[BundleProblem]
) -> None:
    """Note a single locked rotation if displacements are relative to the tightened state."""
    analysis = bundle.analysis
    if not (bundle.bolts and analysis.nonlinear and analysis.zero == "preloaded"):
        return
    for interface in interfaces:
        rotations = [name for name in interface.locked if name.startswith("r")]
        if len(rotations) == 1:
            message = (
                f"{rotations[0]}, a single locked rotation, leaves the motion from the tightened "
                "state undefined; lock none or two rotations, or write "
                'zero = "untightened" under [analysis]'
            )
            problems.append(BundleProblem(f"{interface.key}.locked", message))


def _spans_a_plane(points: np.ndarray) -> bool:
    """Return whether points do not all lie on one line."""
    if len(points) < 3:
        return False
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(spread[1] > _ROUNDOFF * spread[0])
