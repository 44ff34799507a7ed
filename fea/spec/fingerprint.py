"""The fingerprint of a component: a hash of all that can change an answer.

Rows of a table carry it, so that rows of an older set-up are never mixed in. The title, the load
range and the tolerance are left out because they change no solve; so is every version number.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from wrenchbook.fea.spec.deck_text import deck_text
from wrenchbook.fea.spec.material import AnyMaterial, Orthotropic
from wrenchbook.fea.spec.mesh_source import (
    CELLS_ROUND_A_CIRCLE,
    BodySelector,
    FaceSelector,
    MeshFile,
    MeshSource,
)
from wrenchbook.fea.spec.schema import (
    ACCELERATIONS,
    TEMPERATURE,
    Analysis,
    Deck,
    Interface,
    Supports,
)

DIGITS = 16

NONLINEAR_SOLVER = "converged in energy; tangent at the equilibrium"
"""What the embedded solver's nonlinear answers are, in words that change when the answers do.

Before these words its tangents were those of the state before the last correction: up to a third
off on a slender part. Linear components, decks and measured tables never had other answers, so
their fingerprints hold no such words.
"""

CASE = "nodes of the last case"
"""What groups of single nodes of a deck with several load cases are, in words as above.

Before these words they were the nodes of all cases together.
"""

_FOLLOWING = re.compile(r"^[ \t]*\*[ \t]*(EQUATION|MPC)\b", re.I | re.M)
"""Keywords by which nodes of a mesh follow others; before, they moved freely."""

_RESTRICTING = ("box", "normal", "angle", "inside")
_GROUP = re.compile(r'"nodes_(?:held_in|with_forces)')  # of `fea.mesh.io.abaqus_content`
_KEYWORD = re.compile(rb"^[^\w*\n]*\*[ \t]*(BOUNDARY|CLOAD|STEP|LOAD CASE)\b([^*]*)", re.I | re.M)
_NEW = re.compile(rb",\s*(?:OP\s*=\s*NEW|PERTURBATION)\b", re.I)
# Decks whose last case does not have the nodes of all cases. Each keyword of a deck is one letter:
# b of *BOUNDARY and *CLOAD, s of *STEP, l of *LOAD CASE; a capital where `_NEW` drops what came
# before.
_RELEASED_LATER = "[bB].*[sSl].*B"  # *BOUNDARY, *STEP, *BOUNDARY, OP=NEW
_PERTURBED_LATER = "[sl].*S"  # *STEP, *STEP, PERTURBATION
_PERTURBED_BEFORE = "S.*[sSl]"  # *STEP, PERTURBATION, *STEP
_LOAD_CASES = "l.*l"  # *LOAD CASE, *LOAD CASE
_DROPS_NODES = re.compile(
    "|".join((_RELEASED_LATER, _PERTURBED_LATER, _PERTURBED_BEFORE, _LOAD_CASES))
)


def fingerprint(parts: Mapping[str, Any]) -> str:
    """Return 16 hexadecimal digits for the parts of a bundle.

    parts: the fields of `fea.spec.schema.Bundle` that can change an answer; others are not looked
    at.
    """
    further = {scalar.name: scalar for scalar in parts.get("further", ())}
    heated = TEMPERATURE in further
    materials = sorted((_material(each, heated) for each in parts["materials"]), key=json.dumps)
    analysis: Analysis = parts["analysis"]
    content = {
        "mesh": _mesh(parts["mesh"]),
        "materials": materials,
        "supports": _supports(parts["supports"]),
        "interface": _interface(parts["interface"]),
        "analysis": {"nonlinear": analysis.nonlinear, "integration": analysis.integration},
        "deck": _deck(parts["deck"]),
    }

    if parts["others"]:
        content["interface"] = [
            {"name": interface.name, "is": _interface(interface)}
            for interface in (parts["interface"], *parts["others"])
        ]
    densities = sorted(
        (material.region, material.density or 0.0) for material in parts["materials"]
    )

    if analysis.gravity is not None:
        content["weight"] = {"gravity": analysis.gravity, "densities": densities}
    if analysis.nonlinear and parts["mesh"] is not None and parts["deck"] is None:
        content["solver"] = NONLINEAR_SOLVER
    if heated:
        content["inputs"] = {"temperature": further[TEMPERATURE].reference}
        if (field := further[TEMPERATURE].field) is not None:
            content["inputs"]["field"] = _file_hash(field)
    if ACCELERATIONS[0] in further:
        content["acceleration"] = densities

    for name in filter(parts.get, ("ties", "bolts", "joints")):
        texts = [json.dumps(vars(each), default=np.ndarray.tolist) for each in parts[name]]
        content[name] = texts if name == "ties" else sorted(texts)  # the first tie takes a node
    if "bolts" in content:
        content["zero"] = analysis.zero

    if _names_nodes_of_cases(parts["mesh"], [content["supports"], content["interface"]]):
        content["case"] = CASE

    # json writes floats by repr, so equal numbers give equal text and different ones do not.
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()[:DIGITS]


def _mesh(source: MeshSource | None) -> object:
    """Return all of ``[mesh]`` that changes the mesh: files by their bytes, not their names."""
    if source is None:
        return None
    if source.file is not None:
        # The ending chooses the reader; the rest of the name changes nothing.
        content: dict[str, object] = {"file": _file_hash(source.file), "ending": source.file.suffix}
        text = deck_text(source.file)
        if included := text.included:
            content["included"] = [_file_hash(file) for file in included]
        if source.file.suffix.lower() == ".inp" and _FOLLOWING.search(text):
            content["follow"] = True
        if source.geometry is not None:
            meshing = source.geometry
            keys: dict[str, object] = {
                "size": meshing.size,
                "curvature": meshing.curvature or 0,
                "groups": {name: _chosen(each) for name, each in meshing.groups.items()},
                "regions": {name: _chosen(each) for name, each in meshing.regions.items()},
            }
            if meshing.circle != CELLS_ROUND_A_CIRCLE:
                keys["circle"] = meshing.circle
            return content | {"geometry": keys}
        content["unit"] = source.unit
        if source.order is not None:
            content["order"] = source.order
        if isinstance(source, MeshFile) and source.groups:
            content["groups"] = {name: _chosen(each) for name, each in source.groups.items()}
        return content
    return {"generator": source.generator, "parameters": dict(source.parameters or {})}


def _chosen(choice: FaceSelector | BodySelector) -> object:
    """Return the keys of a group by geometry; those added to the format later only if given."""
    if isinstance(choice, BodySelector):
        return {"numbers": choice.bodies, "near": choice.near, "plane": None, "radius": None}
    plane = choice.plane
    if plane is not None:
        plane = ("xyz".index(plane) if isinstance(plane, str) else plane, choice.at)
    cylinder = choice.cylinder and (choice.cylinder.point, choice.cylinder.axis)
    newer = [("cylinder", cylinder), *((key, getattr(choice, key)) for key in _RESTRICTING)]
    keys = {"numbers": choice.faces, "near": choice.near, "plane": plane, "radius": choice.radius}
    return keys | {key: value for key, value in newer if value is not None}


def _names_nodes_of_cases(source: MeshSource | None, groups: object) -> bool:
    """Return whether a group is of single nodes of a deck whose cases are no sum of each other."""
    if source is None or source.file is None or source.file.suffix.lower() != ".inp":
        return False
    if not _GROUP.search(json.dumps(groups)):
        return False
    text = deck_text(source.file).encode(errors="replace")
    initials = ""
    for word, more in _KEYWORD.findall(text):
        initial = word[:1].decode().lower().replace("c", "b")
        initials += initial.upper() if _NEW.search(more) else initial
    return _DROPS_NODES.search(initials) is not None


def _material(material: AnyMaterial, heated: bool) -> list[object]:
    """Return a material's law, without yield strength, and densities, hashed where they act."""
    content: list[object] = [material.region, material.youngs_modulus, material.poisson_ratio]
    if material.law != "isotropic":
        content.append(material.law)
    if isinstance(material, Orthotropic):
        constants = {
            "youngs_moduli": material.youngs_moduli,
            "poisson_ratios": material.poisson_ratios,
            "shear_moduli": material.shear_moduli,
            "axes": material.axes.tolist(),
        }
        if material.cylinder is not None:
            constants["cylinder"] = (material.cylinder.point, material.cylinder.axis)
        content.append(constants)
    return [*content, material.thermal_expansion] if heated else content


def _supports(supports: Supports | None) -> object:
    """Return the supports without their order, which changes nothing.

    Sliding ones and bushings are left out if there are none: fingerprints of before stay valid.
    """
    if supports is None or not (supports.sliding or supports.bushings):
        return None if supports is None else sorted(supports.fixed)
    return {
        "fixed": sorted(supports.fixed),
        "sliding": sorted(
            [support.group, support.directions.tolist()] for support in supports.sliding
        ),
        "bushings": sorted(
            (
                [_interface(item.end(item.group)), item.stiffness.tolist()]
                for item in supports.bushings
            ),
            key=json.dumps,
        ),
    }


def _interface(interface: Interface | None) -> object:
    """Return section, point and coupling; no name, which is hashed where there are several.

    Weights by area are left out: fingerprints from before there were others stay valid.
    """
    if interface is None:
        return None
    point = None if interface.point is None else interface.point.tolist()
    weights = {} if interface.weights == "area" else {"weights": interface.weights}
    return weights | {
        "section": interface.section,
        "point": point,
        "axes": interface.axes.tolist(),
        "coupling": interface.coupling,
        "locked": list(interface.locked),
    }


def _deck(deck: Deck | None) -> object:
    """Return files, command and units; no timeout, which changes no answer, and no deck's name."""
    if deck is None:
        return None
    return {
        "file": _file_hash(deck.file),
        "files": {file.name: _file_hash(file) for file in deck.files},
        "command": list(deck.command),
        "output": dict(deck.output),
        "unit": deck.unit,
        "moment": deck.moment,
    }


def _file_hash(path: Path) -> str:
    """Return the SHA-256 of a file's content in hexadecimal digits."""
    return hashlib.sha256(path.read_bytes()).hexdigest()
