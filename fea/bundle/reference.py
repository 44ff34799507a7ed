"""The reference of ``component.toml``, generated from its models: JSON schema, tables of a page.

As a program this module rewrites the tables of data/docs/reference/component.md, each below the
heading of its table.
"""

from __future__ import annotations

import ast
import inspect
import json
import re
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import is_dataclass
from functools import cache
from itertools import chain, pairwise
from pathlib import Path
from typing import Any, get_args, get_origin

from pydantic import TypeAdapter
from pydantic.fields import FieldInfo

from wrenchbook.fea.bundle.tables import ComponentFile
from wrenchbook.fea.spec.keys import extra_of, keys_of, tables_in

PAGE = Path(__file__).resolve().parents[2] / "data/docs/reference/component.md"


def json_schema() -> dict[str, Any]:
    """Return the JSON schema of a parsed ``component.toml``, draft 2020-12."""
    schema = TypeAdapter(ComponentFile).json_schema(by_alias=True)
    for cls in {ComponentFile, *chain.from_iterable(tables().values())}:
        part = schema if cls is ComponentFile else schema["$defs"][cls.__name__]
        for key, text in descriptions(cls).items():
            part["properties"][key]["description"] = text
    schema = _tidy(schema)
    head = {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": "component.toml"}
    return head | {key: value for key, value in schema.items() if key not in head}


def _tidy(part: Any) -> Any:
    """Return a part of a schema without null, which TOML lacks, and with examples as values."""
    if isinstance(part, list):
        return [_tidy(item) for item in part if item != {"type": "null"}]
    if not isinstance(part, dict):
        return part
    tidy = {k: _tidy(v) for k, v in part.items() if k not in _OURS or isinstance(v, dict)}
    if len(tidy.get("anyOf", ())) == 1:
        tidy |= tidy.pop("anyOf")[0]
    if part.get("default", ...) is None:
        del tidy["default"]
    if isinstance(example := part.get("example"), str):
        tidy["examples"] = [tomllib.loads(f"x = {example}")["x"]]
    if isinstance(unit := part.get("unit"), str) and "description" in part:
        tidy["description"] = f"{part['description']} ({unit})"
    return tidy


@cache
def descriptions(cls: type) -> dict[str, str]:
    """Return the description of each key of a model: the text below its field in the source."""
    texts: dict[str, str] = {}
    for base in reversed(cls.__mro__[:-1]):
        (source,) = ast.parse(inspect.getsource(base)).body
        for entry, text in pairwise(getattr(source, "body", ())):
            match entry, text:
                case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(ast.Constant(str(note))):
                    texts[name] = " ".join(note.split())
    names = {info.alias: name for name, info in vars(cls)["__pydantic_fields__"].items()}
    return {key: texts[names.get(key, key)] for key in keys_of(cls)}


# Metadata of `key` and pydantic that is left out of a schema.
_OURS = ("example", "default_text", "expected_text", "choices", "title")


def tables() -> dict[str, list[type]]:
    """Return the models of each table by its heading, in the order of the file."""
    by_heading: dict[str, list[type]] = {"component.toml": [ComponentFile]}
    waiting = [("", [ComponentFile])]
    for path, classes in waiting:
        for key, infos in _fields(classes).items():
            kind = infos[0].annotation
            if not (below := list(dict.fromkeys(tables_in(kind)))):
                continue
            name = f"{path}.{key}" if path else key
            name += ".NAME" if get_origin(kind) is Mapping else ""
            single = get_origin(kind) is Mapping or _has_single(kind)
            by_heading[f"[{name}]" if single else f"[[{name}]]"] = below
            waiting.append((name, below))
    return by_heading


def _has_single(kind: Any) -> bool:
    """Return whether a type is, or may be, a single table and not an array of tables."""
    if get_origin(kind) is tuple:
        return False
    return is_dataclass(kind) or any(map(_has_single, get_args(kind)))


def _fields(classes: list[type]) -> dict[str, list[FieldInfo]]:
    """Return the fields of each key of the models that share a table."""
    fields: dict[str, list[FieldInfo]] = {}
    for cls in classes:
        for key, info in keys_of(cls).items():
            fields.setdefault(key, []).append(info)
    return fields


def rows(classes: list[type]) -> Iterator[str]:
    """Yield the lines of a table's reference: key, unit, default, example and meaning."""
    yield "| key | unit | default | example | meaning |"
    yield "| --- | --- | --- | --- | --- |"
    for key, infos in _fields(classes).items():
        extra = extra_of(infos[0])
        text = next(descriptions(cls)[key] for cls in classes if key in keys_of(cls))
        unit = extra.get("unit", "").replace("^2", "²").replace("^3", "³")
        example = extra.get("example", "")
        cells = [f"`{key}`", unit, _default(infos[0]), f"`{example}`", text]
        yield f"| {' | '.join(cells)} |".replace("|  |", "| |")


def _default(info: FieldInfo) -> str:
    """Return a key's default as text: a value, "required", or the text for its absence."""
    if default_text := extra_of(info).get("default_text"):
        return default_text
    if info.is_required():
        return "-"
    if info.default is None:
        return "none"
    value = list(info.default) if isinstance(info.default, tuple) else info.default
    return f"`{value:g}`" if isinstance(value, float) else f"`{json.dumps(value)}`"


def page(text: str) -> str:
    """Return the page's text with its tables regenerated from the models."""
    for heading, classes in tables().items():
        pattern = rf"(?m)(^## {re.escape(heading)}\n(?:(?!^[|#]).*\n)*)(?:^\|.*\n)*"
        table = "".join(f"{line}\n" for line in rows(classes))
        text, count = re.subn(pattern, lambda match, table=table: match[1] + table, text)
        if count != 1:
            raise ValueError(f"the page must have the heading ## {heading} once")
    return text


if __name__ == "__main__":
    PAGE.write_text(page(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
