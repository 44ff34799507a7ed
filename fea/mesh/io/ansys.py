"""An Ansys archive (.cdb, of CDWRITE) as an Abaqus deck."""

from __future__ import annotations

import re
from collections.abc import Iterator

from wrenchbook.fea.mesh.io.raw import MeshFileError
from wrenchbook.fea.mesh.io.translated import Translated

_HEX, _TET = ("45", "185", "95", "186"), ("92", "187", "285")
_LEFT = {"CE", "CP", "SFE", "SF", "BF", "BFE", "TB", "ACEL", "RBE3", "CERIG", "OMEGA"}
_CONSTANTS = {"EX": "E", "NUXY": "NU", "PRXY": "NU", "DENS": "DENSITY", "ALPX": "EXPANSION"}
_FREEDOMS = {"UX": "1", "UY": "2", "UZ": "3", "ROTX": "4", "ROTY": "5", "ROTZ": "6"}
_FREEDOMS |= {"ALL": "123456", "FX": "1", "FY": "2", "FZ": "3", "MX": "4", "MY": "5", "MZ": "6"}

# Places of a collapsed hexahedron's nodes, by which of its corners are one node.
_WEDGE = [0, 1, 2, 4, 5, 6, 8, 9, 11, 12, 13, 15, 16, 17, 18]
_TETRAHEDRON = [0, 1, 2, 4, 8, 9, 11, 16, 17, 18]


def read_ansys(text: str) -> Translated:
    """Return what an archive holds: regions MAT_1, node components, D and F on nodes.

    Raises
    ------
    MeshFileError
        If a block cannot be read, or cells are collapsed to pyramids.
    """
    found = Translated(nonlinear=bool(re.search(r"^\s*NLGEOM\s*,\s*(ON|1)", text, re.I | re.M)))
    types: dict[str, str] = {}
    constants: dict[str, dict[str, str]] = {}
    lines = enumerate(text.splitlines(), start=1)
    rows = (row for _, row in lines)
    for number, line in lines:
        word, *fields = (each.strip().upper() for each in line.split("!")[0].split(","))
        try:
            if word in _BLOCKS:
                _BLOCKS[word](found, fields, types, rows)
            else:
                _take_command(found, word, fields, types, constants)
        except (ValueError, LookupError, StopIteration) as error:
            raise MeshFileError(f"line {number}: {word} cannot be read ({error})") from None
    for name, own in constants.items():
        pair = own.pop("E", ""), own.pop("NU", "")
        found.constants[name] = ({"ELASTIC": ", ".join(pair)} if all(pair) else {}) | own
    return found


def _take_command(
    found: Translated,
    word: str,
    fields: list[str],
    types: dict[str, str],
    constants: dict[str, dict[str, str]],
) -> None:
    if word == "ET":
        types[fields[0]] = re.sub(r"\D", "", fields[1])
    elif word.startswith("KEYOP") and fields[1:3] == ["2", "1"]:
        types[fields[0]] += " full"
    elif word in ("MP", "MPDATA"):
        _take_constant(found, word, fields, constants)
    elif word in ("D", "F"):
        _take_on_node(found, word, fields)
    elif word in _LEFT:
        found.left[word] += 1


def _take_nodes(found: Translated, _: list[str], __: dict[str, str], rows: Iterator[str]) -> None:
    ints, width, size = map(int, re.findall(r"(\d+)[iI](\d+),\d+[eE](\d+)", next(rows))[0])
    for row in rows:
        if not row[:width].strip().isdigit():
            return
        start = ints * width
        values = [row[start + i * size : start + (i + 1) * size].strip() or "0" for i in range(6)]
        found.nodes.append(f"{row[:width].strip()}, {', '.join(values[:3])}")
        if any(map(float, values[3:])):
            found.left["nodes with axes of their own"] += 1


def _take_types(_: Translated, __: list[str], types: dict[str, str], rows: Iterator[str]) -> None:
    """Take element types with their options, of newer archives."""
    widths = re.findall(r"i(\d+),\d+a(\d+)", next(rows).lower())[0]
    for row in rows:
        number, *fields = _fixed(row, int(widths[0]))
        if number == "-1":
            return
        types[number] = fields[0] + (" full" if fields[2:3] == ["1"] else "")


def _take_elements(
    found: Translated, fields: list[str], types: dict[str, str], rows: Iterator[str]
) -> None:
    if fields[:2] != ["19", "SOLID"]:
        raise ValueError("it is not of the form 19,SOLID; write the archive by CDWRITE,DB")
    width = int(re.findall(r"[iI](\d+)", next(rows))[0])
    for row in rows:
        numbers = _fixed(row, width)
        if numbers[0] == "-1":
            return
        nodes = numbers[11:]
        while len(nodes) < int(numbers[8]):
            nodes += _fixed(next(rows), width)
        _take_cell(found, types[numbers[1]], f"MAT_{numbers[0]}", numbers[10], nodes)


def _fixed(row: str, width: int) -> list[str]:
    return [row[i : i + width].strip() for i in range(0, len(row.rstrip()), width)]


def _take_cell(found: Translated, kind: str, region: str, number: str, nodes: list[str]) -> None:
    name, _, full = kind.partition(" ")
    if name not in (*_HEX, *_TET):
        found.left[f"elements of type {name}"] += 1
        return
    found.sections[region] = region
    if name in _HEX and nodes[4] == nodes[5] and nodes[2] != nodes[3]:
        raise ValueError(
            f"element {number} is a pyramid; mesh with hexahedra, wedges or tetrahedra"
        )
    if name in _HEX and nodes[2] == nodes[3]:
        places = _TETRAHEDRON if nodes[4] == nodes[5] else _WEDGE
        nodes = [nodes[i] for i in places if i < len(nodes)]
    if "0" in nodes:
        raise ValueError(f"element {number} lacks midside nodes; give it all, or none")
    integration = "R" if len(nodes) == 20 and not full else ""
    found.elements[f"C3D{len(nodes)}{integration}", region].append([number, *nodes])


def _take_component(
    found: Translated, fields: list[str], _: dict[str, str], rows: Iterator[str]
) -> None:
    """Take a component of nodes; a negative number ends a range."""
    width, count = int(re.findall(r"[iI](\d+)", next(rows))[0]), int(fields[2])
    numbers: list[int] = []
    while len(numbers) < count:
        numbers += map(int, _fixed(next(rows), width))
    if not fields[1].startswith("NODE"):
        found.left[f"component {fields[0]} of elements"] += 1
        return
    own = found.groups[fields[0]]
    for one in numbers:
        own += [str(one)] if one > 0 else [str(i) for i in range(int(own[-1]) + 1, 1 - one)]


def _take_constant(
    found: Translated, word: str, fields: list[str], constants: dict[str, dict[str, str]]
) -> None:
    label, name, value, *more = fields if word == "MP" else (*fields[2:4], *fields[5:])
    own = constants.setdefault(f"MAT_{int(name)}", {})
    if label in _CONSTANTS:
        own[_CONSTANTS[label]] = value
        found.left[f"{label} at further temperatures"] += any(
            each != value for each in more if each
        )
    elif label == "EY":
        found.left["orthotropic constants"] += 1


def _take_on_node(found: Translated, word: str, fields: list[str]) -> None:
    node, label, value = fields[:3]
    if word == "F":
        found.loads.append(f"{node}, {_FREEDOMS[label]}, {value}")
        return
    for way in _FREEDOMS.get(label, ""):
        found.held[way].append(node)
    found.left["D with a motion that is not 0"] += float(value or 0) != 0.0


_BLOCKS = {
    "ETBLOCK": _take_types,
    "NBLOCK": _take_nodes,
    "EBLOCK": _take_elements,
    "CMBLOCK": _take_component,
}
