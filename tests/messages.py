"""The catalogue of messages: every text that an error carries, read from the source.

``make messages`` prints it, sorted by package: where the error appears (an HTTP status, an exit
code or the exception's class), its text with placeholders in braces, and file and line. The text
itself ends with what to do. Texts of a variable are found where the function assigns it.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from wrenchbook.service.http.problems import _NAMED

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("fea", "surrogate", "service")
ENDINGS = ("Error", "Failed", "Diverged", "Stuck", "Problem", "Unreachable", "Timeout", "Unknown")
INTERNAL = ("AssertionError", "KeyError", "NotImplementedError", "AttributeError")
EXIT_2, SOLVE, BUNDLE, BODY = "exit 2", "failed job, 424", "422, check: exit 1", "422"
PLACES = {
    "BadParameter": EXIT_2,
    "SolveFailed": SOLVE,
    "BundleError": BUNDLE,
    "BundleProblem": BUNDLE,
    "KeysError": BODY,
    "bad_body": BODY,
}


@dataclass(frozen=True, order=True)
class Message:
    """A text that an error carries.

    Attributes
    ----------
    package : str
        Such as ``fea/mesh``.
    place : str
        HTTP status, exit code, or class of the exception.
    text : str
        With placeholders in braces.
    source : str
        File and line.
    """

    package: str
    place: str
    text: str
    source: str


@cache
def messages() -> tuple[Message, ...]:
    """Return the messages of all packages, sorted by package, place and text."""
    files = [file for package in PACKAGES for file in (ROOT / package).rglob("*.py")]
    trees = {file.relative_to(ROOT): ast.parse(file.read_text("utf-8")) for file in files}
    makers = {_name(node.exc) for tree in trees.values() for node in _raises(tree)}
    return tuple(
        sorted({item for file, tree in trees.items() for item in _of_file(file, tree, makers)})
    )


def _raises(tree: ast.Module) -> Iterator[ast.Raise]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call):
            yield node


def _of_file(file: Path, tree: ast.Module, makers: set[str]) -> Iterator[Message]:
    constants = _assigned(tree.body)
    functions = [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)]
    for scope in [
        *functions,
        *(item for item in ast.walk(tree) if isinstance(item, ast.AsyncFunctionDef)),
    ]:
        names = constants | _assigned(list(ast.walk(scope)))
        for call in ast.walk(scope):
            if isinstance(call, ast.Call) and _is_error(_name(call), makers):
                texts = [text for argument in _arguments(call) for text in _texts(argument, names)]
                if texts := [text for text in texts if " " in text.strip()]:
                    source = f"{file}:{call.lineno}"
                    yield Message(str(file.parent), _place(call), " | ".join(texts), source)


def _is_error(name: str, makers: set[str]) -> bool:
    """Return whether a call of this name makes an error; `makers` are the names that are raised."""
    return name not in INTERNAL and (name in makers or name.endswith(ENDINGS))


def _place(call: ast.Call) -> str:
    name = _name(call)
    first = call.args[0] if call.args else None
    if isinstance(first, ast.Constant) and isinstance(first.value, int):
        return str(first.value)
    return PLACES.get(name) or _statuses().get(name, name)


@cache
def _statuses() -> dict[str, str]:
    """Return the HTTP status of each exception class that has one, by its name."""
    return {kind.__name__: str(status) for kind, (status, _, _) in _NAMED.items()}


def _arguments(call: ast.Call) -> list[ast.expr]:
    return [*call.args, *(keyword.value for keyword in call.keywords)]


def _name(node: ast.AST | None) -> str:
    """Return the last part of the name that a call has, such as ``BadParameter``."""
    called = node.func if isinstance(node, ast.Call) else node
    if isinstance(called, ast.Attribute):
        return called.attr
    return called.id if isinstance(called, ast.Name) else ""


def _assigned(nodes: list[ast.AST] | list[ast.stmt]) -> dict[str, list[ast.expr]]:
    """Return the values that statements assign to each name."""
    result: dict[str, list[ast.expr]] = {}
    for node in nodes:
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
            result.setdefault(node.targets[0].id, []).append(node.value)
    return result


def _texts(node: ast.expr, names: dict[str, list[ast.expr]], depth: int = 3) -> list[str]:
    """Return the texts that an expression may have; none where it holds no text of its own."""
    if isinstance(node, ast.Constant):
        return [node.value] if isinstance(node.value, str) else []
    if isinstance(node, ast.JoinedStr):
        return ["".join(_piece(value) for value in node.values)]
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        sides = [
            _texts(item, names, depth) or [f"{{{ast.unparse(item)}}}"]
            for item in (node.left, node.right)
        ]
        return [a + b for a in sides[0] for b in sides[1]]
    if isinstance(node, ast.Name) and depth:
        return [text for item in names.get(node.id, ()) for text in _texts(item, names, depth - 1)]
    if isinstance(node, ast.IfExp):
        return _texts(node.body, names, depth) + _texts(node.orelse, names, depth)
    if isinstance(node, ast.List | ast.Tuple):
        return [text for elt in node.elts for text in _texts(elt, names, depth)]
    return []


def _piece(node: ast.expr) -> str:
    """Return a piece of an f-string, a placeholder as its expression in braces."""
    if isinstance(node, ast.FormattedValue):
        return f"{{{ast.unparse(node.value)}}}"
    return str(node.value) if isinstance(node, ast.Constant) else ""


def main() -> None:
    """Print the catalogue, a heading for each package."""
    package = ""
    for message in messages():
        if message.package != package:
            package = message.package
            print(f"\n## {package}\n")
        print(f"{message.place}: {message.text}\n    {message.source}")


if __name__ == "__main__":
    main()
