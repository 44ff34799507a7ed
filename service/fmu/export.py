"""Make an FMU 2.0 of a packed table: the table, the kernel's sources and library, zipped."""

from __future__ import annotations

import hashlib
import io
import os
import platform
import shutil
import subprocess
import tempfile
import zipfile
from dataclasses import dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from importlib.resources import files
from itertools import pairwise
from pathlib import Path

from wrenchbook.service.fmu.description import SOURCES, describe, identifier_of
from wrenchbook.surrogate.answer import UnknownMethodError
from wrenchbook.surrogate.kernel.binding import PackedTable
from wrenchbook.surrogate.kernel.build import COMPILERS
from wrenchbook.surrogate.kernel.build import FLAGS as KERNEL_FLAGS
from wrenchbook.surrogate.kernel.build import sources as kernel_sources
from wrenchbook.surrogate.packed.codes import METHODS

# Those of the kernel, whose numbers an FMU has to the last bit.
FLAGS = (*(flag for flag in KERNEL_FLAGS if flag != "-DWB_SHARED"), "-fPIC", "-shared")
COMPILE_S = 120.0  # it takes about four seconds
PLATFORMS = {
    ("Linux", "x86_64"): ("linux64", ".so"),
    ("Darwin", "x86_64"): ("darwin64", ".dylib"),
    ("Darwin", "arm64"): ("darwin64", ".dylib"),
}
_HEADERS = ("fmu.h", "fmi2Functions.h", "fmi2FunctionTypes.h", "fmi2TypesPlatform.h")
_DATE = (1980, 1, 1, 0, 0, 0)  # the earliest a zip holds: the same table gives the same file
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
    """A table that no FMU can hold; the message has the reason and the remedy."""


class CompilerError(RuntimeError):
    """A compiler that did not compile the FMU; carries its output."""


@dataclass(frozen=True)
class Fmu:
    """An FMU.

    Attributes
    ----------
    content : bytes
        The zip file.
    platform : str
        What its binary runs on, such as ``linux64``; empty if it holds sources only.
    method : str
        How it answers.
    """

    content: bytes
    platform: str
    method: str


def find_compiler() -> str | None:
    """Return the C compiler: `CC` of the environment, else the first of `COMPILERS`."""
    named = os.environ.get("CC", "").split()
    return (
        shutil.which(named[0]) if named else next(filter(None, map(shutil.which, COMPILERS)), None)
    )


def make_fmu(component: str, table: PackedTable, method: str | None = None) -> Fmu:
    """Return the FMU of a component's table.

    Without a compiler, or on a platform that FMI 2.0 does not name, it holds sources only.

    Parameters
    ----------
    method : str, optional
        One of `METHODS`; the table's default otherwise.

    Raises
    ------
    UnknownMethodError
        If there is no such method.
    NotExportableError
        If the table has no rows within its load range.
    CompilerError
        If the compiler fails.
    """
    if method is not None and method not in METHODS:
        raise UnknownMethodError(method)
    _check_rows(table)
    used = ", ".join(dict.fromkeys(method or one["method"] for one in table.words["groups"]))
    about = table.words["provenance"]
    summary = f"table version {about['version']}, {about['rows']} rows, method {used}"
    number = -1 if method is None else METHODS.index(method)
    guid = _guid(component, number, table.content)
    parts = {
        "modelDescription.xml": describe(component, guid, _made_by(), summary),
        "resources/table.wbt": table.content,
        "resources/model.txt": f"{guid}\n{number}\n".encode(),
        **_sources(identifier_of(component)),
    }
    place = PLATFORMS.get((platform.system(), platform.machine()))
    compiler = find_compiler()
    if place is not None and compiler is not None:
        name = f"binaries/{place[0]}/{identifier_of(component)}{place[1]}"
        parts[name] = _compiled(compiler, place[1])
    built = place[0] if place is not None and compiler is not None else ""
    return Fmu(_zipped(parts), built, used)


def _check_rows(table: PackedTable) -> None:
    """Raise `NotExportableError` if some output has no rows to answer from."""
    if not table.words["provenance"]["rows"]:
        raise NotExportableError("the table has no rows: fill or import it first, then export it")
    groups = range(len(table.words["groups"]))
    if not all(len(table.arrays[f"g{number}/near/moved"]) for number in groups):
        raise NotExportableError(
            "all rows of the table are outside its load range: nothing answers within it"
        )


def _guid(component: str, method: int, content: bytes) -> str:
    """Return a GUID made of what the FMU answers: the same table has the same one."""
    named = f"{component}\0{method}\0".encode()
    digest = hashlib.blake2b(named + content, digest_size=16).hexdigest()
    cuts = (0, 8, 12, 16, 20, 32)
    return "{" + "-".join(digest[a:b] for a, b in pairwise(cuts)) + "}"


def _made_by() -> str:
    try:
        return f"wrenchbook {version('wrenchbook')}"
    except PackageNotFoundError:  # a checkout that is not installed
        return "wrenchbook"


def _sources(identifier: str) -> dict[str, bytes]:
    folder = files(__package__ or "wrenchbook.service.fmu") / "c"
    own = [name for name in SOURCES if name.startswith("fmu_")]
    found = {f"sources/{name}": (folder / name).read_bytes() for name in (*own, *_HEADERS)}
    found |= {f"sources/{path.name}": path.read_bytes() for path in kernel_sources()}
    options = " ".join(flag for flag in FLAGS if flag.startswith(("-O", "-f")) and flag != "-fPIC")
    cmake = _CMAKE.format(name=identifier, sources=" ".join(SOURCES), options=options)
    return found | {"sources/CMakeLists.txt": cmake.encode()}


@cache  # what differs between FMUs is their table: the library is the same
def _compiled(compiler: str, ending: str) -> bytes:
    """Return the compiled library."""
    with tempfile.TemporaryDirectory(prefix="wrenchbook-fmu-") as name:
        folder = Path(name)
        for path, content in _sources("fmu").items():
            (folder / Path(path).name).write_bytes(content)
        library = folder / f"fmu{ending}"
        command = [compiler, *FLAGS, "-o", str(library), *SOURCES, "-lm", "-lpthread"]
        try:
            ran = subprocess.run(
                command, cwd=folder, capture_output=True, text=True, timeout=COMPILE_S, check=False
            )
        except (OSError, subprocess.TimeoutExpired) as error:
            raise CompilerError(f"{compiler} could not compile the FMU: {error}") from error
        if ran.returncode or not library.is_file():
            raise CompilerError(
                f"{compiler} could not compile the FMU; name another compiler with CC=...\n"
                f"{ran.stderr.strip()[-2000:]}"
            )
        return library.read_bytes()


def _zipped(parts: dict[str, bytes]) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in parts.items():
            archive.writestr(zipfile.ZipInfo(name, _DATE), content, zipfile.ZIP_DEFLATED)
    return buffer.getvalue()
