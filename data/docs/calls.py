"""Reference of the HTTP calls: a section a call, its schemas, statuses and problems."""

import ast
import json
import re
import tempfile
from collections import Counter
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from data.docs.markdown import table
from wrenchbook.service.http.app import create_app
from wrenchbook.service.workspace import Settings

CALLS = {
    "Query": r"/displacements?$|/solve$|/deformed|/scene|^/umbridge",
    "Tables": (
        r"/table|/imports|/disagreement|/stiffness|/comparison|^/v1/rigs|/recording|/envelope|/fill$"
    ),
    "Jobs": r"^/v1/jobs|^/v1/events",
    "Components": r"^/v1/components",
    "Operation": r"",
}
"""The calls by their use: the first pattern that a path matches."""
USUAL = 50
"""A status with one text in so many calls is left out of their sections."""
COMPOSED = {
    "bad-bundle": "The component bundle has mistakes",
    "cross-site": "Pages of other sites may not call this server",
    "http": "The name of the status, such as Not Found",
    "key": "A key is needed; The key has expired",
    "no-files": "No files yet; The files are gone",
    "scope": "The key's scope does not allow this; The user's scope does not allow this",
}
"""Titles that a variable has in the source, by the end of the problem's type."""


@cache
def openapi() -> dict:
    """Return the OpenAPI document of a server."""
    with tempfile.TemporaryDirectory() as folder:
        return create_app(Settings(Path(folder), solvers=0)).openapi()


def calls() -> list[str]:
    """Return a table and a section a call for each group, then schemas, statuses and problems."""
    groups: dict[str, list[tuple[str, dict]]] = {heading: [] for heading in CALLS}
    for path, methods in sorted(openapi()["paths"].items(), key=_place):
        heading = next(key for key, pattern in CALLS.items() if re.search(pattern, path))
        groups[heading] += [(f"{method.upper()} {path}", call) for method, call in methods.items()]
    lines = []
    for heading, group in groups.items():
        rows = [(f"[`{name}`](#{_anchor(name)})", call.get("summary", "")) for name, call in group]
        lines += [f"## {heading}", "", *table(("call", "purpose"), rows)]
        lines += [line for name, call in group for line in _section(name, call)]
    return [
        *lines,
        *("## Schemas", "", *_schemas("\n".join(lines))),
        *("## Statuses", "", *table(("status", "meaning"), sorted(_usual_texts().items()))),
        *("## Problems", "", *table(("type", "status", "title"), [*_problems()])),
    ]


def _place(path: tuple[str, dict]) -> int:
    """Put the calls of a component first, those for other protocols and operators last."""
    starts = ("/v1/components/{name}/displacement", "/v1/", "/")
    return next(place for place, start in enumerate(starts) if path[0].startswith(start))


def _anchor(name: str) -> str:
    return re.sub(r"[^\w\- ]", "", name.lower()).replace(" ", "-")


def _section(name: str, call: dict) -> list[str]:
    """Return the description, the parameters and the replies of a call."""
    paragraphs = call.get("description", "").split("\n\n")
    text = [part for part in paragraphs if not re.match(r"\*\*\w+\*\*: ", part)]  # in wrench.md
    rows = [
        (f"`{item['name']}`", item["in"], *_kind(item["schema"], item), _text(item))
        for item in call.get("parameters", ())
    ]
    bodies = []
    for kind, body in call.get("requestBody", {}).get("content", {}).items():
        fields = _fields(body.get("schema", {}))
        rows += [(field, "form" if "form" in kind else "body", *rest) for field, *rest in fields]
        if not fields:
            bodies += [f"Body `{kind}`: {_text(body.get('schema', {})) or 'see above'}.", ""]
    return [
        *(f"### `{name}`", "", "\n\n".join(text) or f"{call.get('summary', '')}.", ""),
        *table(("parameter", "in", "type", "default", "meaning"), rows),
        *bodies,
        *_replies(call["responses"]),
    ]


def _replies(responses: dict) -> list[str]:
    """Return the replies of a call, and the numbers of errors whose text is the usual one."""
    rows, others = [], []
    for status, reply in sorted(responses.items()):
        content = ", ".join(_content(*pair) for pair in reply.get("content", {}).items())
        if status >= "4" and reply["description"] == _usual_texts()[status]:
            others += [f"[{status}](#statuses)"] if _counts()[status] < USUAL else []
        else:
            rows.append((status, reply["description"], content))
    errors = [f"Errors: {', '.join(others)}.", ""] if others else []
    return [*table(("status", "reply", "content"), rows), *errors]


@cache
def _counts() -> Counter:
    """Count the calls of each status with its usual text."""
    texts = _usual_texts()
    return Counter(
        status
        for methods in openapi()["paths"].values()
        for call in methods.values()
        for status, reply in call["responses"].items()
        if reply["description"] == texts.get(status)
    )


@cache
def _usual_texts() -> dict[str, str]:
    """Return the commonest text of each status of an error."""
    texts: dict[str, Counter] = {}
    for methods in openapi()["paths"].values():
        for call in methods.values():
            for status, reply in call["responses"].items():
                if status >= "4":
                    texts.setdefault(status, Counter())[reply["description"]] += 1
    return {status: counts.most_common(1)[0][0] for status, counts in texts.items()}


def _content(kind: str, body: dict) -> str:
    """Return a content type, and the type of its body where the document names one."""
    text = _type(body["schema"]) if body.get("schema") else ""
    return f"`{kind}`" + (f": {text}" if text not in ("", "any") else "")


def _schemas(linked: str) -> list[str]:
    """Return the schemas that a text links to, and those that these link to."""
    schemas, shown, lines = openapi()["components"]["schemas"], {}, []
    while True:
        text = linked + "\n".join(line for part in shown.values() for line in part)
        missing = [name for name in schemas if f"](#{name.lower()})" in text and name not in shown]
        if not missing:
            break
        for name in missing:
            head = ("field", "type", "default", "meaning")
            description = schemas[name].get("description", "")
            rows = [*_fields(schemas[name])]
            shown[name] = [f"### {name}", "", description, "", *table(head, rows)]
    for name in sorted(shown):
        lines += shown[name]
    return lines


def _fields(schema: dict) -> list[tuple[str, str, str, str]]:
    """Return the name, type, default and text of each field of a schema."""
    if "$ref" in schema:
        schema = openapi()["components"]["schemas"][schema["$ref"].rpartition("/")[2]]
    needed = schema.get("required", ())
    return [
        (f"`{name}`", *_kind(field, {"required": name in needed}), _text(field))
        for name, field in schema.get("properties", {}).items()
    ]


def _kind(schema: dict, described: dict) -> tuple[str, str]:
    """Return the type and the default of a parameter or field."""
    default = f"`{json.dumps(schema['default'])}`" if "default" in schema else ""
    return _type(schema), "required" if described.get("required") else default


def _type(schema: dict) -> str:
    """Return a JSON type in words; a named schema is a link to its heading."""
    if "$ref" in schema:
        name = schema["$ref"].rpartition("/")[2]
        return f"[{name}](#{name.lower()})"
    if several := schema.get("anyOf") or schema.get("oneOf") or schema.get("allOf"):
        return " or ".join(dict.fromkeys(map(_type, several)))
    if "enum" in schema or "const" in schema:
        values = schema.get("enum", [schema.get("const")])
        return ", ".join(f"`{json.dumps(value)}`" for value in values)
    if schema.get("type") == "array":
        items = _type(schema.get("items", {}))
        return f"array of ({items})" if " or " in items else f"array of {items}"
    return schema.get("format") or schema.get("type", "any")


def _text(described: dict) -> str:
    return described.get("description", "")


def _problems() -> Iterator[tuple[str, str, str]]:
    """Yield each type of a problem reply with its status and a title, from the program's source.

    They are at each refusal, and for errors of other packages in a table of `problems.py`.
    """
    titles: dict[tuple[str, str], set[str]] = {}
    for file in sorted((Path(__file__).parents[2] / "service").rglob("*.py")):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "HttpProblemError":
                items = node.args
            elif isinstance(node, ast.Tuple) and file.name == "problems.py":
                items = node.elts
            else:
                continue
            parts = [item.value if isinstance(item, ast.Constant) else None for item in items]
            status, kind, title = [*parts, None, None, None][:3]
            title = title or COMPOSED.get(str(kind))
            if kind and title and (isinstance(status, int) or kind == "http"):
                words = titles.setdefault((str(kind), str(status or "")), set())
                words |= {*str(title).split("; ")} if kind in COMPOSED else {str(title)}
    for kind, status in sorted(titles):
        for title in sorted(titles[kind, status]):
            yield f"`{kind}`", status, title
