"""Generated Markdown: the reference of HTTP calls and commands, and the site's navigation.

``make reference`` writes the tables of commands, calls and names, which the repository has too; the
site has all options, fields and docstrings.
"""

import inspect
import json
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import typer
import typer.cli

import wrenchbook
from wrenchbook.service.cli.local import PROGRAMS
from wrenchbook.service.cli.main import app as program
from wrenchbook.service.http.app import create_app
from wrenchbook.service.workspace import Settings

FOLDER = Path(__file__).parent


def commands() -> list[str]:
    """Return the table of commands, their purposes and their options."""
    rows = []
    for name, group in typer.main.get_command(program).commands.items():
        for word, command in getattr(group, "commands", {"": group}).items():
            purpose = (command.help or group.help or "").partition("\n\n")[0]
            options = " ".join(f"`{option}`" for option in _options(name, command))
            rows.append((f"`{f'{name} {word}'.strip()}`", purpose, options))
    return _table(("command", "purpose", "options"), rows)


def _options(name: str, command: Any) -> list[str]:
    """Return the options of a command; of those of `PROGRAMS` as their help lists them."""
    if name in PROGRAMS:
        return re.findall(r"^  (?:-\w, )?(--(?!help)[\w-]+)", _help_of(name), re.M)
    shown = [item for item in command.params if not getattr(item, "hidden", False)]
    return [text for item in shown for text in item.opts if text.startswith("--")]


def _help_of(name: str) -> str:
    """Return the help of a command of `PROGRAMS`, whose arguments typer does not know."""
    arguments = [sys.executable, "-m", "wrenchbook.fea.check.commands", name, "--help"]
    return subprocess.run(arguments, capture_output=True, text=True, check=True).stdout


def calls() -> list[str]:
    """Return the table of HTTP calls and their purposes."""
    paths = sorted(_openapi()["paths"].items(), key=_place)
    rows = [
        (f"`{method.upper()} {path}`", call.get("summary", ""))
        for path, methods in paths
        for method, call in methods.items()
    ]
    return _table(("call", "purpose"), rows)


def names() -> list[str]:
    """Return the table of the public names, calls and attributes, and their purposes."""
    rows = []
    for name in wrenchbook.__all__:
        value = getattr(wrenchbook, name)
        rows.append((f"`{name}`", _purpose(value)))
        if name in _WITH_CALLS:
            methods = inspect.getmembers(value, inspect.isfunction)
            public = [(call, method) for call, method in methods if not call.startswith("_")]
            made = "Connect to a server." if name == "Client" else "The constructor."
            rows.append((f"`{name}{_arguments(value)}`", made))
            rows += [(f"`{name}.{attribute}`", text) for attribute, text in _attributes(value)]
            rows += [
                (f"`{name}.{call}{_arguments(method)}`", _purpose(method))
                for call, method in public
            ]
    return _table(("name", "purpose"), rows)


_WITH_CALLS = ("Client", "Displacement", "Mount", "MujocoJoint", "MujocoMount", "Table")
"""The classes that most programs use: their calls are in the table, with arguments and defaults,
and their attributes.
"""


def _purpose(value: object) -> str:
    return (value.__doc__ or "").partition("\n")[0].replace("``", "`")


def _attributes(value: type) -> list[tuple[str, str]]:
    """Return the attributes that a class' docstring describes, then its other properties."""
    section = inspect.cleandoc(value.__doc__ or "").partition("\nAttributes\n")[2]
    section = re.split(r"\n\n", section)[0]  # the next section begins after an empty line
    described = re.findall(r"^(\w[\w, ]*) : .*((?:\n    .*)*)", section, re.M)
    named = {name for names, _ in described for name in names.split(", ")}
    properties = inspect.getmembers(value, lambda member: isinstance(member, property))
    return [(names, text.replace("``", "`")) for names, text in described] + [
        (name, _purpose(member))
        for name, member in properties
        if name not in named and not name.startswith("_")
    ]


def _arguments(call: Callable) -> str:
    """Return the arguments of a call with their defaults, without types."""
    signature = inspect.signature(call)
    plain = [
        argument.replace(annotation=argument.empty)
        for argument in signature.parameters.values()
        if argument.name != "self"
    ]
    return str(signature.replace(parameters=plain, return_annotation=signature.empty))


TABLES = {"cli": commands, "http": calls, "python": names}
"""The tables in the pages of the reference."""
_TABLE = re.compile(r"^\| .*\n(?:\|.*\n)+", re.M)


def with_table(page: str) -> str:
    """Return the text of a page of the reference with its table written anew."""
    table = "\n".join(TABLES[page]())
    return _TABLE.sub(lambda _: table, (FOLDER / f"reference/{page}.md").read_text(), count=1)


def cli() -> str:
    """Return the commands, their arguments and options."""
    command = typer.main.get_command(program)
    context = typer.Context(command, info_name="wrenchbook")
    for group in command.commands.values():
        group.short_help = (group.help or "").partition("\n\n")[0]  # not cut at 45 characters
    text = typer.cli.get_docs_for_click(obj=command, ctx=context, name="wrenchbook")
    for name in PROGRAMS:
        heading = f"## `wrenchbook {name}`"
        text = text.replace(f"{heading}\n", f"{heading}\n\n```text\n{_help_of(name)}```\n", 1)
    return "\n" + text.partition("\n")[2]


def http() -> str:
    """Return the calls of the OpenAPI document: what each takes and replies, and the schemas."""
    document = _openapi()
    calls = [
        _call(method, path, call)
        for path, methods in sorted(document["paths"].items(), key=_place)
        for method, call in methods.items()
    ]
    schemas = [_schema(*pair) for pair in sorted(document["components"]["schemas"].items())]
    return "\n".join(["", "## Calls", "", *calls, "## Schemas", "", *schemas])


def _openapi() -> dict:
    with tempfile.TemporaryDirectory() as folder:
        return create_app(Settings(Path(folder), solvers=0)).openapi()


def _place(path: tuple[str, dict]) -> int:
    """Put the calls of a component first, those for other protocols and operators last."""
    return (
        0
        if path[0].startswith("/v1/components/{name}/displacement")
        else (1 if path[0].startswith("/v1/") else 2)
    )


def _call(method: str, path: str, call: dict) -> str:
    lines = [f"### {method.upper()} {path}", "", f"**{call.get('summary', '')}**", ""]
    lines += [call.get("description", ""), ""]
    if call.get("parameters"):
        lines += _table(
            ("parameter", "in", "type", ""),
            [
                (f"`{item['name']}`", item["in"], _type(item["schema"]), _text(item))
                for item in call["parameters"]
            ],
        )
    for kind, body in call.get("requestBody", {}).get("content", {}).items():
        lines += [f"Body `{kind}`: {_type(body.get('schema', {}))}", ""]
        lines += _fields(body.get("schema", {}))
    replies = [
        (status, reply["description"], ", ".join(map(_content, reply.get("content", {}).items())))
        for status, reply in sorted(call["responses"].items())
    ]
    return "\n".join(lines + _table(("status", "reply", "content"), replies))


def _content(content: tuple[str, dict]) -> str:
    """Return a content type, and the type of its body where the document names one."""
    kind, body = content
    text = _type(body["schema"]) if body.get("schema") else ""
    return f"`{kind}`" + (f": {text}" if text not in ("", "any") else "")


def _schema(name: str, schema: dict) -> str:
    lines = [f"### {name}", "", schema.get("description", ""), ""]
    return "\n".join(lines + _fields(schema))


def _fields(schema: dict) -> list[str]:
    needed = schema.get("required", ())
    rows = [
        (f"`{name}`", _type(field), "required" if name in needed else _default(field), _text(field))
        for name, field in schema.get("properties", {}).items()
    ]
    return _table(("field", "type", "default", ""), rows) if rows else []


def _type(schema: dict) -> str:
    """Return a JSON type in words; a named schema is a link to its heading."""
    if "$ref" in schema:
        name = schema["$ref"].rpartition("/")[2]
        return f"[{name}](#{name.lower()})"
    if several := schema.get("anyOf") or schema.get("oneOf") or schema.get("allOf"):
        return " or ".join(dict.fromkeys(map(_type, several)))
    if "enum" in schema or "const" in schema:
        return ", ".join(
            f"`{json.dumps(value)}`" for value in schema.get("enum", [schema.get("const")])
        )
    if schema.get("type") == "array":
        items = _type(schema.get("items", {}))
        return f"array of ({items})" if " or " in items else f"array of {items}"
    return schema.get("format") or schema.get("type", "any")


def _default(schema: dict) -> str:
    return f"`{json.dumps(schema['default'])}`" if "default" in schema else ""


def _text(described: dict) -> str:
    return described.get("description", "")


def _table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> list[str]:
    lines = [head, tuple("---" for _ in head), *rows]
    cells = [[" ".join(cell.split()).replace("|", r"\|") for cell in line] for line in lines]
    return [f"| {' | '.join(line)} |" for line in cells] + [""]


def navigation() -> str:
    """Return the site's navigation: the tables of index.md, their first header as the caption.

    A link to a section is left out, a page of two tables is in the first.
    """
    lines, seen = [], set()
    for table in re.findall(r"(?:^\|.*\n)+", (FOLDER / "index.md").read_text(), re.M):
        caption = table.strip("| \n").partition(" |")[0].capitalize()
        lines += ["", "```{toctree}", f":caption: {caption}", ":maxdepth: 1", ":hidden:", ""]
        for text, page in re.findall(r"\[([^\]]+)\]\(([^)#]+)\.(?:md|ipynb)\)", table):
            if page not in seen:
                lines.append(f"{text} <{page}>" if page.endswith("README") else page)
            seen.add(page)
        lines.append("```")
    return "\n".join([*lines, ""])


PAGES = {
    "data/docs/index": navigation,
    "data/docs/reference/cli": cli,
    "data/docs/reference/http": http,
}
"""The pages that the functions' text is appended to."""


if __name__ == "__main__":
    for name in TABLES:
        (FOLDER / f"reference/{name}.md").write_text(with_table(name))
