"""What a reader of this room can count on: arrays with shape and unit."""

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

from wrenchbook import fea

ROOM = Path(fea.__file__).parent
FILES = [str(path.relative_to(ROOM.parent)) for path in sorted(ROOM.rglob("*.py"))]
ARRAY = re.compile(r"\bArray\b")
SHAPE = re.compile(r"[Ss]hape|\(\w[\w ]*,[^)]*\)")


def tree_of(path):
    return ast.parse((ROOM.parent / path).read_text(encoding="utf-8"))


def public_functions(body):
    """Yield the public functions and methods of a file."""
    for node in body:
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            yield from public_functions(node.body)
        elif isinstance(node, ast.FunctionDef) and not node.name.startswith("_"):
            yield node


def annotations(function):
    arguments = [*function.args.posonlyargs, *function.args.args, *function.args.kwonlyargs]
    told = [argument.annotation for argument in arguments] + [function.returns]
    return " ".join(ast.unparse(one) for one in told if one is not None)


@pytest.mark.parametrize("path", FILES)
def test_a_public_function_of_arrays_says_their_shape(path):
    silent = [
        function.name
        for function in public_functions(tree_of(path).body)
        if ARRAY.search(annotations(function))
        and not SHAPE.search(ast.get_docstring(function) or "")
    ]
    assert silent == []


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
