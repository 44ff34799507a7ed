"""Conversion of an Ansys archive (.cdb, of CDWRITE) to an Abaqus deck."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator
from dataclasses import dataclass, field

from wrenchbook.fea.mesh.io.abaqus_keywords import real, whole
from wrenchbook.fea.mesh.io.translated import Case, Translated
from wrenchbook.fea.mesh.mesh import NODES_PER_CELL
from wrenchbook.fea.spec.problems import MeshFileError

# SOLID elements by number: hexahedra, which may be collapsed, and tetrahedra
_HEX = ("45", "185", "95", "186")
_TET = ("92", "187", "285")
_SKIPPED = {"CE", "CEINTF", "CERIG", "CP", "CPINTF", "DSYM", "NROTAT", "RBE3"}  # constraints, axes
_SKIPPED |= {"DA", "DK", "DL", "FK", "SF", "SFA", "SFE", "SFGRAD", "SFL"}  # on geometry and faces
_SKIPPED |= {"BF", "BFA", "BFE", "BFK", "BFL", "BFUNIF", "BFV", "TUNIF"}  # temperature, body loads
_SKIPPED |= {"ACEL", "CMACEL", "CMOMEGA", "DOMEGA", "OMEGA"}  # acceleration and rotation
_SKIPPED |= {"DCUM", "DSCALE", "FCUM", "FSCALE"}  # factors of later loads
_SKIPPED |= {"EKILL", "INISTATE", "TB"}  # no stiffness, initial stresses, further laws
_SKIPPED |= {"N", "NDELE", "NGEN", "NMODIF", "NSCALE", "NSYM", "NUMMRG"}  # nodes beside NBLOCK
_SKIPPED |= {"E", "EDELE", "EGEN", "EMODIF", "EN", "ENGEN", "ESYM", "MPCHG", "MPDELE"}  # elements
_SKIPPED |= {"*DO", "*DOWHILE", "*REPEAT"}  # loops, besides RP and a number
_SKIPPED |= {"CM", "CMDELE", "CMEDIT", "CMMOD"}  # components beside CMBLOCK
_SELECTIONS = {"NSEL", "NSLE", "NSLA", "NSLL", "NSLK", "NSLV", "CMSEL", "ALLSEL"}
_CONSTANTS = {"EX": "E", "NUXY": "NU", "PRXY": "NU", "DENS": "DENSITY", "ALPX": "EXPANSION"}
# Constants along the other axes, which are the first one's if they are left out.
_OTHER_AXES = {"E": ("EY", "EZ"), "EXPANSION": ("ALPY", "ALPZ")}
_FREEDOMS = {"UX": "1", "UY": "2", "UZ": "3", "ROTX": "4", "ROTY": "5", "ROTZ": "6"}
_FREEDOMS |= {"ALL": "123456", "FX": "1", "FY": "2", "FZ": "3", "MX": "4", "MY": "5", "MZ": "6"}
_MATERIAL, _TYPE, _NODE_COUNT, _ELEMENT, _FIRST_NODE = 0, 1, 8, 10, 11  # fields of EBLOCK's rows

# Indices of a collapsed hexahedron's nodes, by which of its corners coincide.
_WEDGE = [0, 1, 2, 4, 5, 6, 8, 9, 11, 12, 13, 15, 16, 17, 18]
_PYRAMID = [*range(5), *range(8, 12), *range(16, 20)]
_TETRAHEDRON = [0, 1, 2, 4, 8, 9, 11, 16, 17, 18]


_OPTIONS = {
    **dict.fromkeys(itertools.product(("185", "186", "187", "285"), "236"), ("0",)),
    ("185", "2"): ("0", "1", "2", "3"),
    ("186", "2"): ("0", "1"),
}
"""Values of element options that are taken over, by element and number: 2 is the integration (of
SOLID185 any, since its cells get midside nodes), 3 makes layers, 6 gives pressures of their own."""


@dataclass
class _Type:
    name: str  # element number such as 186
    options: dict[str, str]  # values by number, each as text

    @property
    def is_full(self) -> bool:
        """Whether its hexahedra of 20 nodes are integrated fully."""
        if self.name == "95":  # 14 points, or 2 x 2 x 2
            return self.options.get("11") != "1"
        return self.options.get("2") == "1"

    def others(self) -> list[str]:
        """Name the options that are not taken over."""
        return [
            f"SOLID{self.name} with KEYOPT({number}) = {self.options[number]}, taken as 0"
            for (name, number), values in _OPTIONS.items()
            if name == self.name and self.options.get(number, "0") not in values
        ]


@dataclass
class _Archive(Translated):
    """A deck under construction, and the state of the archive."""

    types: dict[str, _Type] = field(default_factory=dict)  # element types by number
    # By name, constants by the words of the deck ("E" and "NU" make *ELASTIC)
    materials: dict[str, dict[str, str]] = field(default_factory=dict)
    parameters: dict[str, str] = field(default_factory=dict)
    held: dict[tuple[str, str], float] = field(default_factory=dict)  # by node and freedom
    forces: dict[tuple[str, str], float] = field(default_factory=dict)  # by node and freedom
    selected: bool = False  # whether nodes are selected that the archive does not list
    n_branches: int = 0  # open *IF

    def type_of(self, number: str) -> _Type:
        """Return the element type of a number.

        Raises MeshFileError if no ET defines it.
        """
        if number not in self.types:
            known = ", ".join(self.types) or "none"
            raise MeshFileError(f"needs type {number}, but ET above defines {known}; add its ET")
        return self.types[number]

    def end_step(self, name: str) -> None:
        """Add a load case of the supports and forces in effect."""
        held = [f"{node}, {way}" for node, way in self.held]
        loads = [f"{node}, {way}, {value}" for (node, way), value in self.forces.items()]
        self.cases.append(Case(name, held, loads))


def read_ansys(text: str) -> Translated:
    """Return the content of an archive: regions MAT_1, node components, D and F on nodes.

    Each LSWRITE and SOLVE ends a load case; without any, the archive is one load case.

    Raises MeshFileError if a block cannot be read.
    """
    archive = _Archive(nonlinear=bool(re.search(r"^\s*NLGEOM\s*,\s*(ON|1)", text, re.I | re.M)))
    lines = enumerate(text.splitlines(), start=1)
    # The iterator of the loop, which continues after the rows of a block.
    rows = (row for _, row in lines)
    for number, line in lines:
        for command in line.split("!")[0].split("$"):
            word, *fields = [text.strip().upper() for text in command.split(",")]
            try:
                if word in _BLOCKS:
                    _BLOCKS[word](archive, fields, rows)
                else:
                    _take_command(archive, word, fields)
            except MeshFileError as error:
                raise MeshFileError(f"line {number}: {word} {error}") from None
            except (ValueError, LookupError, StopIteration):
                why = "is cut off or not in CDWRITE's form; write the archive again by CDWRITE,DB"
                raise MeshFileError(f"line {number}: {word} {why}") from None
    if not archive.cases:
        archive.end_step("")
    for name, constants in archive.materials.items():
        for first, others in _OTHER_AXES.items():
            values = {constants.pop(label, "") for label in others} - {""}
            if values - {constants.get(first, "")}:  # along x alone it is none of an isotropic law
                constants.pop(first, None)
                archive.skipped[f"{', '.join(others)} of {name}, an orthotropic material"] += 1
        young, ratio = constants.pop("E", ""), constants.pop("NU", "")
        elastic = {"ELASTIC": f"{young}, {ratio}"} if young and ratio else {}
        archive.constants[name] = elastic | constants
    return archive


def _take_command(archive: _Archive, word: str, fields: list[str]) -> None:
    """Read a command of one line, with parameters replaced by their values."""
    assigned = re.fullmatch(r"(\w+)\s*=\s*(.+)", word)
    if assigned is not None:
        word = "*SET"
        fields = [assigned[1], assigned[2]]
    values = [archive.parameters.get(text, text) for text in fields]
    if word == "*SET":  # *SET,Par,VALUE
        archive.parameters[fields[0]] = "".join(values[1:2])
    elif word == "ET":  # ET,ITYPE,Ename,KOP1,KOP2,...
        archive.types[values[0]] = _Type(re.sub(r"\D", "", values[1]), _options(values[2:]))
    elif word.startswith("KEYOP"):  # KEYOPT,ITYPE,KNUM,VALUE
        if values[0] in archive.types or values[1] == "2":
            archive.type_of(values[0]).options[values[1]] = "".join(values[2:3]) or "0"
    elif word in ("MP", "MPDATA"):
        _take_constant(archive, word, values)
    elif word in ("D", "F", "DDELE", "FDELE"):
        _take_on_nodes(archive, word, values)
    else:
        _take_control(archive, word, fields)


def _take_control(archive: _Archive, word: str, fields: list[str]) -> None:
    """Read a command of load steps, conditions or selections; count skipped commands."""
    if word == "LSCLEAR" and fields[:1] in (["FE"], ["ALL"]):  # LSCLEAR,Lab
        archive.held = {}
        archive.forces = {}
    elif word in ("*IF", "*ENDIF"):  # *IF,VAL1,Oper1,VAL2,THEN; without THEN no *ENDIF follows
        if word == "*ENDIF":
            archive.n_branches -= 1
        elif "THEN" in fields:
            archive.n_branches += 1
    elif word in ("LSWRITE", "SOLVE"):
        archive.end_step(f"LOAD STEP {len(archive.cases) + 1}")
    elif word in _SELECTIONS:  # ALLSEL and NSEL,ALL leave nothing out
        archive.selected = word != "ALLSEL" and [word, *fields[:1]] != ["NSEL", "ALL"]
    elif word in _SKIPPED or re.fullmatch(r"RP\d+", word):
        archive.skipped[word] += 1


def _take_nodes(archive: _Archive, _: list[str], rows: Iterator[str]) -> None:
    """Read NBLOCK,NUMFIELD,Solkey,NDMAX,NDSEL: a format such as (3i9,6e21.13e3) and rows.

    A row has number, two fields of the geometry, x, y, z and three angles, zeros at the end left
    out. The last is -1 or N,R5.3,LOC,-1.
    """
    n_integers, width, size = map(int, re.findall(r"(\d+)[iI](\d+),\d+[eE](\d+)", next(rows))[0])
    start = n_integers * width
    for row in rows:
        if not row[:width].strip().isdigit():
            return
        values = [row[start + i * size : start + (i + 1) * size].strip() or "0" for i in range(6)]
        angles = [real(text) for text in values][3:]
        archive.nodes.append(", ".join([row[:width].strip(), *values[:3]]))
        if any(angles):
            archive.skipped["nodes with local axes"] += 1


def _take_types(archive: _Archive, _: list[str], rows: Iterator[str]) -> None:
    """Read ETBLOCK,NUM,MAX of newer archives: a format such as (2i9,19a9) and rows, the last -1.

    A row has ITYPE, Ename, KOP1, KOP2, ...
    """
    widths = re.findall(r"i(\d+),\d+a(\d+)", next(rows).lower())[0]
    for row in rows:
        number, *fields = _split_fields(row, int(widths[0]))
        if number == "-1":
            return
        archive.types[number] = _Type(fields[0], _options(fields[1:]))


def _options(values: list[str]) -> dict[str, str]:
    """Return element options by number, from 1."""
    return {str(number): value or "0" for number, value in enumerate(values, start=1)}


def _take_elements(archive: _Archive, fields: list[str], rows: Iterator[str]) -> None:
    """Read EBLOCK,19,SOLID,MAX,NUM: a format such as (19i8) and rows, the last -1.

    A row has eleven fields, see `_MATERIAL`, and up to eight nodes, further ones in a second row.
    """
    if fields[:2] != ["19", "SOLID"]:
        form = ",".join(fields[:2])
        raise MeshFileError(f'has "{form}", not 19,SOLID; write the archive by CDWRITE,DB')
    width = int(re.findall(r"[iI](\d+)", next(rows))[0])
    for row in rows:
        numbers = _split_fields(row, width)
        if numbers[0] == "-1":
            return
        nodes = numbers[_FIRST_NODE:]
        while len(nodes) < int(numbers[_NODE_COUNT]):
            nodes += _split_fields(next(rows), width)
        kind = archive.type_of(numbers[_TYPE])
        region = f"MAT_{numbers[_MATERIAL]}"
        _take_cell(archive, kind, region, numbers[_ELEMENT], nodes)


def _split_fields(row: str, width: int) -> list[str]:
    """Split a row into fields of a fixed width."""
    return [row[i : i + width].strip() for i in range(0, len(row.rstrip()), width)]


def _take_cell(archive: _Archive, kind: _Type, region: str, number: str, nodes: list[str]) -> None:
    """Read a cell; a hexahedron with repeated nodes is a cell with fewer nodes."""
    if kind.name not in (*_HEX, *_TET):
        archive.skipped[f"elements of type {kind.name}"] += 1
        return
    archive.skipped.update(kind.others())
    archive.sections[region] = region
    if kind.name in _HEX:
        nodes = _without_repeated(nodes)
    if len(nodes) not in NODES_PER_CELL.values():
        raise MeshFileError(f"has element {number} with {len(nodes)} nodes; write 20 at most")
    corners = {10: 4, 13: 5, 15: 6, 20: 8}.get(len(nodes), len(nodes))
    if len({*nodes[:corners]}) < corners:
        raise MeshFileError(
            f"has element {number} with a corner twice; repeat corner 3 as 4 and 7 as 8 of a wedge,"
            " 5 as 6 to 8 of a pyramid, both of a tetrahedron"
        )
    if "0" in nodes[:corners]:
        raise MeshFileError(f"has node 0 at a corner of element {number}; write a node's number")
    if set(nodes[corners:]) == {"0"}:
        nodes = nodes[:corners]
    integration = "R" if len(nodes) == 20 and not kind.is_full else ""
    archive.elements[f"C3D{len(nodes)}{integration}", region].append([number, *nodes])


def _without_repeated(nodes: list[str]) -> list[str]:
    """Return the nodes of a hexahedron, or of the cell to which repeated nodes reduce it."""
    lower, upper = nodes[2] == nodes[3], len({*nodes[4:8]}) == 1
    if lower and upper:
        indices = _TETRAHEDRON
    elif lower:
        indices = _WEDGE
    elif upper:
        indices = _PYRAMID
    else:
        indices = [*range(20)]
    return [nodes[i] for i in indices if i < len(nodes)]


def _take_component(archive: _Archive, fields: list[str], rows: Iterator[str]) -> None:
    """Read CMBLOCK,Cname,Entity,NUMITEMS: a format such as (8i10) and rows of numbers.

    A negative number ends a range.
    """
    name, entity, count = fields[:3]
    width = int(re.findall(r"[iI](\d+)", next(rows))[0])
    numbers: list[int] = []
    while len(numbers) < int(count):
        numbers += map(int, _split_fields(next(rows), width))
    if not entity.startswith("NODE"):
        archive.skipped[f"component {name} of elements"] += 1
        return
    members = archive.groups[name]
    for number in numbers:
        first = number if number > 0 else int(members[-1]) + 1
        members += map(str, range(first, abs(number) + 1))


def _take_constant(archive: _Archive, word: str, fields: list[str]) -> None:
    """Read MP,Lab,MAT,C0,C1,... or MPDATA,R5.0,LENGTH,Lab,MAT,STLOC,VAL1,..., VAL1 at STLOC."""
    position = "1"
    if word == "MPDATA":
        position = fields[4]
        fields = fields[2:4] + fields[5:]
    label, number, value, *further = fields
    constants = archive.materials.setdefault(f"MAT_{whole(number)}", {})
    if label in _CONSTANTS:
        if int(position) == 1:  # otherwise later rows of a table
            constants[_CONSTANTS[label]] = value
        first = constants.get(_CONSTANTS[label], "")
        if any(text != first for text in (value, *further) if text):
            archive.skipped[f"{label} at further temperatures"] += 1
    elif label in itertools.chain.from_iterable(_OTHER_AXES.values()):
        constants.setdefault(label, value)
    elif label == "GXY":
        archive.skipped["orthotropic constants"] += 1


def _nodes_of(archive: _Archive, name: str, last: str, step: str) -> list[str]:
    """Return the nodes of a command: from a number to the last, of a component, or all."""
    if name.isdigit() and last:  # a range may have gaps
        span = range(int(name), whole(last) + 1, whole(step or "1"))
        known = (row.partition(",")[0] for row in archive.nodes)
        return [node for node in known if int(node) in span]
    if name.isdigit():
        return [name]
    if name == "ALL" and archive.selected:
        raise MeshFileError("acts on ALL of a selection, which is not evaluated; name a component")
    if name == "ALL":
        return [row.partition(",")[0] for row in archive.nodes]
    nodes = archive.groups.get(name, [])
    if not nodes:
        raise MeshFileError(f'acts on "{name}", not a component above; write it or node numbers')
    return nodes


def _take_on_nodes(archive: _Archive, word: str, fields: list[str]) -> None:
    """Set or remove (DDELE, FDELE) a support or load of a node, of a range, or of a group.

    D,NODE,Lab,VALUE,VALUE2,NEND,NINC,Lab2,...,Lab6 and F,NODE,Lab,VALUE,VALUE2,NEND,NINC;
    DDELE,NODE,Lab,NEND,NINC and FDELE,NODE,Lab,NEND,NINC.
    """
    if archive.n_branches:
        raise MeshFileError("is inside *IF; write the lines that apply, without the condition")
    node, label, *values = (*fields, *[""] * 9)
    acting = archive.held if word[0] == "D" else archive.forces
    removes = word.endswith("DELE")
    if removes:
        values = ["", "", *values]
    value, _, last, step, *further = values
    nodes = _nodes_of(archive, node, last, step)
    labels = [label or "ALL", *filter(None, further if word == "D" else ())]
    if not _FREEDOMS.keys() >= {*labels}:
        archive.skipped[f"{word} of {', '.join(labels)}"] += 1
    ways = "".join(_FREEDOMS.get(text, "") for text in labels)
    for number, way in itertools.product(nodes, ways):
        acting.pop((number, way), None)
        if not removes:
            acting[number, way] = real(value or "0")
    if word == "D" and ways and real(value or "0") != 0.0:
        archive.skipped["D with a motion that is not 0"] += 1


_BLOCKS = {
    "ETBLOCK": _take_types,
    "NBLOCK": _take_nodes,
    "EBLOCK": _take_elements,
    "CMBLOCK": _take_component,
}
