"""A packed table as an FMU 2.0, or with the C library that answers from it: zip files."""

from __future__ import annotations

import contextlib
import hashlib
import io
import platform
import re
import struct
import tempfile
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from itertools import pairwise
from pathlib import Path
from xml.etree import ElementTree

from wrenchbook.service.contract import MOMENT_POINT
from wrenchbook.surrogate.answer import METHODS, UnknownMethodError
from wrenchbook.surrogate.kernel import build
from wrenchbook.surrogate.kernel.binding import PackedTable
from wrenchbook.surrogate.table.space import DEFAULT, Space

# The kernel's sources and headers in an FMU: no FMU has a joint.
_KERNEL = sorted(path for path in build.sources() if path.name != "wb_joint.c")
SOURCES = (
    "fmu_instance.c",
    "fmu_variables.c",
    "fmu_simulation.c",
    *(path.name for path in _KERNEL if path.suffix == ".c"),
)
# Exponents of the base units.
_UNITS: dict[str, dict[str, str]] = {
    "N": {"kg": "1", "m": "1", "s": "-2"},
    "N.m": {"kg": "1", "m": "2", "s": "-2"},
    "m": {"m": "1"},
    "rad": {"rad": "1"},
    "K": {"K": "1"},
    "degC": {"K": "1", "offset": "273.15"},
    "m/s2": {"m": "1", "s": "-2"},
}
_CONTRACT = (
    "wrench acting ON the component at its interface point where it is now (it moves with the "
    "section), in axes fixed to the undeformed interface frame; displacement of the same point in "
    "the same axes, rotation as a rotation vector"
)
_COVERAGE = (
    "0 covered, 1 thin, 2 outside: a displacement that is not covered is an estimate, and its "
    "error bar may be wrong"
)
_WITHIN = (
    "1 if the whole error bar of every displacement is within the tolerance, the solver's own "
    "error included, 0 if not, -1 where that is not known"
)
_STEPS = {"canHandleVariableCommunicationStepSize": "true"}  # attribute of co-simulation only
_GUID_ENDS = (0, 8, 12, 16, 20, 32)  # ends of its groups among 32 hexadecimal digits
_TOLERANCE = (
    "limit of a covered answer's interpolation error, and of the whole error bar for "
    "within_tolerance; 0: the component's own. Give both or none"
)


def identifier_of(component: str) -> str:
    """Return a component's name as a C identifier, as FMI requires."""
    word = re.sub(r"[^A-Za-z0-9_]", "_", component)
    return word if word[:1].isalpha() else f"fmu_{word}"


def describe(component: str, guid: str, tool: str, summary: str, space: Space = DEFAULT) -> bytes:
    """Return modelDescription.xml.

    `tool` is program and version, `summary` the table's version, its rows and its method.
    """
    root = ElementTree.Element(
        "fmiModelDescription",
        fmiVersion="2.0",
        modelName=component,
        guid=guid,
        description=f"{summary}; {_CONTRACT}",
        generationTool=tool,
        variableNamingConvention="flat",
        numberOfEventIndicators="0",
    )
    abilities = {
        "modelIdentifier": identifier_of(component),
        "canGetAndSetFMUstate": "true",
        "canSerializeFMUstate": "true",
        "providesDirectionalDerivative": "true",
        "canNotUseMemoryManagementFunctions": "true",  # the table is mapped
    }
    for kind, more in (("ModelExchange", {}), ("CoSimulation", _STEPS)):
        interface = ElementTree.SubElement(root, kind, abilities | more)
        files = ElementTree.SubElement(interface, "SourceFiles")
        for name in SOURCES:
            ElementTree.SubElement(files, "File", name=name)

    definitions = ElementTree.SubElement(root, "UnitDefinitions")
    for name in dict.fromkeys(
        ("N", "N.m", "m", "rad", *(_unit(load.unit) for load in space.inputs))
    ):
        unit = ElementTree.SubElement(definitions, "Unit", name=name)
        ElementTree.SubElement(unit, "BaseUnit", _UNITS.get(name, {}))

    categories = ElementTree.SubElement(root, "LogCategories")
    for name in ("logStatusWarning", "logStatusError"):
        ElementTree.SubElement(categories, "Category", name=name)
    ElementTree.SubElement(root, "DefaultExperiment", startTime="0", stopTime="1")
    variables = ElementTree.SubElement(root, "ModelVariables")
    _add_variables(variables, space)
    _add_structure(ElementTree.SubElement(root, "ModelStructure"), variables)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="UTF-8", xml_declaration=True)


def _add_structure(structure: ElementTree.Element, variables: ElementTree.Element) -> None:
    """Add the dependencies of the outputs, without delay; variables are numbered from 1.

    Each output depends on all inputs, and an Integer on the fixed tolerances too. Only
    InitialUnknowns name these: of the section Outputs inputs alone are knowns (FMI 2.0, 2.2.8).
    """
    numbers: dict[str | None, list[str]] = {}
    for number, variable in enumerate(variables, 1):
        numbers.setdefault(variable.get("causality"), []).append(str(number))
    for part in ("Outputs", "InitialUnknowns"):
        unknowns = ElementTree.SubElement(structure, part)
        for index in numbers["output"]:
            knowns = numbers["input"]
            if part == "InitialUnknowns" and variables[int(index) - 1].find("Integer") is not None:
                knowns = [*knowns, *numbers["parameter"]]
            ElementTree.SubElement(unknowns, "Unknown", index=index, dependencies=" ".join(knowns))


def _unit(text: str) -> str:
    """Return a unit of a table's space in FMI's spelling: ``N.m``, ``m/s2``."""
    return text.replace("·", ".").replace("²", "2")


def _add_variables(root: ElementTree.Element, space: Space) -> None:
    """Add the variables; their value references are their positions, as in c/fmu.h."""
    for load in space.inputs:
        unit = _unit(load.unit)
        kind = "input" if load.kind == "scalar" else "load"
        point = f", about {MOMENT_POINT}" if load.kind == "moment" else ""
        # The loads of a single interface are Fx to Mz.
        only = not load.interface and load.kind != "scalar"
        name = load.name.capitalize() if only else load.name
        start = {"unit": unit, "start": f"{load.zero:.17g}"}
        _add(root, name, "input", f"{kind}, {unit}{point}", start)
    for prefix, text in (("", "displacement"), ("error_", "95 % error bar of the displacement")):
        for output in space.outputs:
            _add(root, prefix + output.name, "output", text, {"unit": output.unit})
    _add(root, "coverage", "output", _COVERAGE, {}, "discrete", "Integer")
    for name, unit in (("translation", "m"), ("rotation", "rad")):
        start = {"unit": unit, "start": "0", "min": "0"}
        _add(root, f"tolerance_{name}", "parameter", _TOLERANCE, start, "fixed")
    _add(root, "within_tolerance", "output", _WITHIN, {}, "discrete", "Integer")


def _add(
    root: ElementTree.Element,
    name: str,
    causality: str,
    description: str,
    attributes: dict[str, str],
    variability: str = "continuous",
    fmi_type: str = "Real",
) -> None:
    """Append a variable of modelDescription.xml; its reference is its index in the file, from 0."""
    variable = ElementTree.SubElement(
        root,
        "ScalarVariable",
        name=name,
        valueReference=str(len(root)),
        causality=causality,
        variability=variability,
        description=description,
    )
    ElementTree.SubElement(variable, fmi_type, attributes)


# The kernel's flags, so that an FMU's answers are the same to the last bit.
FLAGS = tuple(flag for flag in build.FLAGS if flag != "-DWB_SHARED")
# Options for a CMakeLists.txt.
OPTIONS = " ".join(flag for flag in FLAGS if flag.startswith(("-O", "-f")))
# Folders of binaries: the ending, and the keys of `build.PLATFORMS` whose code each file has. FMI
# 2.0 has one name for both processors of macOS, and none for arm64 Linux, which has FMI 3.0's.
PLATFORMS = {
    "linux64": (".so", ("manylinux_2_28_x86_64",)),
    "aarch64-linux": (".so", ("manylinux_2_28_aarch64",)),
    "win64": (".dll", ("win_amd64",)),
    "darwin64": (".dylib", ("macosx_11_0_x86_64", "macosx_11_0_arm64")),
}
_MACHINES = {
    ("Linux", "x86_64"): "linux64",
    ("Linux", "aarch64"): "aarch64-linux",
    ("Darwin", "x86_64"): "darwin64",
    ("Darwin", "arm64"): "darwin64",
}
_FAT_MAGIC = 0xCAFEBABE  # mark of a universal Mach-O; its header is big-endian (mach-o/fat.h)
_FAT_ALIGNMENT = 14  # slices begin at multiples of 2^14 bytes, the page of arm64 macOS
_HEADERS = ("fmu.h", "fmi2Functions.h", "fmi2FunctionTypes.h", "fmi2TypesPlatform.h")
LIBRARY_FILES = Path(__file__).parent / "cmake"  # files of the C library: example, CMakeLists.txt
_DATE = (1980, 1, 1, 0, 0, 0)  # the earliest date of a zip: the same table gives the same file
_CMAKE = """\
# Build the FMU's binary where the exporting machine had no compiler, or for another platform:
#   cmake -S sources -B build && cmake --build build
# then put the library into binaries/<platform>/ (win64, linux64, darwin64) of the FMU, a zip file.
cmake_minimum_required(VERSION 3.10)
project({name} C)
add_library({name} SHARED {sources})
set_target_properties({name} PROPERTIES PREFIX "" C_STANDARD 11 C_VISIBILITY_PRESET hidden)
if(NOT MSVC)
  target_compile_options({name} PRIVATE {options})
  target_link_libraries({name} PRIVATE m)
endif()
"""


class UnknownPlatformError(ValueError):
    """A platform without a binary for FMUs; the message lists the known ones."""


class NotExportableError(ValueError):
    """A table that cannot be exported; the message has the reason and the remedy."""


@dataclass(frozen=True)
class Fmu:
    """An FMU."""

    content: bytes  # the zip file
    # Platforms of its binaries, of `PLATFORMS`; empty if it only has sources.
    platforms: tuple[str, ...]
    method: str  # a method of `METHODS`, or those of its groups of outputs, separated by commas


def platforms_of(text: str) -> tuple[str, ...]:
    """Return the platforms in a list: ``all``, or names of `PLATFORMS` with commas.

    Raises UnknownPlatformError if there is no such platform, and KernelBuildError if ziglang, which
    compiles for them, is not installed.
    """
    names = tuple(dict.fromkeys(word.strip() for word in text.split(",")))
    names = tuple(PLATFORMS) if names == ("all",) else names
    unknown = [name for name in names if name not in PLATFORMS]
    if unknown:
        raise UnknownPlatformError(
            f"platforms names {', '.join(map(repr, unknown))}, for which no FMU can be compiled; "
            f"write all, or some of {', '.join(PLATFORMS)} with commas between"
        )
    # Any platform: one compiler serves all.
    build.compiler_command(next(iter(build.PLATFORMS.values())))
    return names


def _require_rows(component: str, table: PackedTable) -> None:
    """Raise NotExportableError if a table has no rows within its load range."""
    if not table.meta["provenance"]["rows"]:
        raise NotExportableError(
            f"the table of {component} has no rows; run wrenchbook fill {component}, or wrenchbook "
            f"import {component} FILE, then export it"
        )
    low, high = table.arrays["space/ends"]
    rows = [table.arrays[f"g{k}/row/wrench"] for k in range(len(table.meta["groups"]))]
    if not all(((low <= loads) & (loads <= high)).all(axis=1).any() for loads in rows):
        raise NotExportableError(
            f"all rows of the table of {component} are outside its load range; run wrenchbook fill "
            f"{component}, or import rows within the range, then export it"
        )


def make_fmu(
    component: str, table: PackedTable, method: str | None = None, platforms: Sequence[str] = ()
) -> Fmu:
    """Return the FMU of a component's table, which answers by its default method or another.

    platforms: names of `PLATFORMS`, compiled by ziglang; empty for this machine by its compiler.

    Raises UnknownMethodError if the table does not answer by the method, NotExportableError if it
    has no rows within its load range, and KernelBuildError if the compiler fails, or platforms are
    named and ziglang is missing.
    """
    if method is not None and method not in METHODS:
        raise UnknownMethodError(method)
    _require_rows(component, table)
    table.answer(table.space.zero.tolist(), None, method)  # raises if the table has no such method
    methods = ", ".join(dict.fromkeys(method or group["method"] for group in table.meta["groups"]))
    provenance = table.meta["provenance"]
    space = table.space
    identifier = identifier_of(component)
    summary = f"table version {provenance['version']}, {provenance['rows']} rows, method {methods}"
    zeros = " ".join(f"{load.zero:.17g}" for load in space.inputs)
    method_index = -1 if method is None else METHODS.index(method)  # -1: the default of each group

    # The GUID is a digest of everything on which the answers depend: the same table has the same
    # GUID.
    header = f"{component}\0{method_index}\0".encode()
    digest = hashlib.blake2b(header + table.content, digest_size=16).hexdigest()
    guid = "{" + "-".join(digest[start:end] for start, end in pairwise(_GUID_ENDS)) + "}"
    try:
        tool = f"wrenchbook {version('wrenchbook')}"
    except PackageNotFoundError:  # a checkout that is not installed
        tool = "wrenchbook"
    cmake = _CMAKE.format(name=identifier, sources=" ".join(SOURCES), options=OPTIONS)
    parts = {
        "modelDescription.xml": describe(component, guid, tool, summary, space),
        "resources/table.wbt": table.content,
        "resources/model.txt": f"{guid}\n{method_index}\n{zeros}\n".encode(),
        **{f"sources/{path.name}": path.read_bytes() for path in _source_paths()},
        "sources/CMakeLists.txt": cmake.encode(),
    }
    binaries = _binaries(platforms)
    for name, content in binaries.items():
        parts[f"binaries/{name}/{identifier}{PLATFORMS[name][0]}"] = content
    return Fmu(zipped(parts), tuple(binaries), methods)


def _binaries(platforms: Sequence[str]) -> dict[str, bytes]:
    """Return the library of each platform; by default that of this machine, if it compiles."""
    targets = {name: PLATFORMS[name][1] for name in platforms}
    if not platforms:
        machine = _MACHINES.get((platform.system(), platform.machine()))
        with contextlib.suppress(build.KernelBuildError):
            build.compiler_command()
            targets = {} if machine is None else {machine: ("",)}
    libraries = {}
    for name, processors in targets.items():
        slices = [_compiled(PLATFORMS[name][0], build.PLATFORMS.get(key)) for key in processors]
        libraries[name] = slices[0] if len(slices) == 1 else universal(slices)
    return libraries


def universal(slices: Sequence[bytes]) -> bytes:
    """Return a universal Mach-O of the libraries of several processors."""
    header = struct.pack(">2I", _FAT_MAGIC, len(slices))
    content = b""
    size = 1 << _FAT_ALIGNMENT  # the header has the first page
    for part in slices:
        processor = struct.unpack_from("<2I", part, 4)  # type and subtype
        header += struct.pack(">5I", *processor, size + len(content), len(part), _FAT_ALIGNMENT)
        content += part + bytes(-len(part) % size)
    return header.ljust(size, b"\0") + content


def _source_paths() -> list[Path]:
    """Return the files from which an FMU is compiled: C sources and headers."""
    folder = Path(__file__).parent / "c"
    sources = [name for name in SOURCES if name.startswith("fmu_")]
    return [*(folder / name for name in (*sources, *_HEADERS)), *_KERNEL]


@cache  # FMUs differ by their tables only; the library is the same
def _compiled(ending: str, target: str | None = None) -> bytes:
    """Return the compiled library of a target of ziglang, or of this machine."""
    paths = [path for path in _source_paths() if path.suffix == ".c"]
    with tempfile.TemporaryDirectory(prefix="wrenchbook-fmu-") as name:
        library = Path(name) / f"fmu{ending}"
        build.compile_library(library, paths, (*FLAGS, f"-I{build.FOLDER}"), target)
        return library.read_bytes()


def zipped(parts: dict[str, bytes]) -> bytes:
    """Return a zip of files by name; the same files give the same bytes."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in parts.items():
            archive.writestr(zipfile.ZipInfo(name, _DATE), content, zipfile.ZIP_DEFLATED)
    return buffer.getvalue()


def make_library(component: str, table: PackedTable) -> bytes:
    """Return a zip of a table and the C library that answers from it; it needs no Python.

    Raises NotExportableError if the table has no rows within its load range.
    """
    _require_rows(component, table)
    space = table.space
    # One newton or newton metre each; further inputs at their value without an effect.
    loads = [f"{load.zero if load.kind == 'scalar' else 1:g}" for load in space.inputs]
    texts = {
        "@NAME@": component,
        "@OPTIONS@": OPTIONS,
        "@WORDS@": " ".join([f"{component}.wbt", *loads]),
        "@LOADS@": ", ".join(f"{load.name} [{load.unit}]" for load in space.inputs),
    }
    parts = {f"{component}.wbt": table.content}
    for path in build.sources():
        folder = "include" if path.name == "wrenchbook.h" else "src"
        parts[f"{folder}/{path.name}"] = path.read_bytes()
    for path in sorted(LIBRARY_FILES.iterdir()):
        text = path.read_text(encoding="utf-8")
        for mark, value in texts.items():
            text = text.replace(mark, value)
        parts[path.name] = text.encode()
    return zipped(parts)
