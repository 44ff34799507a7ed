"""Materials, sections, supports, couplings and loads of an Abaqus or CalculiX deck."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from wrenchbook.fea.mesh.deck_content import (
    DeckContent,
    HeldGroup,
    LoadCase,
    SolidSection,
)
from wrenchbook.fea.mesh.io.abaqus import (
    TAKERS,
    Deck,
    add,
    add_weighted,
    axes_through,
    kind_of,
    labels_of,
    may_be_solid,
    parse_mesh,
    radial_axes,
    raw_mesh,
    set_key,
    set_names,
)
from wrenchbook.fea.mesh.io.abaqus_cases import WITH_FORCES
from wrenchbook.fea.mesh.io.abaqus_keywords import (
    STRIDE,
    UNREADABLE,
    Frame,
    Keyword,
    numbers,
    real,
    whole,
)
from wrenchbook.fea.mesh.io.abaqus_supports import (
    GLOBAL,
    couplings_of,
    directions_of,
    set_of,
    supports_of,
)
from wrenchbook.fea.mesh.io.equations import following, take_constraints, take_equations
from wrenchbook.fea.mesh.io.raw import RawMesh
from wrenchbook.fea.mesh.io.reader import Coupling, Motion, Motions, Reader, Step
from wrenchbook.fea.mesh.io.springs import NODES, join_springs, take_elements
from wrenchbook.fea.spec.problems import MeshFileError, point_text
from wrenchbook.fea.spec.schema import Tie

_BOUNDARY_TYPES = {
    "ENCASTRE": {0, 1, 2, 3, 4, 5},
    "PINNED": {0, 1, 2},
    "XSYMM": {0, 4, 5},
    "YSYMM": {1, 3, 5},
    "ZSYMM": {2, 3, 4},
    "XASYMM": {1, 2, 3},
    "YASYMM": {0, 2, 4},
    "ZASYMM": {0, 1, 5},
}
"""Freedoms from 0 that each type of *BOUNDARY holds."""
_MISSING = {
    "CONNECTOR SECTION": "is not supported; write [[supports.bushing]] or [[spring]]",
    "CONTACT": "is not supported; solve the parts bonded and separate for two bounds",
    "CONTACT PAIR": "is not supported; solve the parts bonded and separate for two bounds",
    "CYCLIC SYMMETRY MODEL": "is not supported; model the whole part",
    "EMBEDDED ELEMENT": "is not supported; the elements inside are left out, so mesh them in",
    "FOUNDATION": "is not imported; write [[supports.bushing]]",
    "IMPERFECTION": "is not imported; move the nodes themselves",
    "MATRIX ASSEMBLE": "is not supported, so its stiffness is left out; mesh that part",
    "NO COMPRESSION": "is not supported; a material here is alike in tension and compression",
    "NO TENSION": "is not supported; a material here is alike in tension and compression",
    "REBAR": "is not supported, so its stiffness is left out; mesh it with solids",
    "SUBSTRUCTURE PROPERTY": "is not supported, so its stiffness is left out; mesh that part",
    "PRE-TENSION SECTION": "is not imported; write a [[bolt]]",
    "SHELL TO SOLID COUPLING": "is not supported; mesh the shell with solid cells",
    "SHELL SECTION": "is not supported; shells become groups of faces, so mesh them with solids",
    "MEMBRANE SECTION": "is not supported; membranes become groups of faces, so mesh solids",
    "BEAM SECTION": "is not supported; beams become groups of nodes, so mesh them with solids",
    "HYPERELASTIC": 'is not imported; write law = "neo-hookean" with small-strain constants',
    "KINEMATIC COUPLING": "is not imported; write [interface] with the group of this section",
    "HYPERFOAM": "is not supported; write an elastic or neo-Hookean [[material]]",
    "USER MATERIAL": "is not supported; write an elastic or neo-Hookean [[material]]",
    "VISCOELASTIC": "is not supported, since answers do not depend on time; use elastic constants",
    "CREEP": "is not supported, since answers do not depend on time; use elastic constants",
    "MODEL CHANGE": "is not supported; all elements act in each step, so remove those that do not",
    "MASS": "is not supported at an interface; put the mass into the scene",
    "DLOAD": "is not imported; write self-weight as gravity under [analysis]",
    "DSLOAD": "is not imported; apply the load as a wrench at an interface",
    "TEMPERATURE": "is not imported; write [inputs.temperature]",
}

_PARTLY = (
    "couples only some directions, but all three are coupled here; couple 1 to 3, or fix all "
    "freedoms of its point to make the group a support"
)

_ON_AXIS = (
    "has nodes on its axis, where radial is no direction: 1 and 2 are any across the axis; hold "
    "both or neither there"
)

_AT_REFERENCE = (
    "acts on rotations of a reference node whose body has a ROT NODE: here as written, but "
    "CalculiX ignores it; write freedoms 1 to 3 of the ROT NODE"
)

_NO_SOLID = (
    "has trusses or plane elements, which have no stiffness here; mesh them with solids, or write "
    "[[supports.bushing]] or [[spring]]"
)

_MEAN_HELD = (
    "holds the mean of its nodes, which may deform; here they are fixed, which is stiffer: write "
    'an [[interface]] of the group with held = true and coupling = "distributed"'
)

_QUIET = {"", "HEADING", "PREPRINT", "ASSEMBLY", "END ASSEMBLY", "PART", "END PART", "END STEP"}
_QUIET |= {"END LOAD CASE"}
"""Keywords without content, which no listing of a deck names."""
_PROPOSED = {"CLOAD", "STEP", "LOAD CASE"}
"""Keywords that only propose load range and analysis of a new component; they are not compared."""


def _take(reader: Reader, deck: Deck, keyword: Keyword) -> None:
    """Read one keyword, after the deck has read its part of the mesh."""
    taker = _TAKERS.get(keyword.word)
    if "INPUT" in keyword.options and (taker is not None or keyword.word in TAKERS):
        raise MeshFileError(
            f"has its rows in {keyword.options['INPUT']}; insert that file's lines below it"
        )
    try:
        if taker is not None:
            taker(reader, deck, keyword)
    except MeshFileError as error:
        reader.lack(keyword, f"is not imported, because it {error}")
    except (ValueError, LookupError):
        reader.lack(keyword, f"is not imported, because it {UNREADABLE}")
    if keyword.word in _MISSING:
        reader.lack(keyword, _MISSING[keyword.word])
    kind = keyword.options.get("TYPE", "").upper()
    if keyword.word == "INITIAL CONDITIONS" and kind != "TEMPERATURE":
        reader.lack(keyword, f"of {kind} is not imported; the component begins without it")
    if keyword.word not in _QUIET:
        known = keyword.word in TAKERS or (taker is not None and keyword.word not in _PROPOSED)
        lines = reader.content.taken if known else reader.content.ignored
        lines.setdefault(keyword.word, []).append(keyword.line)


def read_deck(path: Path) -> tuple[RawMesh, DeckContent]:
    """Read the mesh of a deck and its other contents.

    Raises MeshFileError as `fea.mesh.io.abaqus.parse_mesh`, if a keyword has its rows in another
    file, or if there are no elements.
    """
    reader = Reader()
    deck = parse_mesh(path, lambda deck, keyword: _take(reader, deck, keyword))
    content = reader.content
    if "ELEMENT" not in content.taken:
        if deck.nodes:
            raise MeshFileError("has *NODE, but no *ELEMENT; it may be cut off, so export it again")
        if not path.stat().st_size:
            raise MeshFileError("is empty; export it again")
        raise MeshFileError(
            "is not an Abaqus or CalculiX deck: it has no *NODE and no *ELEMENT; name another file"
        )
    content.cases = _cases(reader, deck)
    # All sets are known now: give groups their final names.
    regions, groups = set_names(deck, deck.element_sets), set_names(deck, deck.node_sets)
    faces = set_names(deck, deck.surfaces)
    content.left_out = {
        name: deck.left_out[key] for key, name in set_names(deck, deck.left_out).items()
    }
    for where, key, material, orientation in reader.sections:
        axes = reader.orientations.get(orientation, GLOBAL)
        content.sections.append(SolidSection(where, regions[key], material, axes))
        if not all(may_be_solid(deck, element) for element in deck.element_sets[key]):
            content.missing[where] = _NO_SOLID
        elif orientation and orientation not in reader.orientations:
            message = "which is not imported; write axes under [[material]]"
            content.missing[where] = f'has the orientation "{orientation}", {message}'
    for case in content.cases:
        _finish(case, content, groups, faces)
    content.ties = [
        (where, Tie(faces[secondary], faces[main], distance))
        for where, secondary, main, distance in reader.ties
    ]
    return replace(raw_mesh(deck), follow=following(reader, deck)), content


def _cases(reader: Reader, deck: Deck) -> list[LoadCase]:
    """Return a case of each step; groups of supports and loads are keys of the deck's sets."""
    # Of sets with the same nodes the first gives the name.
    reader.sets = {frozenset(labels): key for key, labels in reversed(deck.node_sets.items())}
    couplings = couplings_of(reader, deck)
    held: dict[Motions, tuple[list[HeldGroup], list[set[int]]]] = {}
    cases = []
    steps = [step for step in reader.steps if step.name] or reader.steps
    for step in reversed(steps):  # from the last: its groups get the names without a suffix
        if step.motions not in held:
            held[step.motions] = supports_of(reader, deck, step.motions, len(couplings))
        supports, freedoms_of_couplings = held[step.motions]
        coupled = [
            replace(coupling, held=set(freedoms), loads=[0.0] * 6)
            for coupling, freedoms in zip(couplings, freedoms_of_couplings, strict=True)
        ]
        case = LoadCase(step.name, supports, coupled, nonlinear=step.nonlinear)
        _take_loads(reader, deck, step, case)
        join_springs(reader, deck, step, case)
        cases.append(case)
    return cases[::-1]


def _take_loads(reader: Reader, deck: Deck, step: Step, case: LoadCase) -> None:
    """Add a step's forces to its couplings, or to the groups with forces."""
    single = {label for (label, _), (key, _) in step.forces.items() if not key}
    single -= reader.points.keys()
    single_key = set_of(reader, deck, sorted(single), WITH_FORCES) if single else ""
    for (label, freedom), (key, value) in step.forces.items():
        number, first = reader.points.get(label, (None, 0))
        if number is None:
            loads = case.loads.setdefault(key or single_key, [0.0] * 6)
        else:
            loads = case.couplings[number].loads
        # A force is a moment (half 1) on a coupling's node of rotations, whose first freedom is 3.
        half, axis = divmod((freedom + first) % 6, 3)
        direction = reader.turned.get(label, np.eye(3).ravel())[3 * axis : 3 * axis + 3]
        for i, part in enumerate(direction):
            loads[3 * half + i] += part * value


def _finish(
    case: LoadCase, content: DeckContent, groups: dict[str, str], faces: dict[str, str]
) -> None:
    """Give groups their final names, and make supports of couplings whose points are held.

    The remaining couplings move freely: they are not fixed, and no spring holds them.
    """
    case.supports = [replace(support, group=groups[support.group]) for support in case.supports]
    case.loads = {groups[key]: loads for key, loads in case.loads.items()}
    on_springs = {id(end) for spring in case.springs for end in spring.ends}
    couplings = case.couplings
    case.couplings = []
    for coupled in couplings:
        coupled.group = faces.get(coupled.group) or groups[coupled.group]
        is_fixed = len(coupled.held) == 6
        if is_fixed and coupled.kind == "distributed":
            content.missing[coupled.where] = _MEAN_HELD
        if is_fixed and coupled.directions:
            held = HeldGroup(coupled.where, coupled.group, coupled.directions)
            case.supports.append(held)
        elif coupled.directions != "xyz":
            content.missing[coupled.where] = _PARTLY
        if not is_fixed and id(coupled) not in on_springs:
            case.couplings.append(coupled)


def _take_surface(reader: Reader, deck: Deck, keyword: Keyword) -> None:
    """Note a surface that is left out."""
    key = keyword.frame.key(keyword.option("NAME"))
    if key in deck.left_out:
        reader.lack(keyword, deck.left_out[key])
        deck.left_out[key] = f"{keyword.where} {deck.left_out[key]}"


def _take_elements(reader: Reader, deck: Deck, keyword: Keyword) -> None:
    """Add the elements of *ELEMENT, and count those of the mesh by their type."""
    kind = keyword.option("TYPE").upper()
    if kind == "DCOUP3D":  # its node as a set, by which *DISTRIBUTING COUPLING names it
        if len(keyword.rows) != 1 or len(keyword.rows[0]) < 2:
            raise MeshFileError("of type DCOUP3D needs exactly one row: its number and its node")
        add_weighted(deck, keyword.frame, keyword.option("ELSET"), keyword.rows[0][1])
    elif kind in NODES:
        take_elements(reader, deck, keyword)
    elif kind_of(kind) is None:
        reader.lack(keyword, f"has the unsupported type {kind}; use solids, or leave it out")
        if "ELSET" in keyword.options:
            labels = [keyword.frame.label(row[0]) for row in keyword.rows]
            add(deck, deck.element_sets, keyword.frame, keyword.options["ELSET"], labels)
    elif keyword.at in deck.element_lines[-1:]:
        counts = reader.content.elements
        counts[kind] = counts.get(kind, 0) + len(deck.cells[-1])


def _take_material(reader: Reader, _: Deck, keyword: Keyword) -> None:
    reader.material = keyword.option("NAME").upper()
    if reader.material in reader.content.materials:
        reader.lack(keyword, "is defined again, and its constants replace others; rename one")


def _take_constants(reader: Reader, _: Deck, keyword: Keyword) -> None:
    """Add the constants of *ELASTIC, *PLASTIC and others to the material that is being read."""
    kind = keyword.options.get("TYPE", "ISO").upper().replace(" ", "")
    if keyword.word == "ELASTIC" and kind in ("ENGINEERINGCONSTANTS", "ORTHO"):
        values = [real(each) for row in keyword.rows for each in row if each][:9]
        if len(values) < 9:
            raise MeshFileError(f"has {len(values)} of nine constants; write all nine")
        if kind == "ORTHO":  # stresses over strains, from which engineering constants follow
            c11, c12, c22, c13, c23, c33, *shears = values
            try:
                compliance = np.linalg.inv([[c11, c12, c13], [c12, c22, c23], [c13, c23, c33]])
            except np.linalg.LinAlgError:
                raise MeshFileError("has a singular stiffness; correct D1111 to D3333") from None
            moduli = 1 / np.diag(compliance)
            nu_12_13_23 = -(compliance * moduli[:, None])[[0, 0, 1], [1, 2, 2]]
            values = [*moduli.tolist(), *nu_12_13_23.tolist(), *shears]
        reader.constants["youngs_modulus"] = tuple(values[:3])
        reader.constants["poisson_ratio"] = tuple(values[3:6])
        reader.constants["shear_modulus"] = tuple(values[6:])
        return
    if kind not in ("ISO", "ISOTROPIC"):
        reader.lack(keyword, f"has the type {kind}, not imported; write it in [[material]]")
        return
    pairs = zip(_CONSTANTS[keyword.word], keyword.rows[0], strict=False)
    reader.constants.update({key: real(value) for key, value in pairs})
    if keyword.word == "PLASTIC":
        reader.lack(keyword, "is not solved; its first stress becomes a yield_strength")
    elif len(keyword.rows) > 1:
        reader.lack(keyword, "has values at several temperatures; check the first, taken here")


def _take_section(reader: Reader, deck: Deck, keyword: Keyword) -> None:
    key = set_key(deck, deck.element_sets, keyword.option("ELSET"), keyword.frame)
    orientation = keyword.options.get("ORIENTATION", "")
    orientation = keyword.frame.key(orientation) if orientation else ""
    material = keyword.option("MATERIAL").upper()
    reader.sections.append((keyword.where, key, material, orientation))


def _take_orientation(reader: Reader, _: Deck, keyword: Keyword) -> None:
    """Read axes through points, by an angle about one of them, or about the axis of a cylinder."""
    system = keyword.options.get("SYSTEM", "RECTANGULAR").upper()
    kind = keyword.options.get("DEFINITION", "COORDINATES").upper()
    first, second, origin = numbers(keyword, 0, 9).reshape(3, 3)
    number, angle = numbers(keyword, 1, 2)
    if kind != "COORDINATES" or system not in ("RECTANGULAR", "CYLINDRICAL"):
        raise MeshFileError(
            f"has SYSTEM={system} and DEFINITION={kind}; write RECTANGULAR or CYLINDRICAL as "
            "SYSTEM, and COORDINATES as DEFINITION"
        )
    if system == "CYLINDRICAL":
        if angle:
            raise MeshFileError(f"turns a cylinder by {angle:g} degrees; write 0 as angle")
        if np.array_equal(first, second):
            at = point_text(first)
            raise MeshFileError(f"has both points of its axis at {at}; write two different points")
        points = [keyword.frame.transformed(point.tolist()) for point in (first, second)]
        axis = np.subtract(points[1], points[0])
        axes = np.array([*points[0], *(axis / np.linalg.norm(axis))])
    else:
        axes = axes_through(origin, first, second)
        if angle:  # rotates the two axes after the axis of the angle, from 1
            i = int(number) % 3
            j = (int(number) + 1) % 3
            cos, sin = math.cos(math.radians(angle)), math.sin(math.radians(angle))
            axes[[i, j]] = cos * axes[i] + sin * axes[j], cos * axes[j] - sin * axes[i]
        if keyword.frame.rotation:
            axes = axes @ np.array(keyword.frame.rotation).reshape(3, 3).T
    name = keyword.frame.key(keyword.options["NAME"])
    reader.orientations[name] = tuple(axes.ravel().tolist())


def _take_transform(reader: Reader, deck: Deck, keyword: Keyword) -> None:
    """Read the axes of nodes; about a cylinder's axis each node has its own."""
    if (kind := keyword.options.get("TYPE", "R").upper()) not in ("R", "C"):
        raise MeshFileError(f"has TYPE={kind}; write R (rectangular) or C (cylindrical)")
    frame, (first, second) = keyword.frame, numbers(keyword, 0, 6).reshape(2, 3)
    rotation = np.reshape(frame.rotation or np.eye(3), (3, 3))
    labels = labels_of(deck, deck.node_sets, keyword.option("NSET"), frame)
    if kind == "R":
        axes = [axes_through(np.zeros(3), first, second) @ rotation.T] * len(labels)
    else:
        start = np.array(frame.transformed(first.tolist()))
        axial = rotation @ (second - first)
        axes = []
        for label in labels:
            if label not in deck.nodes:
                raise MeshFileError(
                    f'turns the node {label % STRIDE} of "{keyword.options["NSET"]}", which no '
                    "*NODE above defines; correct the set, or move *NODE up"
                )
            try:
                axes.append(radial_axes(axial, deck.nodes[label] - start))
            except MeshFileError:  # on the axis any direction across it is right, as in CalculiX
                axes.append(radial_axes(axial, np.eye(3)[np.abs(axial).argmin()]))
                reader.lack(keyword, _ON_AXIS)
    for label, matrix in zip(labels, axes, strict=True):
        reader.turned[label] = tuple(matrix.ravel().tolist())


def _take_boundary(reader: Reader, deck: Deck, keyword: Keyword) -> None:
    """Add the freedoms that *BOUNDARY holds, and report prescribed motions, which are left out."""
    step = reader.steps[-1]
    step.begin(keyword)
    if {"SUBMODEL", "USER"} & keyword.options.keys():
        reader.lack(keyword, "moves nodes by results or code, here not at all; check them")
    for target, *fields in keyword.rows:
        word = fields[0].upper() if fields else ""
        if word in _BOUNDARY_TYPES:
            held = set(_BOUNDARY_TYPES[word])
        else:
            first, last, value = (*fields, "", "", "")[:3]  # a missing field is empty
            ends = [int(text) if text.isdigit() else 0 for text in (first, last or first)]
            if not 0 < ends[0] <= ends[1]:
                written = ", ".join(filter(None, (first, last)))
                types = ", ".join(_BOUNDARY_TYPES)
                raise MeshFileError(
                    f'has "{written}" as freedom of {target}; write 1 to 6, or {types}'
                )
            held = set(range(ends[0] - 1, min(ends[1], 6)))
            if ends[1] > 6:
                reader.lack(
                    keyword,
                    f"has the freedom {ends[1]}, which is no motion and is left out; remove it",
                )
            if held and real(value or "0"):
                message = "has a prescribed displacement other than 0, which is taken as 0"
                reader.lack(keyword, f"{message}; apply its load at an interface instead")
        key, labels = _target(deck, target, keyword.frame)
        _check_rotations(reader, keyword, labels, max(held, default=0))
        step.motions.rows.append(Motion(keyword.where, key, labels, held))


def _check_rotations(reader: Reader, keyword: Keyword, labels: list[int], freedom: int) -> None:
    """Note a rotation, a freedom from 3, of a reference node whose rotations are another node's."""
    references = {coupled.ref for coupled in reader.couplings if coupled.rot is not None}
    if freedom > 2 and not references.isdisjoint(labels):
        reader.lack(keyword, _AT_REFERENCE)


def _target(deck: Deck, name: str, frame: Frame) -> tuple[str, list[int]]:
    """Return the key of a node set, empty for a single node, and the nodes."""
    labels = labels_of(deck, deck.node_sets, name, frame)
    single = name.rpartition(".")[2].isdigit()
    if single and labels[0] not in deck.nodes:
        raise MeshFileError(f"names node {name}, which is not defined above; add its *NODE there")
    return "" if single else set_key(deck, deck.node_sets, name, frame), labels


def _take_coupling(reader: Reader, deck: Deck, keyword: Keyword) -> None:
    name = keyword.option("SURFACE")
    sets = deck.surfaces if keyword.frame.key(name) in deck.surfaces else deck.node_sets
    key = set_key(deck, sets, name, keyword.frame)
    option = keyword.options.get("INFLUENCE RADIUS")
    radius = real(option) if option else math.inf
    ref = _node(deck, keyword, "REF NODE")
    reader.couplings.append(Coupling(keyword, key, ref, radius=radius))


def _take_coupling_kind(reader: Reader, _: Deck, keyword: Keyword) -> None:
    """Set the kind and the directions of the last *COUPLING from *KINEMATIC or *DISTRIBUTING."""
    rows = [[whole(each) for each in row if each] for row in keyword.rows]
    freedoms = {freedom - 1 for row in rows for freedom in range(row[0], row[-1] + 1)}
    directions = directions_of(freedoms)
    if rows and keyword.word == "KINEMATIC":
        reader.couplings[-1].directions = directions
    elif rows and directions != "xyz":
        reader.lack(keyword, "couples some directions only, but here all three; check it")
    elif rows and not {3, 4, 5} <= freedoms:
        reader.lack(keyword, "couples no rotation, but here the mean rotation; check it")
    if (method := keyword.options.get("WEIGHTING METHOD", "UNIFORM").upper()) != "UNIFORM":
        reader.lack(keyword, f"has the weights {method}, but here distance has no effect")
    reader.couplings[-1].kind = "rigid" if keyword.word == "KINEMATIC" else "distributed"


def _take_weighted(reader: Reader, deck: Deck, keyword: Keyword) -> None:
    """Read the mean of weighted nodes that the point of a DCOUP3D follows."""
    name = f"{keyword.option('ELSET')}_nodes"
    for target, *weights in keyword.rows:
        if len(weights) != 1:
            raise MeshFileError(f"has no weight for {target}; write a node or set, and its weight")
        add_weighted(deck, keyword.frame, name, target, *weights)
    ref = _node(deck, keyword, "ELSET")
    reader.couplings.append(Coupling(keyword, keyword.frame.key(name), ref, kind="distributed"))


def _take_rigid(reader: Reader, deck: Deck, keyword: Keyword) -> None:
    """Add the coupling of a *RIGID BODY of nodes, and report one of elements."""
    sets = ("NSET", "TIE NSET", "PIN NSET", "ELSET")
    name, *others = [keyword.options[k] for k in sets if k in keyword.options] or [""]
    if others:
        reader.lack(
            keyword, f"has several sets, of which only {name} is imported; unite them in one"
        )
    elif "ELSET" in keyword.options or not name:
        reader.lack(keyword, "of elements is not imported; name its nodes as a rigid [interface]")
        return
    key = set_key(deck, deck.node_sets, name, keyword.frame)
    ref, rot = (_node(deck, keyword, option) for option in ("REF NODE", "ROT NODE"))
    reader.couplings.append(Coupling(keyword, key, ref, rot))


def _node(deck: Deck, keyword: Keyword, option: str) -> int | None:
    if option not in keyword.options:
        return None
    return labels_of(deck, deck.node_sets, keyword.options[option], keyword.frame)[0]


def _take_tie(reader: Reader, deck: Deck, keyword: Keyword) -> None:
    """Read a tie of surfaces of faces."""
    if "CYCLIC SYMMETRY" in keyword.options:
        raise MeshFileError("has CYCLIC SYMMETRY, which is not supported; model the whole part")
    distance = real(keyword.options.get("POSITION TOLERANCE", "0")) or None
    for row in keyword.rows:
        if len(row) < 2:
            raise MeshFileError(f'names only "{row[0]}"; write secondary and main surface')
        keys = {keyword.frame.key(name) for name in row[:2]}
        if nodal := (keys & deck.node_sets.keys()) - deck.surfaces.keys():
            raise MeshFileError(f'names "{min(nodal)}", a set of nodes; name a surface of faces')
        first, second = (set_key(deck, deck.surfaces, name, keyword.frame) for name in row[:2])
        reader.ties.append((keyword.where, first, second, distance))


def _take_force(reader: Reader, deck: Deck, keyword: Keyword) -> None:
    """Add the forces and moments of *CLOAD to the present step."""
    step = reader.steps[-1]
    step.begin(keyword)
    if "AMPLITUDE" in keyword.options:
        reader.lack(keyword, "has an amplitude, which is left out; check the values")
    for row in keyword.rows:
        if len(row) < 3:
            raise MeshFileError(f'has the row "{", ".join(row)}"; write node/set, freedom, value')
        target, freedom, value = row[:3]
        key, labels = _target(deck, target, keyword.frame)
        if not 1 <= whole(freedom) <= 6:
            raise MeshFileError(f"acts on freedom {freedom} of {target}; write 1 to 6")
        _check_rotations(reader, keyword, labels, whole(freedom) - 1)
        for label in labels:
            entry = label, whole(freedom) - 1
            # The forces of one step add up.
            before = step.forces[entry][1] if entry in step.begun else 0.0
            step.forces[entry] = key, before + real(value)
            step.begun.add(entry)


def _take_step(reader: Reader, _: Deck, keyword: Keyword) -> None:
    """Begin a step at the end of the last general step, or a load case at the state of its step."""
    # The kind of this step, and the kinds at whose end it begins.
    kind = "general"
    bases = {"general"}
    if keyword.word == "LOAD CASE":
        kind = "load case"
        bases = {"general", "perturbation"}
    elif "PERTURBATION" in keyword.options:
        kind = "perturbation"
    base = next(step for step in reversed(reader.steps) if step.kind in bases)
    last = reader.steps[-1]
    if kind == "general" and last.kind == "perturbation" and "BOUNDARY" in last.begun:
        reader.lack(
            keyword,
            "lacks the supports of the perturbation before; check them (CalculiX keeps them)",
        )

    if kind == "load case":
        base.name = ""
    name = keyword.options.get("NAME") or f"step {len(reader.steps)}"
    if any(step.name.upper() == name.upper() for step in reader.steps):
        name = f"{name} ({len(reader.steps)})"
    step = replace(base, name=name, kind=kind, begun=set())
    if kind == "perturbation":
        step.forces = {}
    step.nonlinear |= keyword.options.get("NLGEOM", "NO").upper() != "NO"
    reader.steps.append(step)


_CONSTANTS = {
    "ELASTIC": ("youngs_modulus", "poisson_ratio"),
    "DENSITY": ("density",),
    "EXPANSION": ("thermal_expansion",),
    "PLASTIC": ("yield_strength",),
}

_TAKERS: dict[str, Callable[[Reader, Deck, Keyword], None]] = {
    "ELEMENT": _take_elements,
    "MATERIAL": _take_material,
    **dict.fromkeys(_CONSTANTS, _take_constants),
    "SOLID SECTION": _take_section,
    "ORIENTATION": _take_orientation,
    "TRANSFORM": _take_transform,
    "BOUNDARY": _take_boundary,
    "COUPLING": _take_coupling,
    "KINEMATIC": _take_coupling_kind,
    "DISTRIBUTING": _take_coupling_kind,
    "DISTRIBUTING COUPLING": _take_weighted,
    "RIGID BODY": _take_rigid,
    "SURFACE": _take_surface,
    "SPRING": lambda reader, _, keyword: reader.spring_sections.append(keyword),
    "TIE": _take_tie,
    "EQUATION": take_equations,
    "MPC": take_constraints,
    "CLOAD": _take_force,
    **dict.fromkeys(("STEP", "LOAD CASE"), _take_step),
}
