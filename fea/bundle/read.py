"""Reading a component bundle: a folder with ``component.toml`` and the files it names.

Every key is checked and every mistake reported, all at once. Nothing here builds a mesh, so the
web process can read bundles too.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from wrenchbook.fea.bundle.deck_table import read_deck
from wrenchbook.fea.bundle.inputs_table import check_densities, check_inputs, read_inputs
from wrenchbook.fea.bundle.mesh_table import read_mesh
from wrenchbook.fea.bundle.tables import (
    read_analysis,
    read_interfaces,
    read_material,
    read_name,
    read_range,
    read_supports,
    read_tolerance,
)
from wrenchbook.fea.mesh.deck_content import deck_text, integrations
from wrenchbook.fea.spec.fingerprint import fingerprint
from wrenchbook.fea.spec.problems import BundleError, BundleProblem
from wrenchbook.fea.spec.schema import (
    MOST_INPUTS,
    Analysis,
    Bundle,
    Deck,
    Interface,
    Material,
    MeshSource,
    Supports,
)
from wrenchbook.fea.spec.toml_table import Keys

__all__ = [
    "Analysis",
    "Bundle",
    "BundleError",
    "BundleProblem",
    "Deck",
    "Interface",
    "Material",
    "MeshSource",
    "Supports",
    "bundle_of",
    "read_bundle",
]

FILE_NAME = "component.toml"

_LINE = re.compile(r"\(at line (\d+), column (\d+)\)")
_MOST_BYTES = 256 * 1024  # hundreds of faces chosen by number, of a geometry file
# Begins where a word does, so that a long word is looked at once.
_LONG_KEY = re.compile(rb"""(?<![\w"'-])(?:[\w"'-]+[ \t]*\.[ \t]*){32}""")
_OR_HELD = ", or held = true in one [[interface]]: its reaction then balances the loads"
_SOLVER_TABLES = ("material", "supports", "interface", "analysis")


def read_bundle(folder: str | Path) -> Bundle:
    """Read the bundle in `folder`.

    Raises
    ------
    BundleError
        If the folder has no ``component.toml`` or anything in it will not do; its `problems` name
        every mistake by key or line.
    """
    folder = Path(folder)
    path = folder / FILE_NAME
    content = _short(path)
    try:
        table = tomllib.loads(content.decode("utf-8"))
    except UnicodeDecodeError as error:
        line = content[: error.start].count(b"\n") + 1
        message = "is not UTF-8 text; save the file as UTF-8"
        raise BundleError([BundleProblem(f"line {line}", message)]) from None
    except (ValueError, RecursionError) as error:
        raise BundleError([_syntax_problem(error)]) from None
    return bundle_of(table, folder)


def bundle_of(table: Mapping[str, Any], folder: str | Path) -> Bundle:
    """Check a parsed ``component.toml``; `folder` holds the files it names.

    Raises
    ------
    BundleError
        As `read_bundle` does.
    """
    folder = Path(folder)
    top = Keys(table, [])
    parts: dict[str, Any] = {
        "name": read_name(top),
        "title": top.text("title"),
        "mesh": read_mesh(top.table("mesh", required=False), folder),
        "materials": tuple(read_material(keys) for keys in top.tables("material", required=False)),
        "supports": read_supports(top.table("supports", required=False)),
    }
    found = read_interfaces(top)
    interfaces = [interface for interface, _ in found]
    parts |= {
        "interface": interfaces[0] if interfaces else None,
        "others": tuple(interfaces[1:]),
        "analysis": read_analysis(top.table("analysis", required=False), _of_deck(parts["mesh"])),
        "range": read_range(top, found),
        "further": read_inputs(top, folder),
        "tolerance": read_tolerance(top.table("tolerance", required=False)),
        "deck": read_deck(top.table("deck", required=False), folder),
    }
    # Tables that need each other; an interface that is held stands in for supports.
    held = any(one is not None and one.held for one in interfaces)
    if "deck" not in top:
        if "mesh" in top:
            for key in _SOLVER_TABLES:
                if key not in top and not (held and key == "supports"):
                    brackets = "[[material]]" if key == "material" else f"[{key}]"
                    more = _OR_HELD if key == "supports" and top.is_array("interface") else ""
                    top.wrong(key, f"missing; a component with a [mesh] needs {brackets}{more}")
        else:
            for key in _SOLVER_TABLES:
                if key in top and not (key == "interface" and top.is_array(key)):
                    top.wrong(
                        key, "needs a [mesh] as well; without one a component is a table only"
                    )
    _check_frame(top, parts["deck"], interfaces)
    _check_weight(top, parts["deck"], parts["materials"], parts["analysis"])
    check_inputs(top, parts["further"], parts["materials"], interfaces)
    # A range whose corners are too many to look at each.
    loads = parts["range"]
    if loads is not None:
        vary = len(parts["further"]) + sum(
            a < b for a, b in zip(loads.low, loads.high, strict=True)
        )
        if vary > MOST_INPUTS:
            message = f"{vary} inputs vary, and {MOST_INPUTS} may; give some loads the range 0"
            top.wrong("interface", message)
    top.close()
    if top.problems:
        raise BundleError(top.problems)
    return Bundle(folder=folder, fingerprint=fingerprint(parts), **parts)


def _of_deck(source: MeshSource | None) -> list[str]:
    """Return the integrations that an input deck has for its 20-node hexahedra."""
    if source is None or source.file is None or source.file.suffix.lower() != ".inp":
        return []
    return integrations(deck_text(source.file))


def _short(path: Path) -> bytes:
    """Return the file, if no parser needs more for it than its length.

    Raises
    ------
    BundleError
        If it cannot be read, is longer than a component can say, or has a key of many parts: the
        parser keeps the path to each part of a key, 23 GB for one of 100,000.
    """
    try:
        with path.open("rb") as file:
            content = file.read(_MOST_BYTES + 1)
    except OSError as error:
        message = f"cannot be read ({error.strerror}); a bundle is a folder with this file"
        raise BundleError([BundleProblem(FILE_NAME, message)]) from None
    if len(content) > _MOST_BYTES:
        message = f"is longer than {_MOST_BYTES} bytes; a component.toml names its files by name"
        raise BundleError([BundleProblem(FILE_NAME, message)])
    found = _LONG_KEY.search(content)
    if found:
        line = content[: found.start()].count(b"\n") + 1
        message = "has a name of more than 32 parts with dots between them; no key has so many"
        raise BundleError([BundleProblem(f"line {line}", message)])
    return content


def _syntax_problem(error: Exception) -> BundleProblem:
    found = _LINE.search(str(error))
    if found is None:
        return BundleProblem(FILE_NAME, f"is not valid TOML: {error}")
    message = f"not valid TOML: {_LINE.sub('', str(error)).strip()} (column {found[2]})"
    return BundleProblem(f"line {found[1]}", message)


def _check_frame(top: Keys, deck: Deck | None, interfaces: list[Interface | None]) -> None:
    """Note what an [interface] says that a deck would not heed."""
    if deck is None or not interfaces or interfaces[0] is None:
        return
    if len(interfaces) > 1:
        top.wrong("interface", "a [deck] has one interface; several are the embedded solver's")
        return
    interface = interfaces[0]
    if (interface.axes != np.eye(3)).any():
        message = "a [deck] is not turned; write it in the interface frame and leave axes out"
        top.wrong("interface.axes", message)
    if interface.locked:
        message = "a [deck] is not changed; hold these freedoms in the deck and leave locked out"
        top.wrong("interface.locked", message)


def _check_weight(
    top: Keys, deck: Deck | None, materials: tuple[Material | None, ...], analysis: Analysis
) -> None:
    """Note what the component's own weight lacks."""
    if analysis.gravity is None:
        return
    if deck is not None:
        message = "a [deck] is not changed; write *DLOAD with GRAV in the deck, leave gravity out"
        top.wrong("analysis.gravity", message)
    check_densities(top, materials, "[analysis] gravity")
