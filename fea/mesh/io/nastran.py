"""A Nastran bulk data file (.bdf, .dat, .nas) as an Abaqus deck.

meshio reads such meshes too, but leaves out large-field elements and coordinate systems without a
word, and knows no materials, constraints and rigid elements.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator

from wrenchbook.fea.mesh.io.raw import MeshFileError
from wrenchbook.fea.mesh.io.translated import Translated

_SOLIDS = {
    ("CHEXA", 8): "C3D8",
    ("CHEXA", 20): "C3D20R",
    ("CPENTA", 6): "C3D6",
    ("CPENTA", 15): "C3D15",
    ("CTETRA", 4): "C3D4",
    ("CTETRA", 10): "C3D10",
}
# Nastran has the midside nodes of upright edges before those of the upper face.
_ORDER = {
    "C3D20R": [*range(12), *range(16, 20), *range(12, 16)],
    "C3D15": [*range(9), *range(12, 15), *range(9, 12)],
}
_QUIET = {"PARAM", "ENDDATA", "LOAD", "SPCADD", "CORD2R"}
_EXPONENT = re.compile(r"(?<=[\d.])([+-]\d+)$")


def read_nastran(text: str) -> Translated:
    """Return what a bulk data file holds: regions PSOLID_1, groups RBE2_7, all SPC sets.

    Raises
    ------
    MeshFileError
        If a card cannot be read, or nodes are in a coordinate system of their own.
    """
    bulk = re.split(r"^\s*BEGIN\s+BULK.*$", text, maxsplit=1, flags=re.I | re.M)
    found = Translated(
        nonlinear=bool(re.search(r"^\s*SOL\s+(106|400|600)\b", bulk[0], re.I | re.M))
    )
    skipped = text.count("\n") - bulk[-1].count("\n")
    for number, name, fields in _cards(bulk[-1].splitlines(), skipped):
        taker = _TAKERS.get(name)
        try:
            if taker is not None:
                taker(found, name, fields)
            elif name not in _QUIET:
                found.left[name] += 1
        except (ValueError, LookupError) as error:
            raise MeshFileError(f"line {number}: {name} cannot be read ({error})") from None
    return found


def _cards(lines: list[str], skipped: int) -> Iterator[tuple[int, str, list[str]]]:
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
        if any(fields[count + 1 :]):
            raise MeshFileError(
                f"line {number}: has more than {count} fields; continue on a new line"
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
    return float(_EXPONENT.sub(r"e\1", field.upper().replace("D", "E") or "0"))


def _grid(found: Translated, _: str, fields: list[str]) -> None:
    if fields[1] not in ("", "0") or fields[5] not in ("", "0", "-1"):
        raise ValueError("it has a coordinate system of its own; write the file in the basic one")
    places = ", ".join(f"{_real(each):.12g}" for each in fields[2:5])
    found.nodes.append(f"{fields[0]}, {places}")
    _hold(found, [fields[0]], fields[6])


def _solid(found: Translated, name: str, fields: list[str]) -> None:
    nodes = [each for each in fields[2:] if each]
    kind = _SOLIDS.get((name, len(nodes)))
    if kind is None:
        raise ValueError(f"it has {len(nodes)} nodes; write all midside nodes, or none")
    nodes = [nodes[i] for i in _ORDER.get(kind, range(len(nodes)))]
    found.elements[kind, f"PSOLID_{fields[1] or fields[0]}"].append([fields[0], *nodes])


def _material(found: Translated, name: str, fields: list[str]) -> None:
    young, shear, ratio = (_real(each) for each in fields[1:4])
    if not fields[1]:
        young = 2 * shear * (1 + ratio)
    elif not fields[3] and shear:
        ratio = young / (2 * shear) - 1
    own = found.constants[f"{name}_{fields[0]}"]
    own["ELASTIC"] = f"{young:.9g}, {ratio:.9g}"
    further = {"DENSITY": _real(fields[4]), "EXPANSION": _real(fields[5])}
    own |= {word: f"{value:.9g}" for word, value in further.items() if value}


def _section(found: Translated, name: str, fields: list[str]) -> None:
    found.sections[f"{name}_{fields[0]}"] = f"MAT1_{fields[1]}"


def _hold(found: Translated, nodes: list[str], freedoms: str) -> None:
    for way in set(freedoms) & set("123456"):
        found.held[way] += nodes


def _listed(fields: list[str]) -> list[str]:
    """Return the numbers of a list, which may have THRU."""
    fields = [each.upper() for each in fields if each]
    if "THRU" not in fields:
        return fields
    return [str(i) for i in range(int(fields[0]), int(fields[2]) + 1)]


def _constraint(found: Translated, name: str, fields: list[str]) -> None:
    if name == "SPC1":
        _hold(found, _listed(fields[2:]), fields[1])
        return
    for node, freedoms, value in (fields[1:4], fields[4:7]):
        _hold(found, [node] if node else [], freedoms)
        found.left["SPC with a motion that is not 0"] += _real(value) != 0.0


def _rigid(found: Translated, name: str, fields: list[str]) -> None:
    nodes = _listed(fields[3:])
    if "." in nodes[-1]:  # the element's thermal expansion
        nodes.pop()
    if not set("123") <= set(fields[2]):
        found.left[f"{name} of some freedoms only"] += 1
        return
    found.tie(f"{name}_{fields[0]}", nodes, fields[1], "KINEMATIC")


def _mean(found: Translated, name: str, fields: list[str]) -> None:
    """Take an element of one weight; with UM the list ends, and the element is another."""
    weights = [each for each in fields[4:] if "." in each]
    if len(set(weights)) > 1 or "UM" in fields:
        found.left[f"{name} with several weights or UM"] += 1
        return
    nodes = [
        e for i, e in enumerate(fields[6:], 6) if e and "." not in e and "." not in fields[i - 1]
    ]
    found.tie(f"{name}_{fields[0]}", nodes, fields[2], "DISTRIBUTING")


def _load(found: Translated, name: str, fields: list[str]) -> None:
    if fields[2] not in ("", "0"):
        found.left[f"{name} in a coordinate system of its own"] += 1
        return
    first, size = (1 if name == "FORCE" else 4), _real(fields[3])
    values = ((first + i, size * _real(each)) for i, each in enumerate(fields[4:7]))
    found.loads += [f"{fields[1]}, {way}, {value:.9g}" for way, value in values if value]


_TAKERS: dict[str, Callable[[Translated, str, list[str]], None]] = {
    "GRID": _grid,
    **dict.fromkeys(("CHEXA", "CPENTA", "CTETRA"), _solid),
    "MAT1": _material,
    "PSOLID": _section,
    **dict.fromkeys(("SPC", "SPC1"), _constraint),
    "RBE2": _rigid,
    "RBE3": _mean,
    **dict.fromkeys(("FORCE", "MOMENT"), _load),
}
