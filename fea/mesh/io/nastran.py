"""Conversion of a Nastran bulk data file (.bdf, .dat, .nas) to an Abaqus deck.

meshio reads such meshes too, but leaves out large-field elements and coordinate systems without a
message, and knows no materials, constraints and rigid elements.
"""

from __future__ import annotations

import itertools
import re
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from wrenchbook.fea.mesh.io.abaqus import axes_through, cartesian, radial_axes
from wrenchbook.fea.mesh.io.abaqus_keywords import whole
from wrenchbook.fea.mesh.io.raw import Case, Translated
from wrenchbook.fea.spec.deck_text import DeckText
from wrenchbook.fea.spec.problems import MeshFileError

Array = np.ndarray

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
_QUIET = {"PARAM", "END BULK", "MPCADD"}  # cards without content, which no message lists
_SYSTEMS = ("CORD1R", "CORD1C", "CORD1S", "CORD2R", "CORD2C", "CORD2S")
_EXPONENT = re.compile(r"(?<=[\d.])([+-]\d+)$")
_MASS_FACTOR = re.compile(r"^\s*PARAM[\s,*]+WTMASS[\s,]+([\w.+-]+)", re.I | re.M)
_ALONG = 1e-6  # part of a length: decks write coordinates with 7 digits
_FIRST_SPRING = 10**9  # number of the first element of springs: Nastran's own end at 1e8
_NONLINEAR = re.compile(r"^\s*SOL\s+(106|NLSTATIC|400|60[01])\b", re.I | re.M)
_CASE = re.compile(r"(SUBCASE|SUBC|SYM|SUBCOM|SYMCOM|REPCASE)\b\s*=?\s*(\d+)")
_SELECTION = re.compile(r"(SPC|LOAD)\b\s*(?:\([^)]*\))?\s*=?\s*(\w+)")


@dataclass
class _Bulk(Translated):
    """A deck under construction, and the content of the file that later cards refer to."""

    # By kind ("SPC", "LOAD") and number: rows of node, freedom and value; the set ("GRID", "") has
    # the supports of GRID cards themselves.
    sets: dict[tuple[str, str], list[tuple[str, str, float]]] = field(
        default_factory=lambda: defaultdict(list)
    )
    # By kind and number of an SPCADD or LOAD: factors and numbers of sets
    sums: dict[tuple[str, str], list[tuple[float, str]]] = field(default_factory=dict)
    mass_factor: float = 1.0  # factor on all densities: PARAM,WTMASS
    # Fields of coordinate systems and of nodes by number; systems by number: kind, axes, origin
    cards: dict[str, tuple[str, list[str]]] = field(default_factory=dict)
    grids: dict[str, list[str]] = field(default_factory=dict)
    systems: dict[str, tuple[str, Array, Array]] = field(default_factory=dict)
    # Cards of springs by number, and by name and number the stiffnesses of each property
    springs: dict[str, tuple[str, list[str]]] = field(default_factory=dict)

    def index(self, name: str, fields: list[str]) -> None:
        """Store a GRID or coordinate systems by number."""
        if name == "GRID":
            self.grids[fields[0]] = fields
        elif name in _SYSTEMS:
            self.cards[fields[0]] = name, fields
            if name[4] == "1" and fields[4]:
                self.cards[fields[4]] = name, fields[4:]

    def system(self, number: str) -> tuple[str, Array, Array]:
        """Return kind (R, C, S), axes in rows and origin of a coordinate system, in basic axes."""
        if number in ("", "0"):
            return "R", np.eye(3), np.zeros(3)
        if number not in self.systems:
            if number not in self.cards:
                message = f"needs coordinate system {number}, which no CORD card defines; add it"
                raise MeshFileError(message)
            name, fields = self.cards[number]
            if not fields:
                raise MeshFileError(f"needs {name} {number}, which needs itself; correct its RID")
            # No fields during its own evaluation: a system must not refer to itself.
            self.cards[number] = name, []
            try:
                if name[4] == "1":
                    points = np.array([self.point(self.grid(node)) for node in fields[1:4]])
                else:
                    numbers = np.array([_real(each) for each in fields[2:11]]).reshape(3, 3)
                    points = np.array([self.in_basic_axes(fields[1], each) for each in numbers])
                z, x, y = axes_through(*points)  # its second point is on z, its third in xz
            except MeshFileError as error:  # the current card names the system
                raise MeshFileError(f"needs {name} {number}, which {error}") from None
            finally:
                self.cards[number] = name, fields
            self.systems[number] = name[5], np.array([x, y, z]), points[0]
        return self.systems[number]

    def in_basic_axes(self, number: str, point: Array) -> Array:
        """Return a point of a coordinate system, its angles in degrees, in basic axes: (3,)."""
        if number in ("", "0"):
            return point
        kind, axes, origin = self.system(number)
        return origin + cartesian(kind, point) @ axes

    def point(self, fields: list[str]) -> Array:
        """Return the position of the node of a GRID, in basic axes, shape (3,)."""
        return self.in_basic_axes(fields[1], np.array([_real(each) for each in fields[2:5]]))

    def grid(self, node: str) -> list[str]:
        """Return the fields of a node's GRID.

        Raises MeshFileError if there is none.
        """
        if node not in self.grids:
            raise MeshFileError(f"names node {node}, which no GRID defines; add it")
        return self.grids[node]

    def stiffnesses(self, name: str, number: str) -> list[float]:
        """Return the stiffnesses of a spring.

        Raises MeshFileError if its property is missing.
        """
        _, fields = self.springs[number]
        if name == "CELAS2":  # has its own stiffness
            return [_real(fields[1])]
        kind, key = "PBUSH" if name == "CBUSH" else "PELAS", fields[1] or number
        if kind + key not in self.springs:
            raise MeshFileError(f"needs {kind} {key}, which no card defines")
        return [_real(text) for text in self.springs[kind + key][1]]

    def oriented(self, name: str, axes: Array, kind: str = "R") -> str:
        """Add an orientation unless it is the basic one; return the option that names it."""
        if kind == "R" and np.array_equal(axes, np.eye(3)):
            return ""
        system = ", SYSTEM=CYLINDRICAL" if kind == "C" else ""
        row = ", ".join(f"{each:.15g}" for each in axes[:2].ravel().tolist())
        self.couplings += [f"*ORIENTATION, NAME=AXES_{name}{system}", row]
        return f", ORIENTATION=AXES_{name}"

    def axes_at(self, number: str, node: str) -> Array:
        """Return the axes of a coordinate system at a node in rows, shape (3, 3)."""
        kind, axes, origin = self.system(number)
        if kind == "R":
            return axes
        out = self.point(self.grid(node)) - origin
        try:
            if kind == "C":
                return radial_axes(axes[2], out)
            return axes_through(np.zeros(3), out, np.cross(np.cross(axes[2], out), out))
        except MeshFileError:
            raise MeshFileError(
                f"has node {node} on the axis of coordinate system {number}, where its directions "
                "are not defined; use a rectangular system (CORD2R) there"
            ) from None


def read_nastran(text: DeckText) -> Translated:
    """Return the content of a bulk data file: regions PSOLID_1, groups RBE2_7, a case a subcase.

    Raises MeshFileError if a card cannot be read, or nodes are in a local coordinate system.
    """
    control, *bulk = re.split(r"^\s*BEGIN[ \t,]+BULK.*$", text, maxsplit=1, flags=re.I | re.M)
    bulk, control = (bulk[0], control) if bulk else (control, "")
    data = _Bulk(nonlinear=_NONLINEAR.search(control) is not None)
    if factor := _MASS_FACTOR.search(text):
        data.mass_factor = _real(factor[1])
    lines_before = text.count("\n") - bulk.count("\n")
    cards = list(_cards(bulk.splitlines(), text, lines_before))
    for _, name, fields in cards:  # nodes may come after cards that refer to them
        data.index(name, fields)
    for number, name, fields in cards:
        taker = _TAKERS.get(name)
        try:
            if taker is not None:
                taker(data, name, fields)
            elif name not in (*_QUIET, *_SYSTEMS):
                data.skipped[name] += 1
        except MeshFileError as error:
            raise MeshFileError(f"line {text.place(number)}: {name} {error}") from None
        except (ValueError, LookupError):
            why = "lacks a field, or has a number too large; complete the card"
            raise MeshFileError(f"line {text.place(number)}: {name} {why}") from None
    _take_springs(data)
    _take_cases(data, control)
    return data


def _take_cases(data: _Bulk, control: str) -> None:
    """Make a case of each subcase from its selected sets."""
    used, turned = set(), _turn(data)
    held: dict[str, list[str]] = {}

    def rows(kind: str, number: str) -> Iterator[tuple[str, str, float]]:
        for factor, part in data.sums.get((kind, number), [(1.0, number)]):
            used.add((kind, part))
            if part and (kind, part) not in data.sets:
                data.skipped[f"{kind} set {part}, which has no supported card"] = 1
            for node, way, value in data.sets.get((kind, part), ()):
                yield node, way, factor * value

    for name, selected in _selections(data, control).items():
        number = selected.get("SPC", "")
        if number not in held:
            held[number] = []
            for node, way, value in (*rows("GRID", ""), *rows("SPC", number)):
                held[number].append(f"{node}, {way}")
                data.skipped["SPC with a motion that is not 0"] += value != 0.0
        loads = _along_axes(rows("LOAD", selected.get("LOAD", "")), turned)
        data.cases.append(Case(name, held[number], list(loads)))
    for (kind, number), unused in data.sets.items():
        if (kind, number) not in used:
            data.skipped[f"{kind} set {number}, which no case selects"] += len(unused)


def _along_axes(loads: Iterator[tuple[str, str, float]], turned: dict[str, Array]) -> Iterator[str]:
    """Yield rows of *CLOAD along the axes of each node for loads along the basic axes."""
    for node, way, value in loads:
        first = 1 if way in "123" else 4
        for i, part in enumerate(turned.get(node, np.eye(3))[:, int(way) - first].tolist()):
            if part * value:
                yield f"{node}, {first + i}, {part * value:.9g}"


def _turn(data: _Bulk) -> dict[str, Array]:
    """Give nodes that are held in a system of their own (CD) its axes there; return them."""
    held, turned = defaultdict[str, set[str]](set), dict[str, Array]()
    for (kind, _), rows in data.sets.items():
        for node, way, _ in rows if kind != "LOAD" else ():
            held[node].add(way)
    for node, ways in held.items():
        number = data.grids[node][5] if node in data.grids else ""
        if number not in ("", "0", "-1"):
            kind, axes, _ = data.system(number)
            # If both the radial and the circumferential freedom are held, or neither, the system's
            # own axes give the same.
            alike = kind == "C" and ("1" in ways) == ("2" in ways)
            turned[node] = axes if alike else data.axes_at(number, node)
            row = ", ".join(f"{each:.15g}" for each in turned[node][:2].ravel().tolist())
            data.transforms[row].append(node)
    return turned


def _selections(data: _Bulk, control: str) -> dict[str, dict[str, str]]:
    """Return by subcase the number of its set of each kind.

    Each set is a case if none is selected.
    """
    common: dict[str, str] = {}
    current, cases = common, dict[str, dict[str, str]]()
    for line in control.upper().splitlines():
        line = line.partition("$")[0].strip()
        if match := _CASE.match(line):
            current = dict(common)
            if match[1] in ("SUBCASE", "SUBC", "SYM"):
                cases[f"SUBCASE {match[2]}"] = current
            else:
                data.skipped[f"{match[1]}, a combination of subcases"] += 1
        elif match := _SELECTION.match(line):
            current[match[1]] = match[2] if match[2].isdigit() else ""
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


def _cards(lines: list[str], text: DeckText, skipped: int) -> Iterator[tuple[int, str, list[str]]]:
    """Yield line number, name and fields of each card, its continuations joined."""
    card: tuple[int, str, list[str]] | None = None
    for number, line in enumerate(lines, start=skipped + 1):
        line = line.partition("$")[0].expandtabs().rstrip()
        if not line:
            continue
        head, *fields = (each.strip() for each in line.split(","))
        count = 4 if line[:1] == "*" or head[:8].rstrip().endswith("*") else 8
        if "," not in line:
            head, width = line[:8].strip(), 64 // count
            fields = [line[8 + width * i : 8 + width * (i + 1)].strip() for i in range(count)]
        if head.upper() == "ENDDATA":
            break
        if any(fields[count + 1 :]):
            first = next(each for each in fields[count:] if each)
            raise MeshFileError(
                f"line {text.place(number)}: {head} has more than {count} fields; continue with "
                f'"{first}" on a new line'
            )
        fields = (fields + [""] * count)[:count]
        if card is not None and head[:1] in ("", "+", "*"):
            card[2].extend(fields)
            continue
        if card is not None:
            yield card
        card = (number, head.rstrip("*").upper(), fields)
    if card is not None:
        yield card


def _real(field: str) -> float:
    """Return a number, whose exponent may have no letter: 2.1+5."""
    try:
        return float(_EXPONENT.sub(r"e\1", field.upper().replace("D", "E") or "0"))
    except ValueError:
        raise MeshFileError(f'has "{field}" where a number must be; write a number') from None


def _grid(data: _Bulk, _: str, fields: list[str]) -> None:
    coordinates = ", ".join(f"{x:.12g}" for x in data.point(fields).tolist())
    whole(fields[0])  # raises if it is no number
    data.nodes.append(f"{fields[0]}, {coordinates}")
    _hold(data, ("GRID", ""), fields[0], fields[6])


def _hold(data: _Bulk, key: tuple[str, str], node: str, freedoms: str, value: str = "") -> None:
    """Add the freedoms of a node, such as "123", to a set; a row may have no node."""
    ways = sorted(set(freedoms) & set("123456")) if node else ()
    data.sets[key] += [(node, way, _real(value)) for way in ways]


def _solid(data: _Bulk, name: str, fields: list[str]) -> None:
    """Read a cell; a missing midside node is "0"."""
    corners, most = _SOLIDS[name]
    count = max((i for i, each in enumerate(fields[2:], 1) if each), default=0)
    if count > corners:
        count = max(count, most)
    nodes = [each or "0" for each in (*fields[2:], *[""] * most)[:count]]
    if (count := sum(node != "0" for node in nodes[:corners])) < corners:
        raise MeshFileError(f"{fields[0]} has {count} of its {corners} corners; write all of them")
    if (kind := _SOLIDS[name].get(len(nodes))) is None:
        raise MeshFileError(f"{fields[0]} has {len(nodes)} nodes; write at most {most}")
    nodes = [nodes[i] for i in _ORDER.get(kind, range(len(nodes)))]
    data.elements[kind, f"PSOLID_{fields[1] or fields[0]}"].append([fields[0], *nodes])


def _material(data: _Bulk, name: str, fields: list[str]) -> None:
    """Read a MAT1; the third of E, G and nu follows from the other two."""
    young, shear, ratio = (_real(each) for each in fields[1:4])
    if not fields[1]:
        young = 2 * shear * (1 + ratio)
    elif not fields[3] and shear:
        ratio = young / (2 * shear) - 1
    constants = data.constants[f"MAT_{fields[0]}"]
    constants["ELASTIC"] = f"{young:.9g}, {ratio:.9g}"
    further = {"DENSITY": _real(fields[4]) * data.mass_factor, "EXPANSION": _real(fields[5])}
    constants |= {word: f"{value:.9g}" for word, value in further.items() if value}


def _orthotropic(data: _Bulk, name: str, fields: list[str]) -> None:
    """Read a MAT9 of nine constants; its shears are xy, yz, zx."""
    values = [_real(each) for each in (*fields, *[""] * 29)[:29]]
    _, constants, density, expansion = values[0], values[1:22], values[22], values[23:]
    stiffness = np.zeros((6, 6))
    stiffness[np.triu_indices(6)] = constants
    if np.triu(stiffness, 1)[:, 3:].any():
        data.skipped[f"{name} {fields[0]} that is not orthotropic, with constants beyond nine"] += 1
        return
    # Abaqus has 11, 12, 22, 13, 23, 33, then the shears 12, 13, 23.
    in_order = [*stiffness.T[:3, :3][np.tril_indices(3)], *np.diag(stiffness)[[3, 5, 4]]]
    material = data.constants[f"MAT_{fields[0]}"]
    material["ELASTIC, TYPE=ORTHO"] = ", ".join(f"{each:.12g}" for each in in_order)
    if density:
        material["DENSITY"] = f"{density * data.mass_factor:.9g}"
    data.skipped[f"expansion of {name}"] += any(expansion)


def _section(data: _Bulk, name: str, fields: list[str]) -> None:
    """Read PSOLID: the material of a region, and the axes of the material."""
    region, kind, axes, origin = f"{name}_{fields[0]}", "-", np.eye(3), np.zeros(3)
    data.sections[region] = f"MAT_{fields[1]}"
    if fields[2] != "-1":
        kind, axes, origin = data.system(fields[2])
    if kind == "R":
        data.sections[region] += data.oriented(region, axes)
    elif kind == "C":
        data.sections[region] += data.oriented(region, np.array([origin, origin + axes[2]]), kind)
    else:
        data.skipped["CORDM of PSOLID of an element or a sphere, which counts for MAT9"] += 1


def _listed(fields: list[str]) -> list[str]:
    """Return the numbers of a list, which may have first THRU last BY step."""
    fields = [each.upper() for each in fields if each]
    numbers: list[str] = []
    try:
        while fields:
            if fields[1:2] == ["THRU"]:
                step, end = (int(fields[4]), 5) if fields[3:4] == ["BY"] else (1, 3)
                numbers += map(str, range(int(fields[0]), int(fields[2]) + 1, step))
            else:
                numbers, end = [*numbers, str(int(fields[0]))], 1
            fields = fields[end:]
    except (ValueError, IndexError):
        message = f'lists "{", ".join(fields[:5])}"; write numbers, or first, THRU, last, BY, step'
        raise MeshFileError(message) from None
    return numbers


def _constraint(data: _Bulk, name: str, fields: list[str]) -> None:
    rows = [fields[1:4], fields[4:7]]
    if name == "SPC1":
        rows = [[node, fields[1], ""] for node in _listed(fields[2:])]
    for row in rows:
        _hold(data, ("SPC", fields[0]), *row)


def _sum(data: _Bulk, name: str, fields: list[str]) -> None:
    """Read SPCADD, and LOAD with a common factor and a factor of each set."""
    if name == "SPCADD":
        fields = [fields[0], "1.", *(each for part in fields[1:] for each in ("1.", part))]
    pairs = zip(fields[2::2], fields[3::2], strict=False)
    parts = [(_real(fields[1]) * _real(factor), part) for factor, part in pairs if part]
    data.sums[name.removesuffix("ADD"), fields[0]] = parts


def _rigid(data: _Bulk, name: str, fields: list[str]) -> None:
    """Read RBE2 as a kinematic coupling, without its thermal expansion."""
    # Without its thermal expansion.
    nodes = _listed([each for each in fields[3:] if "." not in each])
    ways = sorted(set("123") & set(fields[2]))
    turned = (data.grids[node][5] for node in nodes if node in data.grids)
    if not ways or (len(ways) < 3 and not {*turned} <= {"", "0"}):
        data.skipped[f"{name} of some freedoms only"] += 1
        return
    data.tie(f"{name}_{fields[0]}", nodes, fields[1], "KINEMATIC")
    data.couplings += ways if len(ways) < 3 else []


def _mean(data: _Bulk, name: str, fields: list[str]) -> None:
    """Read RBE3 as a distributed coupling; with UM, which changes it, it is skipped."""
    if "ALPHA" in fields:
        data.skipped[f"expansion of {name}"] += 1
        fields = fields[: fields.index("ALPHA")]
    starts = [i for i, each in enumerate(fields) if i > 3 and "." in each]
    some = not all(set("123") <= set(fields[i + 1]) for i in starts)
    if "UM" in fields or some or not starts:
        why = "of some freedoms only" if some else "with UM, or without real weights"
        data.skipped[f"{name} {why}"] += 1
        return
    if not set("123456") <= set(fields[3]):
        data.skipped[f"{name} of whose point {fields[3]} alone follow: here all freedoms do"] += 1
    weights = defaultdict[str, float](float)
    for i, end in zip(starts, [*starts[1:], len(fields)], strict=True):
        for node in _listed(fields[i + 2 : end]):
            weights[node] += _real(fields[i])
    data.tie(f"{name}_{fields[0]}", [*weights], fields[2], "DISTRIBUTING", weights.values())


def _spring(data: _Bulk, name: str, fields: list[str]) -> None:
    """Store a spring, or a property: the stiffness of one direction or of six."""
    if name == "PELAS":  # two properties a card, of four fields each
        springs = {f"{name}{fields[i]}": (name, [fields[i + 1]]) for i in (0, 4) if fields[i]}
    elif name == "PBUSH":  # stiffnesses follow the word K at the start of a line of eight fields
        row = next((i + 1 for i in range(1, len(fields), 8) if fields[i] == "K"), len(fields))
        springs = {name + fields[0]: (name, [each or "0" for each in fields[row : row + 6]])}
    else:
        springs = {fields[0]: (name, [*fields, *[""] * 8])}
    if twice := data.springs.keys() & springs:
        number = min(twice).removeprefix(name)
        raise MeshFileError(f"{number} is defined again; renumber one of the two")
    data.springs |= springs


def _take_springs(data: _Bulk) -> None:
    """Convert each freedom of a spring to an element; the reader of the deck checks them."""
    numbers = itertools.count(_FIRST_SPRING)
    refused = defaultdict[tuple[str, str], list[str]](list)  # element numbers by card and reason
    for number, (name, fields) in data.springs.items():
        if name[0] == "P":
            continue
        is_bush = name == "CBUSH"
        # Both ends by node and first freedom, without a grounded end, whose node is empty or 0.
        ends = [(fields[2], "1"), (fields[3], "1")] if is_bush else [fields[2:4], fields[4:6]]
        try:
            ends = [(node, whole(freedom or "0")) for node, freedom in ends if node.strip("0")]
            sizes, nodes = data.stiffnesses(name, number), [node for node, _ in ends]
            if not nodes or not any(sizes):
                raise MeshFileError("has a stiffness of 0" if nodes else "has no end on a node")
            axes = _spring_axes(data, fields if is_bush else [], nodes, sizes)
        except MeshFileError as error:
            refused[name, str(error)].append(number)
            continue
        option = data.oriented(f"{name}_{number}", axes)
        for i, size in enumerate(sizes):
            if size or not is_bush:
                element = f"{name}_{number}_{i + 1}"
                data.couplings += [f"*ELEMENT, TYPE=SPRING{len(ends)}, ELSET={element}"]
                data.couplings += [", ".join([str(next(numbers)), *nodes])]
                data.couplings += [f"*SPRING, ELSET={element}{option}"]
                data.couplings += [", ".join(str(way + i) for _, way in ends), f"{size:.12g}"]
    for (name, why), (first, *others) in refused.items():
        number = f"{first} and others" if others else first
        note = f"{name} {number} (it {why}): write [[supports.bushing]] or [[spring]]"
        data.skipped[note] += 1 + len(others)


def _spring_axes(data: _Bulk, bush: list[str], nodes: list[str], sizes: list[float]) -> Array:
    """Return the axes of a spring in rows: those of its nodes unless a CBUSH defines its own."""
    grids = [data.grid(node) for node in nodes]
    if not bush:
        axes, *others = [
            data.axes_at(grid[5], node) for grid, node in zip(grids, nodes, strict=True)
        ]
        if not all(np.allclose(axes, other) for other in others):
            raise MeshFileError("has nodes with different axes (CD)")
        return axes
    if not bush[7]:
        raise MeshFileError("has no CID for its axes")
    kind, axes, _ = data.system(bush[7])
    if kind != "R":
        raise MeshFileError(f"has the CID {bush[7]}, which is not rectangular")
    if bush[9] not in ("", "-1"):
        raise MeshFileError(f"has the OCID {bush[9]}, not -1")
    apart = data.point(grids[-1]) - data.point(grids[0])
    across = np.linalg.norm(np.cross(apart, axes), axis=1) > _ALONG * np.linalg.norm(apart)
    if (across & (np.array(sizes[:3]) != 0)).any():
        raise MeshFileError("has a stiffness across the line between its nodes")
    return axes


def _load(data: _Bulk, name: str, fields: list[str]) -> None:
    """Read a FORCE on the freedoms 1 to 3 of a node, or a MOMENT on 4 to 6, in basic axes."""
    number, node, system, size = fields[0], fields[1], fields[2], _real(fields[3])
    load = np.array([size * _real(each) for each in fields[4:7]]) @ data.axes_at(system, node)
    for freedom, value in enumerate(load.tolist(), 1 if name == "FORCE" else 4):
        data.sets["LOAD", number].append((node, str(freedom), value))


_TAKERS: dict[str, Callable[[_Bulk, str, list[str]], None]] = {
    "GRID": _grid,
    **dict.fromkeys(_SOLIDS, _solid),
    "MAT1": _material,
    "MAT9": _orthotropic,
    "PSOLID": _section,
    **dict.fromkeys(("SPC", "SPC1"), _constraint),
    **dict.fromkeys(("SPCADD", "LOAD"), _sum),
    "RBE2": _rigid,
    "RBE3": _mean,
    **dict.fromkeys(("CELAS1", "CELAS2", "CBUSH", "PELAS", "PBUSH"), _spring),
    **dict.fromkeys(("FORCE", "MOMENT"), _load),
}
