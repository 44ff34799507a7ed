"""Conversion of a Nastran bulk data file (.bdf, .dat, .nas) to an Abaqus deck.

meshio reads such meshes too, but leaves out large-field elements and coordinate systems without a
message, and knows no materials, constraints and rigid elements.
"""

from __future__ import annotations

import itertools
import re
from collections import defaultdict
from collections.abc import Callable, Iterator

import numpy as np

from wrenchbook.fea.mesh.io.abaqus_keywords import whole
from wrenchbook.fea.mesh.io.nastran_cards import (
    BASIC,
    CD,
    SYSTEMS,
    Bulk,
    Entry,
    axes_text,
    node_numbers,
    read_cards,
    real,
)
from wrenchbook.fea.mesh.io.springs import ALONG
from wrenchbook.fea.mesh.io.translated import Case, Translated
from wrenchbook.fea.spec.deck_text import DeckText
from wrenchbook.fea.spec.problems import MeshFileError

_SOLIDS = {
    "CHEXA": {8: "C3D8", 20: "C3D20R"},
    "CPENTA": {6: "C3D6", 15: "C3D15"},
    "CTETRA": {4: "C3D4", 10: "C3D10"},
    "CPYRAM": {5: "C3D5", 13: "C3D13"},
}
# Nastran has the midside nodes of upright edges before those of the upper face.
_ORDER = {
    "C3D20R": [*range(12), *range(16, 20), *range(12, 16)],
    "C3D15": [*range(9), *range(12, 15), *range(9, 12)],
}
_QUIET = {"PARAM", "END BULK", "MPCADD", "GRDSET"}  # cards without content, which no message lists
_MASS_FACTOR = re.compile(r"^\s*PARAM[\s,*]+WTMASS[\s,]+([\w.+-]+)", re.I | re.M)
_FIRST_SPRING = 10**9  # number of the first element of springs: Nastran's own end at 1e8
_NONLINEAR = re.compile(r"^\s*SOL\s+(106|NLSTATIC|400|60[01])\b", re.I | re.M)
_CASE = re.compile(r"(SUBCASE|SUBC|SYM|SUBCOM|SYMCOM|REPCASE)\b\s*=?\s*(\d+)", re.I)
_SELECTION = re.compile(r"(SPC|LOAD)\b\s*(?:\([^)]*\))?\s*=?\s*(\w+)", re.I)
_AGAIN = "is defined again; renumber one of the two"
_MAT9_FIELDS = 29  # number, 21 constants, density, six expansions


def read_nastran(text: DeckText) -> Translated:
    """Return the content of a bulk data file: regions PSOLID_1, groups RBE2_7, a case a subcase.

    Raises MeshFileError if a card cannot be read, or nodes are in a local coordinate system.
    """
    parts = re.split(r"^\s*BEGIN[ \t,]+BULK.*$", text, maxsplit=1, flags=re.I | re.M)
    control = parts[0] if len(parts) > 1 else ""
    bulk = parts[-1]
    data = Bulk(nonlinear=_NONLINEAR.search(control) is not None)
    factor = _MASS_FACTOR.search(text)
    if factor is not None:
        data.mass_factor = real(factor[1])

    lines_before = text.count("\n") - bulk.count("\n")
    cards = list(read_cards(bulk.splitlines(), text, lines_before))
    for card in cards:
        card.fields.extend([""] * (-len(card.fields) % 8))  # large-field lines have four
        if card.name == "GRDSET":
            data.defaults = card.fields
    for card in cards:  # nodes may come after cards that refer to them
        data.index(card.name, card.fields)
    for number, name, fields in cards:
        read = _READERS.get(name)
        try:
            if read is not None:
                read(data, name, fields)
            elif name not in _QUIET:
                data.skipped[name] += 1
        except MeshFileError as error:
            raise MeshFileError(f"line {text.place(number)}: {name} {error}") from None
        except (ValueError, LookupError):
            why = "lacks a field, or has a number too large; complete the card"
            raise MeshFileError(f"line {text.place(number)}: {name} {why}") from None
    _add_springs(data)
    _add_cases(data, control)
    return data


def _add_cases(data: Bulk, control: str) -> None:
    """Make a case of each subcase from its selected sets."""
    used: set[tuple[str, str]] = set()
    turned = _turn(data)
    held: dict[str, list[str]] = {}
    for name, selected in _selections(data, control).items():
        number = selected.get("SPC", "")
        if number not in held:
            held[number] = []
            supports = (*_entries(data, "GRID", "", used), *_entries(data, "SPC", number, used))
            for node, freedom, value in supports:
                held[number].append(f"{node}, {freedom}")
                data.skipped["SPC with a motion that is not 0"] += value != 0.0
        loads = _along_axes(_entries(data, "LOAD", selected.get("LOAD", ""), used), turned)
        data.cases.append(Case(name, held[number], list(loads)))
    for (kind, number), unused in data.sets.items():
        if (kind, number) not in used:
            data.skipped[f"{kind} set {number}, which no case selects"] += len(unused)


def _entries(data: Bulk, kind: str, number: str, used: set[tuple[str, str]]) -> Iterator[Entry]:
    """Yield the entries of a set, or of the sum of sets with its number; add the sets to `used`."""
    for factor, part in data.sums.get((kind, number), [(1.0, number)]):
        used.add((kind, part))
        if part and (kind, part) not in data.sets:
            data.skipped[f"{kind} set {part}, which has no supported card"] = 1
        for node, freedom, value in data.sets.get((kind, part), ()):
            yield Entry(node, freedom, factor * value)


def _along_axes(loads: Iterator[Entry], turned: dict[str, np.ndarray]) -> Iterator[str]:
    """Yield rows of *CLOAD along the axes of each node for loads along the basic axes."""
    for node, freedom, value in loads:
        first = 1 if freedom in "123" else 4
        cosines = turned.get(node, np.eye(3))[:, int(freedom) - first]
        for i, cosine in enumerate(cosines.tolist()):
            if cosine * value:
                yield f"{node}, {first + i}, {cosine * value:.9g}"


def _turn(data: Bulk) -> dict[str, np.ndarray]:
    """Give nodes that are held in a system of their own (CD) its axes there; return them."""
    held = defaultdict[str, set[str]](set)  # freedoms of each node
    for (kind, _), entries in data.sets.items():
        if kind != "LOAD":
            for entry in entries:
                held[entry.node].add(entry.freedom)
    turned: dict[str, np.ndarray] = {}
    for node, freedoms in held.items():
        number = data.grids[node][CD] if node in data.grids else ""
        if number not in (*BASIC, "-1"):
            kind, axes, _ = data.system(number)
            # If both the radial and the circumferential freedom are held, or neither, the system's
            # own axes give the same.
            alike = kind == "C" and ("1" in freedoms) == ("2" in freedoms)
            turned[node] = axes if alike else data.axes_at(number, node)
            data.transforms[axes_text(turned[node])].append(node)
    return turned


def _selections(data: Bulk, control: str) -> dict[str, dict[str, str]]:
    """Return by subcase the number of its set of each kind; without any, each set is a case."""
    common: dict[str, str] = {}
    current = common
    cases: dict[str, dict[str, str]] = {}
    for line in control.splitlines():
        line = line.partition("$")[0].strip()
        case, selection = _CASE.match(line), _SELECTION.match(line)
        if case is not None:
            current = dict(common)
            if case[1].upper() in ("SUBCASE", "SUBC", "SYM"):
                cases[f"SUBCASE {case[2]}"] = current
            else:
                data.skipped[f"{case[1]}, a combination of subcases"] += 1
        elif selection is not None:
            current[selection[1].upper()] = selection[2] if selection[2].isdigit() else ""

    cases = cases or {"": common}
    for kind in ("SPC", "LOAD"):
        parts = {part for key in data.sums if key[0] == kind for _, part in data.sums[key]}
        numbers = [number for of, number in (*data.sums, *data.sets) if of == kind]
        alone = [number for number in numbers if number not in parts]
        if alone and not any(case.get(kind) for case in cases.values()):
            names = ", ".join(f"{kind} {number}" for number in alone)
            data.decide.append(f"the case control selects no {kind}; taken as cases: {names}")
            cases = {
                f"{name} {kind} {number}".strip(): selected | {kind: number}
                for name, selected in cases.items()
                for number in alone
            }
    return cases


def _check_system(data: Bulk, _: str, fields: list[str]) -> None:
    """Refuse a coordinate system whose number an earlier card has: `Bulk.index` stored that."""
    if data.cards[fields[0]][1] is not fields:
        raise MeshFileError(f"{fields[0]} {_AGAIN}")


def _read_grid(data: Bulk, _: str, fields: list[str]) -> None:
    """Read a node: its position, and its supports."""
    coordinates = ", ".join(f"{x:.12g}" for x in data.point(fields).tolist())
    whole(fields[0])  # raises if it is no number
    data.nodes.append(f"{fields[0]}, {coordinates}")
    _hold(data, ("GRID", ""), fields[0], fields[6])


def _hold(data: Bulk, key: tuple[str, str], node: str, freedoms: str, value: str = "") -> None:
    """Add the freedoms of a node, such as "123", to a set; a row may have no node."""
    if not {*freedoms} <= {*"0123456"}:
        raise MeshFileError(f'has "{freedoms}" as freedoms; write digits from 1 to 6')
    held = sorted(set(freedoms) & set("123456")) if node else ()
    data.sets[key] += [Entry(node, freedom, real(value)) for freedom in held]


def _read_cell(data: Bulk, name: str, fields: list[str]) -> None:
    """Read a cell; a missing midside node is "0"."""
    n_corners, n_all = _SOLIDS[name]
    count = max((i for i, text in enumerate(fields[2:], 1) if text), default=0)
    if count > n_corners:
        count = max(count, n_all)
    padded = [*fields[2:], *[""] * n_all]
    nodes = [node or "0" for node in padded[:count]]
    present = sum(node != "0" for node in nodes[:n_corners])
    if present < n_corners:
        raise MeshFileError(
            f"{fields[0]} has {present} of its {n_corners} corners; write all of them"
        )
    kind = _SOLIDS[name].get(len(nodes))
    if kind is None:
        raise MeshFileError(f"{fields[0]} has {len(nodes)} nodes; write at most {n_all}")
    nodes = [nodes[i] for i in _ORDER.get(kind, range(len(nodes)))]
    data.elements[kind, f"PSOLID_{fields[1] or fields[0]}"].append([fields[0], *nodes])


def _read_mat1(data: Bulk, name: str, fields: list[str]) -> None:
    """Read an isotropic material; the third of E, G and nu follows from the other two."""
    young, shear, ratio = real(fields[1]), real(fields[2]), real(fields[3])
    if not fields[1]:
        young = 2 * shear * (1 + ratio)
    elif not fields[3] and shear:
        ratio = young / (2 * shear) - 1
    constants = _constants_of(data, fields[0])
    constants["ELASTIC"] = f"{young:.9g}, {ratio:.9g}"
    further = {"DENSITY": real(fields[4]) * data.mass_factor, "EXPANSION": real(fields[5])}
    constants |= {word: f"{value:.9g}" for word, value in further.items() if value}


def _read_mat9(data: Bulk, name: str, fields: list[str]) -> None:
    """Read a material of nine constants; its shears are xy, yz, zx."""
    padded = [*fields, *[""] * _MAT9_FIELDS]
    values = [real(text) for text in padded[:_MAT9_FIELDS]]
    constants, density, expansion = values[1:22], values[22], values[23:]
    stiffness = np.zeros((6, 6))
    stiffness[np.triu_indices(6)] = constants
    if np.triu(stiffness, 1)[:, 3:].any():
        data.skipped[f"{name} {fields[0]} that is not orthotropic, with constants beyond nine"] += 1
        return
    # Abaqus has 11, 12, 22, 13, 23, 33, then the shears 12, 13, 23.
    in_order = [*stiffness.T[:3, :3][np.tril_indices(3)], *np.diag(stiffness)[[3, 5, 4]]]
    material = _constants_of(data, fields[0])
    material["ELASTIC, TYPE=ORTHO"] = ", ".join(f"{constant:.12g}" for constant in in_order)
    if density:
        material["DENSITY"] = f"{density * data.mass_factor:.9g}"
    data.skipped[f"expansion of {name}"] += any(expansion)


def _constants_of(data: Bulk, number: str) -> dict[str, str]:
    """Return the constants of a new material; raise MeshFileError if its number is used."""
    if f"MAT_{number}" in data.constants:
        raise MeshFileError(f"{number} {_AGAIN}")
    return data.constants[f"MAT_{number}"]


def _read_psolid(data: Bulk, name: str, fields: list[str]) -> None:
    """Read the material of a region, and the axes of the material."""
    region = f"{name}_{fields[0]}"
    if region in data.sections:
        raise MeshFileError(f"{fields[0]} {_AGAIN}")
    data.sections[region] = f"MAT_{fields[1]}"
    # The system -1 has the axes of each element.
    system = None if fields[2] == "-1" else data.system(fields[2])
    if system is not None and system.kind == "R":
        data.sections[region] += data.add_orientation(region, system.axes)
    elif system is not None and system.kind == "C":
        axis = np.array([system.origin, system.origin + system.axes[2]])
        data.sections[region] += data.add_orientation(region, axis, system.kind)
    else:
        data.skipped["CORDM of PSOLID of an element or a sphere, which counts for MAT9"] += 1


def _read_spc(data: Bulk, name: str, fields: list[str]) -> None:
    """Read SPC, two nodes with their freedoms and motions, or SPC1, a list of nodes."""
    rows = [fields[1:4], fields[4:7]]
    if name == "SPC1":
        rows = [[node, fields[1], ""] for node in node_numbers(fields[2:], data.grids)]
    for row in rows:
        _hold(data, ("SPC", fields[0]), *row)


def _read_sum(data: Bulk, name: str, fields: list[str]) -> None:
    """Read SPCADD, and LOAD with a common factor and a factor of each set."""
    if name == "SPCADD":
        parts = [(1.0, part) for part in fields[1:] if part]
    else:
        pairs = zip(fields[2::2], fields[3::2], strict=False)
        parts = [(real(fields[1]) * real(factor), part) for factor, part in pairs if part]
    data.sums[name.removesuffix("ADD"), fields[0]] = parts


def _read_rbe2(data: Bulk, name: str, fields: list[str]) -> None:
    """Read a rigid element as a kinematic coupling, without its thermal expansion."""
    nodes = node_numbers([text for text in fields[3:] if "." not in text], data.grids)
    freedoms = sorted(set("123") & set(fields[2]))
    turned = {data.grids[node][CD] for node in nodes if node in data.grids}
    if not freedoms or (len(freedoms) < 3 and not turned <= {*BASIC}):
        data.skipped[f"{name} of some freedoms only"] += 1
        return
    data.tie(f"{name}_{fields[0]}", nodes, fields[1], "KINEMATIC")
    if len(freedoms) < 3:
        data.couplings += freedoms


def _read_rbe3(data: Bulk, name: str, fields: list[str]) -> None:
    """Read a mean element as a distributed coupling; with UM, which changes it, it is skipped."""
    capitals = [text.upper() for text in fields]
    if "ALPHA" in capitals:
        data.skipped[f"expansion of {name}"] += 1
        fields = fields[: capitals.index("ALPHA")]
    starts = [i for i, text in enumerate(fields) if i > 3 and "." in text]
    is_partial = not all(set("123") <= set(fields[i + 1]) for i in starts)
    if "UM" in capitals or is_partial or not starts:
        why = "of some freedoms only" if is_partial else "with UM, or without real weights"
        data.skipped[f"{name} {why}"] += 1
        return
    if not set("123456") <= set(fields[3]):
        data.skipped[f"{name} of whose point {fields[3]} alone follow: here all freedoms do"] += 1
    weights = defaultdict[str, float](float)
    for i, end in zip(starts, [*starts[1:], len(fields)], strict=True):
        for node in node_numbers(fields[i + 2 : end], data.grids):
            weights[node] += real(fields[i])
    data.tie(f"{name}_{fields[0]}", [*weights], fields[2], "DISTRIBUTING", weights.values())


def _read_spring(data: Bulk, name: str, fields: list[str]) -> None:
    """Store a spring, or a property: the stiffness of one direction or of six."""
    if name == "PELAS":  # two properties a card, of four fields each
        springs = {f"{name}{fields[i]}": (name, [fields[i + 1]]) for i in (0, 4) if fields[i]}
    elif name == "PBUSH":  # stiffnesses follow the word K at the start of a line of eight fields
        rows = [i + 1 for i in range(1, len(fields), 8) if fields[i].upper() == "K"]
        sizes = fields[rows[0] : rows[0] + 6] if rows else []
        springs = {name + fields[0]: (name, [size or "0" for size in sizes])}
    else:
        springs = {fields[0]: (name, [*fields, *[""] * 8])}
    repeated = data.springs.keys() & springs
    if repeated:
        number = min(repeated).removeprefix(name)
        raise MeshFileError(f"{number} {_AGAIN}")
    data.springs |= springs


def _add_springs(data: Bulk) -> None:
    """Convert each freedom of a spring to an element; the reader of the deck checks them."""
    elements = itertools.count(_FIRST_SPRING)
    refused = defaultdict[tuple[str, str], list[str]](list)  # element numbers by card and reason
    for number, (name, fields) in data.springs.items():
        if name in ("PELAS", "PBUSH"):
            continue
        is_bush = name == "CBUSH"
        try:
            ends = [(fields[2], fields[3]), (fields[4], fields[5])]
            if is_bush:
                ends = [(fields[2], "1"), (fields[3], "1")]
            # A grounded end has no node, or 0.
            ends = [(node, whole(first or "0")) for node, first in ends if node.strip("0")]
            nodes = [node for node, _ in ends]
            sizes = data.stiffnesses(name, number)
            if not nodes or not any(sizes):
                raise MeshFileError("has a stiffness of 0" if nodes else "has no end on a node")
            axes = _bush_axes(data, fields, nodes, sizes) if is_bush else _end_axes(data, nodes)
        except MeshFileError as error:
            refused[name, str(error)].append(number)
            continue
        option = data.add_orientation(f"{name}_{number}", axes)
        for i, size in enumerate(sizes):
            if size or not is_bush:
                element = f"{name}_{number}_{i + 1}"
                data.couplings += [f"*ELEMENT, TYPE=SPRING{len(ends)}, ELSET={element}"]
                data.couplings += [", ".join([str(next(elements)), *nodes])]
                data.couplings += [f"*SPRING, ELSET={element}{option}"]
                data.couplings += [", ".join(str(first + i) for _, first in ends), f"{size:.12g}"]

    for (name, why), numbers in refused.items():
        number = f"{numbers[0]} and others" if len(numbers) > 1 else numbers[0]
        note = f"{name} {number} (it {why}): write [[supports.bushing]] or [[spring]]"
        data.skipped[note] += len(numbers)


def _end_axes(data: Bulk, nodes: list[str]) -> np.ndarray:
    """Return the common axes of the nodes of a spring in rows, shape (3, 3)."""
    axes = [data.axes_at(data.grid(node)[CD], node) for node in nodes]
    if not all(np.allclose(axes[0], at_end) for at_end in axes[1:]):
        raise MeshFileError("has nodes with different axes (CD)")
    return axes[0]


def _bush_axes(data: Bulk, fields: list[str], nodes: list[str], sizes: list[float]) -> np.ndarray:
    """Return the axes that a CBUSH defines in rows, shape (3, 3)."""
    first, last = data.grid(nodes[0]), data.grid(nodes[-1])
    system, offset = fields[7], fields[9]
    if not system:
        raise MeshFileError("has no CID for its axes")
    kind, axes, _ = data.system(system)
    if kind != "R":
        raise MeshFileError(f"has the CID {system}, which is not rectangular")
    if offset not in ("", "-1"):
        raise MeshFileError(f"has the OCID {offset}, not -1")
    apart = data.point(last) - data.point(first)
    across = np.linalg.norm(np.cross(apart, axes), axis=1) > ALONG * np.linalg.norm(apart)
    if (across & (np.array(sizes[:3]) != 0)).any():
        raise MeshFileError("has a stiffness across the line between its nodes")
    return axes


def _read_load(data: Bulk, name: str, fields: list[str]) -> None:
    """Read a FORCE on the freedoms 1 to 3 of a node, or a MOMENT on 4 to 6, in basic axes."""
    number, node, system, size = fields[:4]
    load = np.array([real(size) * real(text) for text in fields[4:7]]) @ data.axes_at(system, node)
    for freedom, value in enumerate(load.tolist(), 1 if name == "FORCE" else 4):
        data.sets["LOAD", number].append(Entry(node, str(freedom), value))


_READERS: dict[str, Callable[[Bulk, str, list[str]], None]] = {
    **dict.fromkeys(SYSTEMS, _check_system),
    "GRID": _read_grid,
    **dict.fromkeys(_SOLIDS, _read_cell),
    "MAT1": _read_mat1,
    "MAT9": _read_mat9,
    "PSOLID": _read_psolid,
    **dict.fromkeys(("SPC", "SPC1"), _read_spc),
    **dict.fromkeys(("SPCADD", "LOAD"), _read_sum),
    "RBE2": _read_rbe2,
    "RBE3": _read_rbe3,
    **dict.fromkeys(("CELAS1", "CELAS2", "CBUSH", "PELAS", "PBUSH"), _read_spring),
    **dict.fromkeys(("FORCE", "MOMENT"), _read_load),
}
