"""What a reader of this room can count on: arrays with shape and unit."""

import ast
import re
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
