"""The state of the house: rooms, circles, lengths, duplicates, and what docstrings state.

``make house`` prints it; tests/test_house.py asserts what must hold. Counted are the rooms and the
public face, not the tests. What each figure means:

* room, files, lines: Python of the rooms through which an answer goes, their own rooms included;
* upward imports: imports against a ``layers`` contract of pyproject.toml, also over several steps;
* circles: groups of modules that import each other, directly or over others, in whatever place of
  the file the import stands;
* helpers with one caller: private functions and methods whose name stands once more in their file;
* forwarders: functions whose body is one call with their own parameters, in order;
* files with one importer: modules that a single module imports, packages' faces apart;
* forms of a row: classes with fields for a wrench and for its displacement;
* duplicates: ten or more lines of code in a row that are the same in two places, token by token,
  once comments, docstrings, imports and layout are taken away;
* decision thresholds: numeric constants of the surrogate's modules and fields of its settings, with
  a number between `GUARD` and `SIZE`: a smaller one guards against rounding, a larger one is a size
  or a budget.
"""

from __future__ import annotations

import ast
import io
import re
import statistics
import tokenize
import tomllib
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import grimp

ROOT = Path(__file__).resolve().parents[1]
# Words of this project's own that names of the field take the place of.
OLD_WORDS = frozenset(
    [
        "asked",
        "bar",
        "beside",
        "care",
        "copies",
        "crew",
        "demand",
        "discreet",
        "door",
        "doubt",
        "errand",
        "fence",
        "following",
        "gathering",
        "grant",
        "healing",
        "held",
        "image",
        "lean",
        "member",
        "mend",
        "mended",
        "net",
        "news",
        "opening",
        "orders",
        "ordering",
        "parcel",
        "patient",
        "pulse",
        "said",
        "shelf",
        "sites",
        "straight",
        "strangers",
        "tare",
        "told",
        "turn",
        "wanted",
        "warden",
    ]
)
ROOMS = ("fea", "surrogate", "service")
COUNTED = (
    "surrogate",
    "service/tables",
    "service/fields",
    "service/fmu",
    "service/client",
)
"""Rooms whose size `make house` tells: those through which an answer goes."""
DUPLICATE_LINES = 10
GUARD, SIZE = 1e-5, 64
CODES = ("kernel/", "packed/", "scene/cut.py", "table/foreign.py", "table/hdf5.py", "table/meta.py")
"""Files of the surrogate whose numbers are indices, codes and sizes of formats."""
NO_DECISIONS = {"HOLE", "SLOPES_SMOOTHNESS", "DECIMALS", "MAX_LISTED"}
"""Of the others: a code, kinds of kernels, rounding in digits, the length of a list for people."""

Function = ast.FunctionDef | ast.AsyncFunctionDef
FORWARDING = ast.Return | ast.Expr
WRENCH_FIELDS = {"wrench", "wrenches", "inputs"}
DISPLACEMENT_FIELDS = {"displacement", "displacements", "outputs"}
Place = tuple[str, int]


@dataclass(frozen=True)
class Source:
    """One file: its path below the root, its text and its syntax tree."""

    path: str
    text: str
    tree: ast.Module

    @property
    def room(self) -> str:
        """The folder it is in."""
        return str(Path(self.path).parent)


@cache
def sources() -> tuple[Source, ...]:
    """Read the files of the rooms and the public face."""
    paths = [ROOT / "src/wrenchbook/__init__.py"]
    paths += [path for room in ROOMS for path in sorted((ROOT / room).rglob("*.py"))]
    texts = [(str(path.relative_to(ROOT)), path.read_text(encoding="utf-8")) for path in paths]
    return tuple(Source(path, text, ast.parse(text)) for path, text in texts)


@cache
def graph() -> grimp.ImportGraph:
    """Return the imports of all modules, those inside functions included, those of types not."""
    return grimp.build_graph("wrenchbook", exclude_type_checking_imports=True, cache_dir=None)


def imports() -> dict[str, set[str]]:
    """Return the modules that each module imports."""
    return {name: graph().find_modules_directly_imported_by(name) for name in graph().modules}


def circles(imported: Mapping[str, set[str]]) -> list[list[str]]:
    """Return the groups of modules that import each other (Tarjan 1972: connected components)."""
    number: dict[str, int] = {}
    lowest: dict[str, int] = {}
    stack: list[str] = []
    results: list[list[str]] = []

    def visit(name: str) -> None:
        number[name] = lowest[name] = len(number)
        stack.append(name)
        for other in imported[name]:
            if other not in number:
                visit(other)
                lowest[name] = min(lowest[name], lowest[other])
            elif other in stack:
                lowest[name] = min(lowest[name], number[other])
        if lowest[name] == number[name]:
            place = stack.index(name)
            if len(stack) - place > 1:
                results.append(sorted(stack[place:]))
            del stack[place:]

    for name in sorted(imported):
        if name not in number:
            visit(name)
    return results


def upward_imports() -> list[str]:
    """Return the imports against the layers contracts, as ``importer -> imported``."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    results = set()
    for contract in settings["tool"]["importlinter"]["contracts"]:
        if contract["type"] != "layers":
            continue
        layers = [
            grimp.Layer(*re.split(r"\s*[|:]\s*", layer.strip("()")), independent="|" in layer)
            for layer in contract["layers"]
        ]
        for wrong in graph().find_illegal_dependencies_for_layers(
            layers=layers, containers=set(contract.get("containers", ()))
        ):
            results |= {
                " -> ".join([*route.heads, *route.middle, *route.tails]) for route in wrong.routes
            }
    return sorted(results)


def helpers_with_one_caller(among: Iterable[Source]) -> list[str]:
    """Return private functions named at one place beside their own, as ``path:line name``."""
    result = []
    for source in among:
        names = Counter(
            node.id if isinstance(node, ast.Name) else node.attr
            for node in ast.walk(source.tree)
            if isinstance(node, ast.Name | ast.Attribute)
        )
        result += [
            f"{source.path}:{node.lineno} {node.name}"
            for node in ast.walk(source.tree)
            if isinstance(node, Function)
            and re.match(r"_(?!_)", node.name)
            and names[node.name] == 1
        ]
    return result


def forwarders(among: Iterable[Source]) -> list[str]:
    """Return functions that only call another with their own parameters, as ``path:line name``."""
    results = []
    for source in among:
        for node in ast.walk(source.tree):
            if not isinstance(node, Function):
                continue
            is_documented = ast.get_docstring(node) is not None
            body = node.body[1:] if is_documented else node.body
            call = body[0].value if len(body) == 1 and isinstance(body[0], FORWARDING) else None
            call = call.value if isinstance(call, ast.Await) else call
            if not isinstance(call, ast.Call):
                continue
            own = [arg.arg for arg in (*node.args.args, *node.args.kwonlyargs)]
            own = [name for name in own if name not in ("self", "cls")]
            passed = [*call.args, *(keyword.value for keyword in call.keywords)]
            if own and own == [arg.id if isinstance(arg, ast.Name) else "" for arg in passed]:
                results.append(f"{source.path}:{node.lineno} {node.name}")
    return results


def row_forms(among: Iterable[Source]) -> list[str]:
    """Return the classes that hold a wrench and its displacement, as ``path:line name``."""
    results = []
    for source in among:
        for node in ast.walk(source.tree):
            if isinstance(node, ast.ClassDef):
                fields = {
                    item.target.id
                    for item in node.body
                    if isinstance(item, ast.AnnAssign) and isinstance(item.target, ast.Name)
                }
                if fields & WRENCH_FIELDS and fields & DISPLACEMENT_FIELDS:
                    results.append(f"{source.path}:{node.lineno} {node.name}")
    return results


def functions() -> Iterator[int]:
    """Yield the length of each function in lines, from ``def`` to its last line."""
    for source in sources():
        for node in ast.walk(source.tree):
            if isinstance(node, Function):
                assert node.end_lineno is not None
                yield node.end_lineno - node.lineno + 1


def duplicates(among: Iterable[Source]) -> list[tuple[Place, Place, int]]:
    """Return pairs of places (path, line) with the same code, and over how many lines."""
    files = [(source.path, _code_lines(source)) for source in among]
    seen: dict[tuple[str, ...], list[tuple[int, int]]] = defaultdict(list)
    for file, (_, lines) in enumerate(files):
        for start in range(len(lines) - DUPLICATE_LINES + 1):
            window = tuple(code for _, code in lines[start : start + DUPLICATE_LINES])
            seen[window].append((file, start))
    pairs = {
        (one, other)
        for places in seen.values()
        for number, one in enumerate(places)
        for other in places[number + 1 :]
        # A run that repeats itself, such as the rows of a list, is no copy of itself.
        if one[0] != other[0] or other[1] - one[1] >= DUPLICATE_LINES
    }
    results = []
    for (file, start), (other, place) in sorted(pairs):
        if ((file, start - 1), (other, place - 1)) in pairs:
            continue  # inside a longer one that starts before
        length = DUPLICATE_LINES
        while (
            (file, start + length - DUPLICATE_LINES + 1),
            (other, place + length - DUPLICATE_LINES + 1),
        ) in pairs:
            length += 1
        first = (files[file][0], files[file][1][start][0])
        results.append((first, (files[other][0], files[other][1][place][0]), length))
    return results


def _code_lines(source: Source) -> list[tuple[int, str]]:
    """Return (line number, its tokens) of the lines that hold code."""
    left_out = set()
    for node in ast.walk(source.tree):
        is_text = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
        if isinstance(node, ast.stmt) and (
            is_text or isinstance(node, ast.Import | ast.ImportFrom)
        ):
            left_out |= set(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    lines: dict[int, list[str]] = defaultdict(list)
    layout = {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT}
    for token in tokenize.generate_tokens(io.StringIO(source.text).readline):
        if token.type not in layout and token.start[0] not in left_out and token.string.strip():
            lines[token.start[0]].append(token.string)
    return [(number, " ".join(tokens)) for number, tokens in sorted(lines.items())]


def old_words(among: Iterable[Source]) -> Counter[str]:
    """Return how often names that the code binds contain each of `OLD_WORDS`."""
    result: Counter[str] = Counter()
    for source in among:
        for node in ast.walk(source.tree):
            parts = re.split(r"_|(?<=[a-z])(?=[A-Z])", _bound_name(node))
            result.update(part.lower() for part in parts if part.lower() in OLD_WORDS)
    return result


def _bound_name(node: ast.AST) -> str:
    if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
        return node.name
    if isinstance(node, ast.arg):
        return node.arg
    if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
        return node.id
    if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
        return node.attr
    return ""


def repeated_classes(among: Iterable[Source]) -> list[str]:
    """Return public class names that several files have, with how many."""
    names = Counter(
        node.name
        for source in among
        for node in source.tree.body
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_")
    )
    return [f"{count:4d} {name}" for name, count in sorted(names.items()) if count > 1]


def _is_decision(value: ast.expr) -> bool:
    """Whether a value is a number, or several, of which one decides; 0, 1, 2, ... are codes."""
    try:
        reported = ast.literal_eval(value)
    except ValueError:
        return False
    reported = tuple(reported.values()) if isinstance(reported, dict) else reported
    numbers = reported if isinstance(reported, tuple) else (reported,)
    is_numeric = all(type(number) in (int, float) for number in numbers)
    codes = tuple(range(len(numbers)))
    return is_numeric and numbers != codes and any(GUARD < abs(item) < SIZE for item in numbers)


def decision_thresholds(among: Iterable[Source]) -> list[str]:
    """Return the surrogate's named numbers that decide something."""
    results = []
    for source in among:
        path = source.path.removeprefix("surrogate/")
        if path == source.path or path.startswith(CODES):
            continue
        classes = [node for node in source.tree.body if isinstance(node, ast.ClassDef)]
        fields = [node for item in classes if item.name.endswith("Settings") for node in item.body]
        for node in (*source.tree.body, *fields):
            if not isinstance(node, ast.Assign | ast.AnnAssign) or not node.value:
                continue
            target = node.targets[0] if isinstance(node, ast.Assign) else node.target
            names = {part.id for part in ast.walk(target) if isinstance(part, ast.Name)}
            if _is_decision(node.value) and not names & NO_DECISIONS:
                text = f"{ast.unparse(target)} = {ast.unparse(node.value)}"
                results.append(f"{source.path}:{node.lineno} {text}")
    return results


def files_with_one_importer() -> list[str]:
    """Return the modules that a single module imports, with their lines."""
    importers: dict[str, set[str]] = defaultdict(set)
    for name, others in imports().items():
        for other in others:
            importers[other].add(name)
    results = []
    for source in sources():
        name = f"wrenchbook.{source.path.removesuffix('.py').replace('/', '.')}"
        if len(importers[name]) == 1 and not source.path.endswith("__init__.py"):
            lines = len(source.text.splitlines())
            results.append(f"{lines:4d} {source.path}, imported by {min(importers[name])}")
    return results


def sizes(among: Iterable[Source]) -> dict[str, tuple[int, int]]:
    """Return how many files and lines of Python each counted room has, its own rooms included."""
    result = dict.fromkeys(COUNTED, (0, 0))
    for source in among:
        for room in COUNTED:
            if source.path.startswith(f"{room}/"):
                files, lines = result[room]
                result[room] = files + 1, lines + len(source.text.splitlines())
    return result


def _size_lines() -> list[str]:
    reported = sizes(sources())
    whole = tuple(map(sum, zip(*reported.values(), strict=True)))
    table = [*reported.items(), ("together", whole)]
    width = max(len(room) for room, _ in table)
    return [
        f"{'room':{width}s}  files   lines",
        *(f"{room:{width}s} {files:6d} {lines:7d}" for room, (files, lines) in table),
    ]


def report() -> str:
    """Lay out all figures."""
    lengths = sorted(functions())
    same, text = duplicates(sources()), old_words(sources())
    packages = Counter(source.path.partition("/")[0] for source in sources())
    lines = [f"{count:4d} files in {package}" for package, count in sorted(packages.items())]
    lines += _size_lines()
    lines += _list("circles", [" <-> ".join(circle) for circle in circles(imports())])
    lines += _list("upward imports", upward_imports())
    lines += [
        f"{len(lengths)} functions: median {statistics.median(lengths):g} lines, "
        f"90 % within {lengths[int(0.9 * len(lengths))]}, longest {lengths[-1]}"
    ]
    lines += _list(
        f"duplicates of {DUPLICATE_LINES} lines or more",
        [f"{size:4d} {a[0]}:{a[1]} = {b[0]}:{b[1]}" for a, b, size in same],
    )
    lines += _list("helpers with one caller", helpers_with_one_caller(sources()))
    lines += _list("forwarders", forwarders(sources()))
    lines += _list("files with one importer", files_with_one_importer())
    lines += _list("forms of a row", row_forms(sources()))
    lines += _list(
        f"words in names that are to go ({sum(text.values())} times)",
        [f"{count:4d} {word}" for word, count in text.most_common()],
    )
    lines += _list("class names of several files", repeated_classes(sources()))
    lines += _list("decision thresholds of the surrogate", decision_thresholds(sources()))
    whole = sum(len(source.text.splitlines()) for source in sources())
    lines += [f"product Python: {whole} lines in {len(sources())} files"]
    return "\n".join(lines)


def _list(title: str, results: list[str]) -> list[str]:
    return [f"{title}: {len(results)}", *(f"    {result}" for result in results)]


if __name__ == "__main__":
    print(report())
