"""Compile the kernel, and FMUs: by the machine's C compiler, else by the `ziglang` wheel.

Imports nothing but the standard library, since the wheel's build hook runs this file by itself.
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterable
from pathlib import Path

FOLDER = Path(__file__).resolve().parent
COMPILERS = ("cc", "gcc", "clang")
MAX_OUTPUT = 2000  # characters of a compiler's output in a message: its last errors
# No contraction of products and sums, and no processor by name: every machine computes the same
# bits. Without errno and traps the compiler vectorises roots and comparisons; `#pragma omp simd`
# needs no library.
FLAGS = (
    *("-std=c11", "-O3", "-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math"),
    *("-fopenmp-simd", "-fvisibility=hidden", "-DWB_SHARED"),
)
# Platform tags of wheels, and ziglang's target for each.
PLATFORMS = {
    "manylinux_2_28_x86_64": "x86_64-linux-gnu.2.28",
    "manylinux_2_28_aarch64": "aarch64-linux-gnu.2.28",
    "macosx_11_0_x86_64": "x86_64-macos.11.0",
    "macosx_11_0_arm64": "aarch64-macos.11.0",
    "win_amd64": "x86_64-windows-gnu",
}
NO_COMPILER = (
    "wrenchbook's kernel is not compiled and there is no C compiler. Install one (Debian package "
    "gcc, or `pip install ziglang`), then run `python -m wrenchbook.surrogate.kernel.build` in the "
    "checkout"
)
NO_ZIGLANG = (
    "a library for a named platform needs ziglang, which is not installed. Run `pip install "
    "ziglang`, then the command again"
)


class KernelBuildError(RuntimeError):
    """A library that could not be compiled; the message has the cause and the remedy."""


def library_path(system: str = sys.platform) -> Path:
    """Return the path of the library on a system, named as in `sys.platform`."""
    ending = {"win32": ".dll", "darwin": ".dylib"}.get(system, ".so")
    return FOLDER / f"_wrenchbook{ending}"


def sources() -> list[Path]:
    """Return the C sources and headers."""
    return sorted([*FOLDER.glob("wb_*.[ch]"), FOLDER / "wrenchbook.h"])


def sources_hash() -> str:
    """Return a hash of the sources and the flags, which is compiled into the library."""
    digest = hashlib.blake2b(repr(FLAGS).encode(), digest_size=16)
    for path in sources():
        digest.update(path.name.encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()


def is_current(library: Path) -> bool:
    """Return whether a library was compiled from the present sources."""
    return library.is_file() and f"wb:{sources_hash()}".encode() in library.read_bytes()


def ready_library() -> Path:
    """Return the library, after compiling it if its sources have changed.

    Raises KernelBuildError if it is not current and cannot be compiled.
    """
    library = library_path()
    if not is_current(library):
        compile_kernel(library)
    return library


def compiler_command(target: str | None = None) -> list[str]:
    """Return the command of the C compiler: `CC` of the environment, one of `COMPILERS`, ziglang.

    `target`: ziglang's target; None for this machine.

    Raises KernelBuildError if there is no compiler, or `CC` does not exist.
    """
    if target is None:
        named = os.environ.get("CC", "").split()
        if named and shutil.which(named[0]) is None:
            raise KernelBuildError(
                f"the C compiler {named[0]!r}, which the environment variable CC names, is not on "
                "the PATH; set CC to one that is, such as clang, or unset it"
            )
        if named:
            return named
        compiler = next(filter(None, map(shutil.which, COMPILERS)), None)
        if compiler is not None:
            return [compiler]
    if importlib.util.find_spec("ziglang") is None:
        raise KernelBuildError(NO_COMPILER if target is None else NO_ZIGLANG)
    zig = [sys.executable, "-m", "ziglang", "cc"]
    return zig if target is None else [*zig, "-target", target]


def compile_kernel(library: Path, target: str | None = None) -> None:
    """Compile the kernel to `library`, which is replaced as a whole.

    Raises the errors of `compile_library`.
    """
    files = [path for path in sources() if path.suffix == ".c"]
    name = f'-DWB_SOURCES="wb:{sources_hash()}"'
    compile_library(library, files, (*FLAGS, name), target)


def compile_library(
    library: Path, files: Iterable[Path], flags: Iterable[str], target: str | None = None
) -> None:
    """Compile C sources to a shared library, which is replaced as a whole.

    `library`: path of the result.
    `files`, `flags`: the C files, and the compiler's options.
    `target`: ziglang's target, a value of `PLATFORMS`; None for this machine.

    Raises KernelBuildError if there is no compiler, it fails, or the library's folder cannot be
    written.
    """
    command = compiler_command(target)
    try:
        folder = tempfile.mkdtemp(prefix=".library-", dir=library.parent)
    except OSError as error:
        raise KernelBuildError(
            f"{library.name} cannot be compiled, because {library.parent} cannot be written to "
            f"({error.strerror}); make it writable, or reinstall wrenchbook"
        ) from error
    built = Path(folder) / library.name
    line = [*command, *flags, "-shared", "-o", str(built), *map(str, files)]
    # The linker's options for a library of this name.
    name = library.name
    system = target or sys.platform
    apple = "macos" in system or "darwin" in system
    more = ["-fPIC", "-lm", "-lpthread"] if apple or "win" not in system else []
    if apple:  # without this option the library holds the path at which it is compiled
        more.append(f"-Wl,-install_name,@rpath/{name}")
    if target is not None or not apple:  # Apple's linker strips no library
        more.append("-s")  # symbols, lines and paths of the source are most of ziglang's library
    line += more
    try:
        # Takes 3 s; the first run of ziglang also compiles its C library: for Windows 441 files, a
        # minute.
        ran = subprocess.run(line, capture_output=True, text=True, errors="replace", check=False)
        if ran.returncode or not built.is_file():
            raise KernelBuildError(
                f"{command[0]} could not compile {library.name}; set the environment variable CC "
                f"to another compiler, such as clang\n{ran.stderr.strip()[-MAX_OUTPUT:]}"
            )
        try:
            built.replace(library)
        except OSError as error:
            raise KernelBuildError(
                f"{library.name} was compiled, but cannot be moved to {library} "
                f"({error.strerror}); make that place writable, or remove what is there"
            ) from error
    except OSError as error:
        raise KernelBuildError(
            f"{command[0]} cannot be run to compile {library.name} ({error.strerror}); set the "
            "environment variable CC to another compiler, such as clang"
        ) from error
    finally:
        shutil.rmtree(folder, ignore_errors=True)


if __name__ == "__main__":
    compile_kernel(library_path())
    print(library_path())
