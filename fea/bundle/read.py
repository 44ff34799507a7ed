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

from wrenchbook.fea.bundle.mesh_table import read_mesh
from wrenchbook.fea.bundle.tables import (
    check_densities,
    check_inputs,
    read_analysis,
    read_deck,
    read_inputs,
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
    try:
        with path.open("rb") as file:
            content = file.read(_MOST_BYTES + 1)
    except OSError as error:
        folder_is = f"{folder} is no folder" if not folder.is_dir() else f"not in {folder}"
        message = f"cannot be read ({error.strerror}: {folder_is}); name a folder with this file"
        raise BundleError([BundleProblem(FILE_NAME, message)]) from None
    if len(content) > _MOST_BYTES:
        message = f"is longer than {_MOST_BYTES} bytes; a component.toml names its files by name"
        raise BundleError([BundleProblem(FILE_NAME, message)])
    # The parser keeps the path to each part of a key: 23 GB for one of 100,000 parts.
    if long_key := _LONG_KEY.search(content):
        line = content[: long_key.start()].count(b"\n") + 1
        message = "has a name of more than 32 parts with dots between them; no key has so many"
        raise BundleError([BundleProblem(f"line {line}", message)])
    try:
        table = tomllib.loads(content.decode("utf-8"))
    except UnicodeDecodeError as error:
        line = content[: error.start].count(b"\n") + 1
        message = "is not UTF-8 text; save the file as UTF-8"
        raise BundleError([BundleProblem(f"line {line}", message)]) from None
    except (ValueError, RecursionError) as error:
        if (at := _LINE.search(str(error))) is None:
            problem = BundleProblem(FILE_NAME, f"is not valid TOML: {error}")
        else:
            message = f"not valid TOML: {_LINE.sub('', str(error)).strip()} (column {at[2]})"
            problem = BundleProblem(f"line {at[1]}", message)
        raise BundleError([problem]) from None
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
    # The integrations that an input deck has for its 20-node hexahedra.
    source: MeshSource | None = parts["mesh"]
    file = source.file if source is not None else None
    of_deck = []
    if file is not None and file.suffix.lower() == ".inp":
        of_deck = integrations(deck_text(file))
    pairs = read_interfaces(top)
    interfaces = [interface for interface, _ in pairs]
    parts |= {
        "interface": interfaces[0] if interfaces else None,
        "others": tuple(interfaces[1:]),
        "analysis": read_analysis(top.table("analysis", required=False), of_deck),
        "range": read_range(top, pairs),
        "further": read_inputs(top, folder),
        "tolerance": read_tolerance(top.table("tolerance", required=False)),
        "deck": read_deck(top.table("deck", required=False), folder),
    }
    _check_tables(top, any(attached is not None and attached.held for attached in interfaces))
    if parts["deck"] is not None:
        _check_deck(top, parts["analysis"], interfaces)
    if parts["analysis"].gravity is not None:
        check_densities(top, parts["materials"], "[analysis] gravity")
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


def _check_tables(top: Keys, held: bool) -> None:
    """Note tables that need each other; an interface that is held stands in for supports."""
    if "deck" in top:
        return
    if "mesh" in top:
        for key in _SOLVER_TABLES:
            if key not in top and not (held and key == "supports"):
                brackets = "[[material]]" if key == "material" else f"[{key}]"
                more = _OR_HELD if key == "supports" and top.is_array("interface") else ""
                top.wrong(key, f"missing; a component with a [mesh] needs {brackets}{more}")
    else:
        for key in _SOLVER_TABLES:
            if key in top and not (key == "interface" and top.is_array(key)):
                top.wrong(key, "needs a [mesh] as well; without one a component is a table only")


def _check_deck(top: Keys, analysis: Analysis, interfaces: list[Interface | None]) -> None:
    """Note what the other tables say that a deck would not heed."""
    if len(interfaces) > 1:
        top.wrong("interface", "a [deck] has one interface; several are the embedded solver's")
    interface = interfaces[0] if len(interfaces) == 1 else None
    if interface is not None and (interface.axes != np.eye(3)).any():
        message = "a [deck] is not turned; write it in the interface frame and leave axes out"
        top.wrong("interface.axes", message)
    if interface is not None and interface.locked:
        message = "a [deck] is not changed; hold these freedoms in the deck and leave locked out"
        top.wrong("interface.locked", message)
    if analysis.gravity is not None:
        message = "a [deck] is not changed; write *DLOAD with GRAV in the deck, leave gravity out"
        top.wrong("analysis.gravity", message)
