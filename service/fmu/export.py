"""A packed table as an FMU 2.0, or with the C library that answers from it: zip files."""

from __future__ import annotations

import hashlib
import io
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from itertools import pairwise
from pathlib import Path

from wrenchbook.service.fmu.description import describe, identifier_of
from wrenchbook.service.fmu.platforms import OPTIONS, PLATFORMS, SOURCES, libraries, source_paths
from wrenchbook.surrogate.answer import METHODS, UnknownMethodError
from wrenchbook.surrogate.kernel import build
from wrenchbook.surrogate.kernel.binding import PackedTable

_GUID_ENDS = (0, 8, 12, 16, 20, 32)  # ends of its groups among 32 hexadecimal digits
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


class NotExportableError(ValueError):
    """A table that cannot be exported; the message has the reason and the remedy."""


@dataclass(frozen=True)
class Fmu:
    """An FMU 2.0 for model exchange and co-simulation."""

    content: bytes  # the zip file
    # Platforms of its binaries, of `PLATFORMS`; empty if it only has sources.
    platforms: tuple[str, ...]
    method: str  # a method of `METHODS`, or those of its groups of outputs, separated by commas


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

    # A digest of everything on which the answers depend: the same table has the same GUID.
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
        **{f"sources/{path.name}": path.read_bytes() for path in source_paths()},
        "sources/CMakeLists.txt": cmake.encode(),
    }
    binaries = libraries(platforms)
    for name, content in binaries.items():
        parts[f"binaries/{name}/{identifier}{PLATFORMS[name].ending}"] = content
    return Fmu(zipped(parts), tuple(binaries), methods)


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
