"""What imports what: no circle hidden in a function, and a light way to read bundles."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

from wrenchbook import fea

ROOM = Path(fea.__file__).parent
LATE = {"fea/mesh/cad/child.py": {"gmsh"}}
"""An optional extra, with a message of its own where it is not installed."""


def hidden_imports(tree):
    """Yield the modules imported in a function or under TYPE_CHECKING."""
    for node in ast.walk(tree):
        for inner in ast.walk(node) if is_hiding(node) else ():
            if isinstance(inner, ast.Import):
                yield from (alias.name for alias in inner.names)
            elif isinstance(inner, ast.ImportFrom):
                yield inner.module


def is_hiding(node):
    checking = isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)
    return checking or isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)


@pytest.mark.parametrize(
    "path", [str(path.relative_to(ROOM.parent)) for path in sorted(ROOM.rglob("*.py"))]
)
def test_a_file_imports_at_its_top_and_nowhere_else(path):
    tree = ast.parse((ROOM.parent / path).read_text(encoding="utf-8"))
    assert set(hidden_imports(tree)) == LATE.get(path, set())


def test_reading_a_bundle_loads_neither_finite_elements_nor_mesh_readers():
    program = "import wrenchbook.fea.bundle.read, sys; print(*sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    loaded = set(done.stdout.split())
    assert "wrenchbook.fea.bundle.read" in loaded
    assert not loaded & {
        "skfem",
        "meshio",
        "scipy",
        "gmsh",
        "wrenchbook.fea.solve",
        "wrenchbook.fea.component",
    }
