"""A packed table with the C library that answers from it, zipped: sources, example, CMake."""

from __future__ import annotations

from pathlib import Path

from wrenchbook.service.fmu.export import OPTIONS, zipped
from wrenchbook.surrogate.kernel import build
from wrenchbook.surrogate.kernel.binding import PackedTable

_FILES = Path(__file__).parent / "cmake"


def make_library(component: str, table: PackedTable) -> bytes:
    """Return a zip file of a component's table and the kernel's sources; it needs no Python."""
    space = table.space
    # One newton or newton metre each; temperatures and the like have no effect.
    words = [f"{one.zero if one.kind == 'scalar' else 1:g}" for one in space.inputs]
    filled = {
        "@NAME@": component,
        "@OPTIONS@": OPTIONS,
        "@WORDS@": " ".join([f"{component}.wbt", *words]),
        "@LOADS@": ", ".join(f"{one.name} [{one.unit}]" for one in space.inputs),
    }
    parts = {f"{component}.wbt": table.content}
    for path in build.sources():
        folder = "include" if path.name == "wrenchbook.h" else "src"
        parts[f"{folder}/{path.name}"] = path.read_bytes()
    for path in sorted(_FILES.iterdir()):
        text = path.read_text(encoding="utf-8")
        for mark, value in filled.items():
            text = text.replace(mark, value)
        parts[path.name] = text.encode()
    return zipped(parts)
