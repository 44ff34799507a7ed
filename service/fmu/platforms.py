"""The platforms of FMUs, and the shared library of each."""

from __future__ import annotations

import contextlib
import platform
import struct
import tempfile
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple

from wrenchbook.surrogate.kernel import build

# The kernel's sources and headers in an FMU: no FMU has a joint.
_KERNEL = sorted(path for path in build.sources() if path.name != "wb_joint.c")
_SOURCES = ("fmu_instance.c", "fmu_variables.c", "fmu_simulation.c")
_HEADERS = ("fmu.h", "fmi2Functions.h", "fmi2FunctionTypes.h", "fmi2TypesPlatform.h")
SOURCES = (*_SOURCES, *(path.name for path in _KERNEL if path.suffix == ".c"))  # to compile
# The kernel's flags, so that an FMU's answers are the same to the last bit.
FLAGS = tuple(flag for flag in build.FLAGS if flag != "-DWB_SHARED")
# Options for a CMakeLists.txt.
OPTIONS = " ".join(flag for flag in FLAGS if flag.startswith(("-O", "-f")))
_FOLDER = Path(__file__).parent / "c"


class Platform(NamedTuple):
    """A platform of FMI 2.0."""

    ending: str  # of its libraries
    targets: tuple[str, ...]  # keys of `build.PLATFORMS` whose code one library has


# By the folder of binaries. FMI 2.0 has one name for both processors of macOS, and none for arm64
# Linux, which has FMI 3.0's.
PLATFORMS = {
    "linux64": Platform(".so", ("manylinux_2_28_x86_64",)),
    "aarch64-linux": Platform(".so", ("manylinux_2_28_aarch64",)),
    "win64": Platform(".dll", ("win_amd64",)),
    "darwin64": Platform(".dylib", ("macosx_11_0_x86_64", "macosx_11_0_arm64")),
}
_MACHINES = {
    ("Linux", "x86_64"): "linux64",
    ("Linux", "aarch64"): "aarch64-linux",
    ("Darwin", "x86_64"): "darwin64",
    ("Darwin", "arm64"): "darwin64",
}
_FAT_MAGIC = 0xCAFEBABE  # mark of a universal Mach-O; its header is big-endian (mach-o/fat.h)
_FAT_ALIGNMENT = 14  # slices begin at multiples of 2^14 bytes, the page of arm64 macOS


class UnknownPlatformError(ValueError):
    """A platform without a binary for FMUs; the message lists the known ones."""


def source_paths() -> list[Path]:
    """Return the files from which an FMU is compiled: C sources and headers."""
    return [*(_FOLDER / name for name in (*_SOURCES, *_HEADERS)), *_KERNEL]


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


def libraries(platforms: Sequence[str]) -> dict[str, bytes]:
    """Return the library of each platform; by default that of this machine, if it compiles.

    Raises KernelBuildError if the compiler fails, or platforms are named and ziglang is missing.
    """
    targets = {name: PLATFORMS[name].targets for name in platforms}
    if not platforms:
        machine = _MACHINES.get((platform.system(), platform.machine()))
        with contextlib.suppress(build.KernelBuildError):
            build.compiler_command()
            targets = {} if machine is None else {machine: ("",)}  # this machine's own compiler
    contents = {}
    for name, keys in targets.items():
        slices = [_compiled(PLATFORMS[name].ending, build.PLATFORMS.get(key)) for key in keys]
        contents[name] = slices[0] if len(slices) == 1 else universal(slices)
    return contents


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


@cache  # FMUs differ by their tables only; the library is the same
def _compiled(ending: str, target: str | None = None) -> bytes:
    """Return the compiled library of a target of ziglang, or of this machine."""
    paths = [path for path in source_paths() if path.suffix == ".c"]
    with tempfile.TemporaryDirectory(prefix="wrenchbook-fmu-") as name:
        library = Path(name) / f"fmu{ending}"
        build.compile_library(library, paths, (*FLAGS, f"-I{build.FOLDER}"), target)
        return library.read_bytes()
