"""Reading a component bundle: a folder with ``component.toml`` and the files it names.

Every key is checked, and all mistakes are reported at once. This module builds no mesh, so the web
process can read bundles too.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np

from wrenchbook.fea.bundle.fingerprint import fingerprint
from wrenchbook.fea.bundle.tables import ComponentFile, MaterialTable
from wrenchbook.fea.mesh.deck_content import integrations
from wrenchbook.fea.mesh.generators import GENERATORS
from wrenchbook.fea.readers import reader_named, reader_names
from wrenchbook.fea.spec.deck_text import deck_text
from wrenchbook.fea.spec.keys import (
    keys_of,
    kind_of,
    missing,
    not_single,
    shown,
    unknown,
    validate,
)
from wrenchbook.fea.spec.material import EXPANDING, AnyMaterial
from wrenchbook.fea.spec.mesh_source import Generator, MeshFile, MeshSource
from wrenchbook.fea.spec.problems import BundleError, BundleProblem, MeshFileError, suggest
from wrenchbook.fea.spec.schema import (
    ACCELERATIONS,
    ALL_INPUTS,
    FREEDOMS,
    MAX_INPUTS,
    RANGE_EXAMPLE,
    TEMPERATURE,
    Analysis,
    Bundle,
    Deck,
    DeclaredRange,
    Interface,
    MeasuredInterface,
    NamedInterface,
    ScalarInput,
)

__all__ = ["Bundle", "BundleError", "BundleProblem", "bundle_in", "bundle_of", "read_bundle"]

FILE_NAME = "component.toml"

_LINE = re.compile(r"\(at line (\d+), column (\d+)\)")  # place of a mistake in tomllib's messages
_END = "(at end of document)"  # place of a mistake if the file ends too early
_LONG = re.compile(r"(?<![0-9_])[0-9_]{4301}")  # an integer that Python refuses
_MAX_BYTES = 256 * 1024  # bytes: a geometry file with hundreds of faces chosen by number
# Begins at the start of a word, so that a long word is scanned once.
_LONG_KEY = re.compile(rb"""(?<![\w"'-])(?:[\w"'-]+[ \t]*\.[ \t]*){32}""")
_OR_HELD = ", or held = true in one [[interface]]: its reaction then balances the loads"
_SOLVER_TABLES = ("material", "supports", "interface", "analysis")


def read_bundle(folder: str | Path) -> Bundle:
    """Read the bundle in `folder`.

    Raises
    ------
    BundleError
        If the folder has no ``component.toml`` or anything in it cannot be used; its `problems`
        name every mistake by key or line.
    """
    return bundle_in(Path(folder) / FILE_NAME)


def bundle_in(path: Path) -> Bundle:
    """Read a bundle from a file like its ``component.toml``, in the folder of its other files.

    Raises
    ------
    BundleError
        As `read_bundle` does.
    """
    folder = path.parent
    try:
        with path.open("rb") as file:
            content = file.read(_MAX_BYTES + 1)
    except OSError as error:
        if not folder.exists():
            message = f"there is no folder {folder}; name one with this file"
        else:
            where = f"not in {folder}" if folder.is_dir() else f"{folder} is no folder"
            message = f"cannot be read ({error.strerror}: {where}); name a folder with this file"
        raise BundleError([BundleProblem(path.name, message)]) from None
    if len(content) > _MAX_BYTES:
        message = f"is longer than {_MAX_BYTES} bytes; move data into files that it names"
        raise BundleError([BundleProblem(path.name, message)])

    # The parser stores the path to each part of a key: 23 GB for a key of 100,000 parts.
    if long_key := _LONG_KEY.search(content):
        line = content[: long_key.start()].count(b"\n") + 1
        message = "has a dotted name of more than 32 parts, which no key has; shorten the name"
        raise BundleError([BundleProblem(f"line {line}", message)])
    try:
        table = tomllib.loads(content.decode("utf-8-sig"))  # some editors write a BOM
    except UnicodeDecodeError as error:
        line = content[: error.start].count(b"\n") + 1
        message = "is not UTF-8 text; save the file as UTF-8"
        raise BundleError([BundleProblem(f"line {line}", message)]) from None
    except RecursionError:
        message = "nests lists or tables too deeply, which no key does; remove the inner brackets"
        raise BundleError([BundleProblem(path.name, message)]) from None
    except ValueError as error:
        raise BundleError([_syntax_problem(str(error), content.decode("utf-8-sig"))]) from None
    return bundle_of(table, folder)


def _syntax_problem(reason: str, text: str) -> BundleProblem:
    """Return the place of a mistake in TOML, with the line as it is written."""
    lines = text.splitlines() or [""]
    at = _LINE.search(reason)
    if at is None and _END not in reason:  # Python's own refusal of a too long integer
        message = "has an integer of more than 4300 digits; write it with an exponent, such as 2e9"
        place = next((i for i, line in enumerate(lines, 1) if _LONG.search(line)), None)
        return BundleProblem(f"line {place}" if place else FILE_NAME, message)
    number, place = (int(at[1]), f"column {at[2]}") if at else (len(lines), "at its end")
    reason = reason.replace(at[0] if at else _END, "").strip()
    reason = reason.replace("Cannot overwrite a value", "a key is there twice")
    line = shown(lines[number - 1].strip())
    return BundleProblem(f"line {number}", f"is not valid TOML: {reason} ({place}); correct {line}")


def bundle_of(table: Mapping[str, Any], folder: str | Path) -> Bundle:
    """Check a parsed ``component.toml``; `folder` holds the files it names.

    Raises
    ------
    BundleError
        As `read_bundle` does.
    """
    reader = _Reader(table, Path(folder))
    bundle = reader.bundle()
    if reader.problems:
        raise BundleError(reader.problems)
    return replace(bundle, fingerprint=fingerprint(bundle))


class _Reader:
    """A parsed file on its way to a bundle, with the mistakes found so far.

    Tables are read in turn, so that contradictions between tables are noted even if others have
    mistakes.
    """

    def __init__(self, table: Mapping[str, Any], folder: Path) -> None:
        self.table = table
        self.folder = folder
        self.problems: list[BundleProblem] = []

    def wrong(self, where: str, message: str) -> None:
        """Note a mistake."""
        self.problems.append(BundleProblem(where, message))

    def read(self, name: str, kind: Any = None) -> Any:
        """Return a top-level key's value; None if it is missing or cannot be used."""
        if name not in self.table:
            return None
        if self.table[name] is None:
            self.wrong(name, "must not be null; leave the key out")
            return None
        kind = kind or kind_of(keys_of(ComponentFile)[name])
        return validate(kind, self.table[name], name, self.problems, self.folder)

    def read_each(self, name: str, kind: Any) -> list[Any]:
        """Return the values of an array of tables, None for each that cannot be used."""
        values = self.table.get(name, [])
        if type(values) is dict:
            self.wrong(name, not_single(name))
        elif type(values) is not list:
            self.wrong(name, f"must be a list, not {shown(values)}; write it in brackets: [...]")
        elif name in self.table and not values:
            self.wrong(name, f"is an empty list; write one or more tables, each under [[{name}]]")
        elif wrong := [i for i, each in enumerate(values) if type(each) is not dict]:
            value = shown(values[wrong[0]])
            self.wrong(f"{name}[{wrong[0]}]", f"must be a table under [[{name}]], not {value}")
        else:
            paths = [f"{name}[{i}]" for i in range(len(values))]
            pairs = zip(values, paths, strict=True)
            return [validate(kind, each, at, self.problems, self.folder) for each, at in pairs]
        return []

    @property
    def several(self) -> bool:
        """Whether the interfaces are an array of tables."""
        return isinstance(self.table.get("interface"), list)

    def bundle(self) -> Bundle:
        """Return the bundle without its fingerprint; parts with mistakes are None."""
        self.check_keys()
        mesh = self.mesh()
        materials = self.read_each("material", MaterialTable)
        analysis = self.analysis(mesh)
        interfaces = self.interfaces()
        loads = self.range(interfaces)
        inputs = self.read("inputs")
        further: tuple[ScalarInput, ...] = inputs.scalars if inputs is not None else ()

        self.check_tables()
        self.check_deck(analysis, interfaces)
        if analysis.gravity is not None:
            self.check_densities(materials, "[analysis] gravity")
        if analysis.zero != "preloaded" and "bolt" not in self.table:
            self.wrong("analysis.zero", "has no effect without a [[bolt]]; leave it out")
        self.check_inputs(further, materials, interfaces)
        if loads is not None:
            self.check_count(loads, further, len(interfaces))
        return Bundle(
            folder=self.folder,
            name=self.read("name"),
            title=self.read("title"),
            mesh=mesh,
            materials=tuple(materials),
            supports=self.read("supports"),
            ties=self.read("tie") or (),
            bolts=self.read("bolt") or (),
            joints=self.read("spring") or (),
            interface=interfaces[0] if interfaces else None,
            others=tuple(interfaces[1:]),
            analysis=analysis,
            range=cast("DeclaredRange", loads),
            further=further,
            tolerance=self.read("tolerance"),
            deck=self.deck(),
            fingerprint="",
        )

    def check_keys(self) -> None:
        """Note keys that are missing, unknown or without effect beside another key."""
        keys = keys_of(ComponentFile)
        for name, info in keys.items():
            if name not in self.table and info.is_required():
                self.wrong(name, missing(info))
        for name in self.table:
            if name not in keys:
                self.wrong(name, unknown(name, ComponentFile))
        if self.table.get("supports") == {}:
            message = "has no support; write fixed, [[supports.sliding]] or [[supports.bushing]]"
            self.wrong("supports", message)
        materials = self.table.get("material")
        for i, material in enumerate(materials if type(materials) is list else ()):
            if type(material) is dict and {"axes", "cylinder"} <= set(material):
                message = "contradicts cylinder, whose axes vary; leave one of the two out"
                self.wrong(f"material[{i}].axes", message)

    def mesh(self) -> MeshSource | None:
        """Return ``[mesh]``."""
        table = self.table.get("mesh")
        if type(table) is dict and "generator" in table:
            if "file" in table:
                message = 'give either "file" or "generator", not both; leave one of them out'
                self.wrong("mesh.generator", message)
                return None
            name = table["generator"]
            if type(name) is not str or name not in GENERATORS:
                near = suggest(name, GENERATORS) if type(name) is str else ""
                message = f"must be one of {', '.join(GENERATORS)}, not {shown(name)}{near}"
                self.wrong("mesh.generator", message)
                return None
        elif type(table) is dict and "file" not in table:
            near = {f"mesh.{name}": suggest(name, ("file", "generator")) for name in table}
            for at, suggestion in near.items():
                if suggestion:
                    self.wrong(at, f"is an unknown key; correct it{suggestion}")
            if not any(near.values()):
                self.wrong("mesh.file", missing(keys_of(MeshFile)["file"]))
            return None
        mesh = self.read("mesh")
        for at, message in mesh.mistakes() if isinstance(mesh, Generator) else ():
            self.wrong(f"mesh.{at}", message)
        return mesh

    def interfaces(self) -> list[Any]:
        """Return ``[interface]`` or every ``[[interface]]``; a measured part's have no section."""
        if "interface" not in self.table:
            return []
        if not self.several:
            return [self.read("interface", Interface)]
        if len(self.table["interface"]) == 1:
            message = "is a list of one; write [interface] without a name, or add another"
            self.wrong("interface", message)
            return [None]
        measured = "mesh" not in self.table and "deck" not in self.table
        interfaces = self.read_each("interface", MeasuredInterface if measured else NamedInterface)
        first_of: dict[str, int] = {}
        held = [i for i, interface in enumerate(interfaces) if interface and interface.held]
        for i, interface in enumerate(interfaces):
            if interface is not None and first_of.setdefault(interface.name, i) != i:
                there = f"interface[{first_of[interface.name]}]"
                message = f'repeats "{interface.name}" of {there}; give each a name of its own'
                self.wrong(f"interface[{i}].name", message)
        for i in held[1:]:
            message = f"interface[{held[0]}] is held already; write held = true under only one"
            self.wrong(f"interface[{i}].held", message)
        return interfaces

    def range(self, interfaces: list[Any]) -> DeclaredRange | None:
        """Return ``[range]``, or the ranges of several interfaces in their order."""
        several = interfaces if self.several else []
        if "range" in self.table and len(several) > 1:
            message = f"belongs under each [[interface]]; write there range = {RANGE_EXAMPLE}"
            self.wrong("range", message)
        if several:
            ranges = [interface and interface.range for interface in several]
        elif "range" in self.table:
            ranges = [self.read("range")]
            if ranges == [None]:
                return None
            if not np.any((*ranges[0].force, *ranges[0].moment)):
                self.wrong("range", f"has no load above 0; write for example {RANGE_EXAMPLE}")
        else:
            example = "force = [20, 20, 200] (N) and moment = [5, 5, 5] (N·m)"
            self.wrong("range", f"is missing; write [range] with, for example, {example}")
            return None
        none = ((0.0, 0.0),) * len(FREEDOMS)  # range of a held interface
        ends = [(*loads.force, *loads.moment) if loads else none for loads in ranges]
        low, high = np.concatenate(ends).T
        return DeclaredRange(low, high)

    def analysis(self, mesh: MeshSource | None) -> Analysis:
        """Return ``[analysis]``; without it a component is nonlinear, the weaker assumption.

        The integration of an input deck's 20-node hexahedra is the default of its component.
        """
        analysis = self.read("analysis") or Analysis(True)
        table = self.table.get("analysis")
        file = mesh.file if mesh is not None else None
        if file is None or file.suffix.lower() != ".inp":
            return analysis
        try:
            of_deck = integrations(deck_text(file))
        except MeshFileError as error:
            self.wrong("mesh.file", f'"{file.name}" {error}')
            return analysis
        if type(table) is not dict or "integration" in table:
            return analysis
        if len(of_deck) > 1:
            message = 'is missing, but the deck has C3D20 and C3D20R; write "full" or "reduced"'
            self.wrong("analysis.integration", message)
        elif of_deck:
            return replace(analysis, integration=of_deck[0])
        return analysis

    def deck(self) -> Deck | None:
        """Return ``[deck]``, after a check of its reader's options."""
        deck = self.read("deck")
        table = self.table.get("deck")
        output = table.get("output") if type(table) is dict else None
        if type(output) is not dict:
            return deck
        where = "deck.output.reader"
        name = output.get("reader")
        if type(name) is not str or name not in reader_names():
            names = ", ".join(reader_names())
            near = suggest(name, reader_names()) if type(name) is str else ""
            wrong = f"must be one of {names}, not {shown(name)}{near}"
            self.wrong(where, wrong if "reader" in output else f"is missing; write one of {names}")
            return None
        reader = reader_named(name)
        known = ("reader", *reader.keys)
        for each in known:
            if each not in output:
                needs = f'the reader "{name}" needs {" and ".join(reader.keys)}'
                self.wrong(f"deck.output.{each}", f"is missing; {needs}, each a string in quotes")
        for each in output:
            if each not in known:
                message = f"is an unknown key; known: {', '.join(known)}{suggest(each, known)}"
                self.wrong(f"deck.output.{each}", message)
        return deck and replace(deck, moment=deck.moment or reader.moment)

    def check_tables(self) -> None:
        """Note missing tables that others need; a held interface can replace supports."""
        for name in ("tie", "bolt", "spring"):
            if name in self.table and "deck" in self.table:
                self.wrong(name, "cannot go with a [deck]; define it in the deck, not here")
            elif name in self.table and "mesh" not in self.table:
                self.wrong(name, "needs a [mesh], whose groups it names; add one, or leave it out")
        if "deck" in self.table:
            return
        tables = self.table["interface"] if self.several else []
        held = any(isinstance(table, dict) and table.get("held") for table in tables)
        for key in _SOLVER_TABLES:
            if "mesh" in self.table:
                if key not in self.table and not (held and key == "supports"):
                    brackets = "[[material]]" if key == "material" else f"[{key}]"
                    more = _OR_HELD if key == "supports" and self.several else ""
                    self.wrong(key, f"is missing; a component with a [mesh] needs {brackets}{more}")
            elif key in self.table and not (key == "interface" and self.several):
                message = "needs a [mesh]; add one, or leave it out of a component without a solver"
                self.wrong(key, message)

    def check_deck(self, analysis: Analysis, interfaces: list[Interface | None]) -> None:
        """Note entries of the other tables that have no effect with a deck."""
        if "deck" not in self.table:
            return
        if len(interfaces) > 1:
            message = "has several interfaces, but a [deck] may have one only; keep one"
            self.wrong("interface", message)
        interface = interfaces[0] if len(interfaces) == 1 else None
        if interface is not None and (interface.axes != np.eye(3)).any():
            message = "cannot go with a [deck]; write the deck in the interface frame instead"
            self.wrong("interface.axes", message)
        if interface is not None and interface.locked:
            message = "cannot go with a [deck]; fix these freedoms in the deck instead"
            self.wrong("interface.locked", message)
        if analysis.gravity is not None:
            message = "cannot go with a [deck]; write *DLOAD with GRAV in the deck instead"
            self.wrong("analysis.gravity", message)

    def check_inputs(
        self,
        further: tuple[ScalarInput, ...],
        materials: list[AnyMaterial | None],
        interfaces: list[Interface | None],
    ) -> None:
        """Note entries that a component with further inputs must or must not have."""
        names = [scalar.name for scalar in further]
        if further and "deck" in self.table:
            message = "cannot go with a [deck]; leave it out, or solve a [mesh] instead"
            self.wrong(further[0].key, message)
        if further and further[0].field is not None and "mesh" not in self.table:
            message = "needs a [mesh], because a measured part has no nodes; leave it out"
            self.wrong("inputs.temperature.field", message)
        for i, interface in enumerate(interfaces):
            if interface is not None and interface.name in names:
                message = f'"{interface.name}" is also the name of an input; choose another'
                self.wrong(f"interface[{i}].name", message)
        for i, material in enumerate(materials if TEMPERATURE in names else ()):
            if material is not None and material.thermal_expansion is None:
                message = "is missing; with [inputs.temperature] every material needs it, in 1/K"
                self.wrong(f"material[{i}].thermal_expansion", f"{message}, such as 23e-6")
            if material is not None and material.law not in EXPANDING:
                message = f'"{material.law}" cannot go with [inputs.temperature]; write "isotropic"'
                self.wrong(f"material[{i}].law", message)
        if ACCELERATIONS[0] in names:
            self.check_densities(materials, "[inputs.acceleration]")

    def check_densities(self, materials: list[AnyMaterial | None], key: str) -> None:
        """Note the materials without the density that `key` needs."""
        for i, material in enumerate(materials):
            if material is not None and material.density is None:
                message = f"is missing; {key} needs the density of each material, in kg/m^3"
                self.wrong(f"material[{i}].density", f"{message}, such as 2700.0")

    def check_count(
        self, loads: DeclaredRange, further: tuple[ScalarInput, ...], interfaces: int
    ) -> None:
        """Note a range with too many inputs, or with too many corners to examine each."""
        count = len(loads.low) + len(further)
        if count > ALL_INPUTS:
            parts = f"{interfaces} interfaces and {len(further)} further inputs"
            message = f"{parts} are {count} inputs, more than {ALL_INPUTS}; leave some out"
            self.wrong("interface", message)
        vary = len(further) + int((loads.low < loads.high).sum())
        if vary > MAX_INPUTS:
            zero = f"write 0 in the ranges for {vary - MAX_INPUTS} or more loads"
            self.wrong("interface", f"{vary} inputs vary, more than {MAX_INPUTS}; {zero}")
