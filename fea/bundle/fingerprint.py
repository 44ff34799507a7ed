"""The fingerprint of a component: a hash of all that can change an answer.

Rows of a table carry it, so that rows of an older set-up are never mixed in. The title, the load
range and the tolerance are left out because they change no solve; so is every version number.
A key added to the format enters only if it is not at its default: older fingerprints stay valid.
"""

from __future__ import annotations

import hashlib
import json
import re
from pathlib import Path

import numpy as np

from wrenchbook.fea.mesh.io.abaqus_cases import HELD_IN, WITH_FORCES, drops_nodes
from wrenchbook.fea.spec.deck_text import deck_text
from wrenchbook.fea.spec.keys import keys_of
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
    Bolt,
    Bundle,
    Deck,
    Interface,
    Joint,
    Supports,
    Tie,
)

DIGITS = 16  # hexadecimal: two of a million set-ups coincide with a probability of 3e-8

NONLINEAR_SOLVER = "converged in energy; tangent at the equilibrium"
"""The kind of the embedded solver's nonlinear answers: new words whenever these answers change.

Linear components, decks and measured tables do not depend on it.
"""

CASE = "nodes of the last case"
"""The kind of groups of single nodes of a deck whose cases have different nodes."""

_FOLLOWING = re.compile(r"^[ \t]*\*[ \t]*(EQUATION|MPC)\b", re.I | re.M)
"""Keywords by which nodes of a mesh follow others."""


def fingerprint(bundle: Bundle) -> str:
    """Return 16 hexadecimal digits for a bundle; its own `fingerprint` has no effect.

    Raises OSError if a file of the bundle cannot be read, MeshFileError as `deck_text`.
    """
    further = {scalar.name: scalar for scalar in bundle.further}
    heated = TEMPERATURE in further
    analysis = bundle.analysis
    content = {
        "mesh": _mesh(bundle.mesh),
        "materials": sorted((_material(each, heated) for each in bundle.materials), key=json.dumps),
        "supports": _supports(bundle.supports),
        "interface": _interfaces(bundle.interfaces),
        "analysis": {"nonlinear": analysis.nonlinear, "integration": analysis.integration},
        "deck": _deck(bundle.deck),
    }

    # Densities act only by weight.
    densities = sorted((material.region, material.density or 0.0) for material in bundle.materials)
    if analysis.gravity is not None:
        content["weight"] = {"gravity": analysis.gravity, "densities": densities}
    if ACCELERATIONS[0] in further:
        content["acceleration"] = densities

    if analysis.nonlinear and bundle.mesh is not None and bundle.deck is None:
        content["solver"] = NONLINEAR_SOLVER
    if heated:
        field = further[TEMPERATURE].field
        file = {} if field is None else {"field": _file_hash(field)}
        content["inputs"] = {"temperature": further[TEMPERATURE].reference} | file

    # The order of ties counts: a node of two ties follows the first.
    if bundle.ties:
        content["ties"] = [_text(tie) for tie in bundle.ties]
    if bundle.joints:
        content["joints"] = sorted(map(_text, bundle.joints))
    if bundle.bolts:
        content["bolts"] = sorted(map(_text, bundle.bolts))
        content["zero"] = analysis.zero

    if _depends_on_cases(bundle):
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
    """Return the keys of a group by geometry: those that are given, and four always."""
    if isinstance(choice, BodySelector):
        return {"numbers": choice.bodies, "near": choice.near, "plane": None, "radius": None}
    keys = {name: getattr(choice, name) for name in keys_of(FaceSelector)}
    keys["numbers"] = keys.pop("faces")
    at = keys.pop("at")
    if (plane := choice.plane) is not None:
        keys["plane"] = ("xyz".index(plane) if isinstance(plane, str) else plane, at)
    if choice.cylinder is not None:
        keys["cylinder"] = (choice.cylinder.point, choice.cylinder.axis)
    always = "plane", "radius"
    return {name: value for name, value in keys.items() if value is not None or name in always}


def _depends_on_cases(bundle: Bundle) -> bool:
    """Return whether a group is of single nodes of a deck that its last case may lack."""
    source = bundle.mesh
    if source is None or source.file is None or source.file.suffix.lower() != ".inp":
        return False
    groups = [interface.section for interface in bundle.interfaces]
    if (supports := bundle.supports) is not None:
        groups += supports.fixed
        groups += [support.group for support in (*supports.sliding, *supports.bushings)]
    of_single_nodes = any(group.startswith((HELD_IN, WITH_FORCES)) for group in groups)
    return of_single_nodes and drops_nodes(deck_text(source.file))


def _material(material: AnyMaterial, heated: bool) -> list[object]:
    """Return a material's law, without its yield strength and density."""
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
    """Return the supports without their order, which changes nothing."""
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


def _interfaces(interfaces: tuple[Interface, ...]) -> object:
    """Return the content of the interface, or of several by their names."""
    if len(interfaces) > 1:
        return [{"name": interface.name, "is": _interface(interface)} for interface in interfaces]
    return _interface(interfaces[0]) if interfaces else None


def _interface(interface: Interface) -> object:
    """Return section, point and coupling, without the name."""
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


def _text(part: Tie | Bolt | Joint) -> str:
    """Return all fields of a tie, bolt or joint as JSON."""
    return json.dumps(vars(part), default=np.ndarray.tolist)


def _file_hash(path: Path) -> str:
    """Return the SHA-256 of a file's content in hexadecimal digits."""
    return hashlib.sha256(path.read_bytes()).hexdigest()
