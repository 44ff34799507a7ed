"""Generated Markdown: the reference of HTTP calls and commands, and the site's navigation.

``make reference`` writes the tables of commands, calls and names, which the repository has too; the
site has all options, fields and docstrings.
"""

import ast
import dataclasses
import inspect
import json
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable
from functools import cache
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
    """Return the commands and their options with their purposes, two tables a group."""
    rows, options = {}, {}
    for name, group in typer.main.get_command(program).commands.items():
        for word, command in getattr(group, "commands", {"": group}).items():
            call = [name, *filter(None, [word]), *_positional(name, command)]
            purpose = (command.help or group.help or "").partition("\n\n")[0]
            rows.setdefault(name, []).append((f"`{' '.join(call)}`", purpose))
            for option, meaning in _options(name, command):
                callers = options.setdefault((option, meaning), [])
                callers.append(" ".join([name, *filter(None, [word])]))

    def table(group: tuple[str, ...]) -> list[str]:
        """Return the options of a group's commands; a meaning that several have is there once."""
        lines = [
            (f"`{option}`", ", ".join(f"`{call}`" for call in callers), meaning)
            for (option, meaning), callers in options.items()
            if callers[0].partition(" ")[0] in group
        ]
        return _table(("option", "of", "meaning"), lines)

    return _grouped("command", COMMANDS, rows, ("command", "purpose"), table)


COMMON = ("--json", "--server", "--data")
"""Options that the page describes above its tables."""


COMMANDS = {
    "Run": ("serve", "work", "demo", "doctor", "backup", "restore"),
    "Describe a part": ("new", "check", "converge", "condense", "components"),
    "Fill and query": (
        *("fill", "query", "solve", "export", "deformed", "joint", "stiffness", "compliance"),
        *("plan", "report", "recording", "envelope", "resolve"),
    ),
    "Measure": ("import", "rig", "withdraw", "compare"),
    "Operate": ("jobs", "audit", "keys"),
}
"""The commands by their use."""


def _grouped(
    kind: str, groups: dict, rows: dict, head: tuple[str, ...], after: Callable = lambda group: ()
) -> list[str]:
    """Return a heading and a table for each group, and the lines that `after` has for its names.

    A name without a group is a mistake.
    """
    names = [name for group in groups.values() for name in group]
    if set(names) != set(rows):
        raise ValueError(f"not each {kind} is in one group: {set(names) ^ set(rows)}")
    lines = []
    for heading, group in groups.items():
        lines += [f"## {heading}", "", *_table(head, [row for name in group for row in rows[name]])]
        lines += after(group)
    return lines


def _positional(name: str, command: Any) -> list[str]:
    """Return the positional arguments of a command; optional ones in brackets."""
    if name in PROGRAMS:
        usage = _help_of(name).partition("\n\n")[0]
        return re.sub(r"\[-[^]]*\]", "", usage.partition(f"{name} ")[2]).upper().split()
    items = [item for item in command.params if item.param_type_name == "argument"]
    shown = [(item.metavar or item.name or "").strip("{}[]").upper() for item in items]
    return [word if item.required else f"[{word}]" for item, word in zip(items, shown, strict=True)]


def _options(name: str, command: Any) -> list[tuple[str, str]]:
    """Return a command's own options and their meanings, of `PROGRAMS` from their help."""
    if name in PROGRAMS:
        listed = re.findall(
            r"^  (?:-\w, )?(--[\w-]+)(?: \S+)*?(?:  +|\n +)(.*)", _help_of(name), re.M
        )
    else:
        shown = [item for item in command.params if not getattr(item, "hidden", False)]
        listed = [
            (text, _meaning(item)) for item in shown for text in item.opts if text.startswith("--")
        ]
    return [pair for pair in listed if pair[0] not in (*COMMON, "--help")]


def _meaning(option: Any) -> str:
    """Return the help of an option, with allowed values and default unless the help has them."""
    text = option.help or ""
    values = [str(value) for value in getattr(option.type, "choices", ())]
    if values and not all(value in text for value in values):
        text += f"; one of {', '.join(values)}"
    default = getattr(option.default, "value", option.default)
    if isinstance(option.show_default, str):  # of a setting, which the command line leaves unset
        default = option.show_default
    if type(default) in (int, float, str) and default != "" and "default" not in text:
        text += f"; default {default}"
    return text


@cache
def _help_of(name: str) -> str:
    """Return the help of a command of `PROGRAMS`, whose arguments typer does not know."""
    arguments = [sys.executable, "-m", "wrenchbook.fea.check.commands", name, "--help"]
    wide = {**os.environ, "COLUMNS": "1000"}  # argparse breaks lines at the terminal's width
    return subprocess.run(arguments, capture_output=True, text=True, check=True, env=wide).stdout


def calls() -> list[str]:
    """Return the HTTP calls and their purposes, a table a group."""
    rows = {heading: [] for heading in CALLS}
    for path, methods in sorted(_openapi()["paths"].items(), key=_place):
        heading = next(key for key, pattern in CALLS.items() if re.search(pattern, path))
        rows[heading] += [
            (f"`{method.upper()} {path}`", call.get("summary", ""))
            for method, call in methods.items()
        ]
    groups = {heading: (heading,) for heading in CALLS}
    tables = _grouped("call", groups, rows, ("call", "purpose"))
    return [*tables, "## Problems", "", *_table(("type", "status", "titles"), _problems())]


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


def _problems() -> list[tuple[str, str, str]]:
    """Return the types of problem replies with their status and titles, from the program's source.

    They are at each refusal, and for errors of other packages in a table of `problems.py`.
    """
    titles: dict[tuple[str, str], list[str]] = {}
    for file in sorted((FOLDER.parents[1] / "service").rglob("*.py")):
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
                titles.setdefault((str(kind), str(status or "")), []).append(str(title))
    return [
        (f"`{kind}`", status, "; ".join(sorted(set(titles[kind, status]))))
        for kind, status in sorted(titles)
    ]


COMPOSED = {
    "bad-bundle": "The component bundle has mistakes",
    "cross-site": "Pages of other sites may not call this server",
    "http": "The name of the status, such as Not Found",
    "key": "A key is needed; The key has expired",
    "no-files": "No files yet; The files are gone",
    "scope": "The key's scope does not allow this; The user's scope does not allow this",
}
"""Titles that a variable has in the source, by the end of the problem's type."""


def names() -> list[str]:
    """Return the public names, calls and attributes with their purposes, a table a section."""
    rows = {name: _rows_of(name) for name in wrenchbook.__all__ if name != "__version__"}
    return _grouped("name", SECTIONS, rows, ("name", "purpose"), _parameters)


def _parameters(group: tuple[str, ...]) -> list[str]:
    """Return the parameters of the main calls of a group of public names, a table a call."""
    lines = []
    for call, described in PARAMETERS.items():
        if call.partition(".")[0] in group:
            rows = [
                (", ".join(f"`{name}`" for name in names.split(", ")), kind, text)
                for names, kind, text in _described(described, "Parameters")
            ]
            lines += [f"### Parameters of `{call}`", ""]
            lines += _table(("parameter", "type", "meaning"), rows)
    return lines


SECTIONS = {
    "Client": ("Client", "AsyncClient"),
    "Answers": ("Displacement", "Displacements", "DeformedShape", "Stress"),
    "Tables": ("Table",),
    "Joints": (
        *("Joint", "MujocoJoint", "step_joints", "pull_joints", "joints_in_mj_step"),
        *("JointReport", "Joints", "MujocoJoints", "LinearPart"),
    ),
    "Mounts": ("Mount", "MujocoMount", "Settled"),
    "Conventions": ("conventions",),
    "Arrays of JAX and PyTorch": ("arrays",),
    "Figures": ("plot",),
    "Scenes": ("Scene", "ComponentPlan"),
    "Jobs and events": ("Job", "Round", "Event"),
    "Recordings": ("Recorder", "Recording", "Envelope", "Started"),
    "Errors": (
        *("WrenchbookError", "InvalidArgument", "MissingPackage", "ProblemError", "RecorderError"),
        *("SceneError", "ServerTimeout", "ServerUnreachable", "TableError", "MountError"),
        *("SensorError", "DisplacementUnknown", "CouplingDiverged", "MountWarning", "JointError"),
        *("JointRangeError", "JointWarning"),
    ),
}
"""The public names by their use, in the order of the page."""
MADE_BY_CALLS = (
    *SECTIONS["Answers"],
    *("Table", "JointReport", "LinearPart", "Settled", "ComponentPlan", "Job", "Round", "Event"),
    *("Recording", "Envelope", "Started"),
)
"""The classes whose objects a call returns: their constructors are no part of the reference."""
CLASS_METHODS = ("Table.open", "Scene.read")  # the others read replies of the server
INTERNAL = (
    *("Client.send_block", "AsyncClient.send_block"),
    *(
        f"{kind}.{call}"
        for kind in ("Joint", "MujocoJoint")
        for call in ("new_steps", "warn_beyond", "warn_uncovered", "weakest")
    ),
    *("MujocoJoint.attach", "MujocoJoint.lose_wrench", "MujocoJoint.read_scene"),
    *("Scene.component", "Scene.query"),
)
"""Public members that other modules of the client call, and no program."""
PARAMETERS = {
    "Client": wrenchbook.Client,
    "Client.displacement": wrenchbook.Client.displacement,
    "Client.fill": wrenchbook.Client.fill,
    "Client.import_table": wrenchbook.Client.import_table,
    "Joint": wrenchbook.Joint,
    "Joint.step": wrenchbook.Joint.step,
    "MujocoJoint": wrenchbook.MujocoJoint,
    "Mount": wrenchbook.Mount,
    "MujocoMount": wrenchbook.MujocoMount,
    "Scene": wrenchbook.Scene,
    "Recorder": wrenchbook.Recorder,
}
"""The main calls, and where their parameters are described."""
OF_MODULE = {
    "arrays": ("jax", "torch", "jax_joint"),
    "conventions": (
        *("from_mujoco", "to_mujoco", "from_drake", "to_drake", "from_pybullet", "to_pybullet"),
        *("from_ros", "to_ros", "moved", "quaternion_wxyz", "quaternion_xyzw"),
    ),
    "plot": ("response", "coverage", "deformed"),
}


def _rows_of(name: str) -> list[tuple[str, str]]:
    """Return the rows of a public name and of its members."""
    value = getattr(wrenchbook, name)
    if name in OF_MODULE:
        members = [(f"{name}.{call}", getattr(value, call)) for call in OF_MODULE[name]]
    elif not inspect.isclass(value):
        return [(f"`{name}{_arguments(value)}`", _purpose(value))]
    elif issubclass(value, Exception) or name == "AsyncClient":
        return [(f"`{name}`", _purpose(value))]
    else:
        named = [(f"{name}.{key}", member) for key, member in inspect.getmembers(value)]
        members = [
            (call, member)
            for call, member in named
            if call in CLASS_METHODS or (inspect.isfunction(member) and call not in INTERNAL)
            if not call.partition(".")[2].startswith("_")
        ]
    rows = [(f"`{name}`", _purpose(value))]
    if name not in (*MADE_BY_CALLS, *OF_MODULE):
        rows.append((f"`{name}{_arguments(value)}`", "The constructor."))
    if name not in OF_MODULE:
        rows += [(f"`{name}.{attribute}`", text) for attribute, text in _attributes(value)]
    return rows + [(f"`{call}{_arguments(member)}`", _purpose(member)) for call, member in members]


def _purpose(value: object) -> str:
    return (value.__doc__ or "").partition("\n")[0].replace("``", "`")


def _described(value: object, section: str) -> list[tuple[str, str, str]]:
    """Return the names, types and texts of a section of a docstring."""
    text = inspect.cleandoc(value.__doc__ or "").partition(f"\n{section}\n")[2]
    text = re.split(r"\n\n", text)[0].replace("``", "`")  # the next section follows an empty line
    entry = r"^(\*{0,2}\w[\w, ]*?)(?: : (.*))?$((?:\n    .*)*)"
    return re.findall(entry, text, re.M)


def _attributes(value: type) -> list[tuple[str, str]]:
    """Return the attributes that a class' docstring describes, then its other properties.

    Fields of a reply without such a description have that of the OpenAPI document.
    """
    described = _described(value, "Attributes")
    if not described and dataclasses.is_dataclass(value):
        described = _described(value, "Parameters")
    rows = [(names, text) for names, _, text in described]
    named = {name for names, _, _ in described for name in names.split(", ")}
    properties = inspect.getmembers(value, lambda member: isinstance(member, property))
    if not described and dataclasses.is_dataclass(value):
        fields = dataclasses.fields(value)
        rows += [(field.name, _field_text(value, field.name)) for field in fields]
    return rows + [
        (name, _purpose(member))
        for name, member in properties
        if name not in named and not name.startswith("_")
    ]


def _field_text(value: type, field: str) -> str:
    """Return the description of a reply's field, by the schema of the class or of its base."""
    schemas = _openapi()["components"]["schemas"]
    schema = next(schemas[base.__name__] for base in value.__mro__ if base.__name__ in schemas)
    text = schema["properties"].get(field, {"description": "name of the component"})["description"]
    for json_word in ("null", "true", "false"):
        text = re.sub(rf"\b{json_word}\b", repr(json.loads(json_word)), text)
    return f"{text[0].upper()}{text[1:]}."


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
"""The tables in the pages of the reference, below their introductions."""


def with_table(page: str) -> str:
    """Return the text of a page of the reference with its tables written anew."""
    introduction = (FOLDER / f"reference/{page}.md").read_text().partition("\n## ")[0]
    return "\n".join([introduction.rstrip(), "", *TABLES[page]()]).rstrip() + "\n"


def python() -> str:
    """Return the docstrings of the public names, which Sphinx reads."""
    lines = ["", "## Docstrings", "", "```{eval-rst}", ".. automodule:: wrenchbook"]
    lines += ["   :no-members:", ""]
    for name in (name for group in SECTIONS.values() for name in group):
        value = getattr(wrenchbook, name)
        if name in OF_MODULE:
            kind, options = "module", {"members": ", ".join(OF_MODULE[name])}
        elif not inspect.isclass(value):
            kind, options = "function", {}
        elif issubclass(value, Exception):
            kind, options = "exception", {}
        else:
            kind = "class"
            options = {"members": "close"} if name == "AsyncClient" else _shown_members(name)
        place = value.__name__ if name in OF_MODULE else f"wrenchbook.{name}"
        lines.append(f".. auto{kind}:: {place}")
        lines += [f"   :{option}: {text}".rstrip() for option, text in options.items()]
        lines.append("")
    return "\n".join([*lines, "```", ""])


def _shown_members(name: str) -> dict[str, str]:
    """Return the options of autodoc for a class: its members, also inherited calls of a client."""
    hidden = [item.partition(".")[2] for item in INTERNAL if item.startswith(f"{name}.")]
    options = {"members": ""} | ({"exclude-members": ", ".join(hidden)} if hidden else {})
    return options | ({"inherited-members": ""} if name in ("Client", "Mount") else {})


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


@cache
def _openapi() -> dict:
    with tempfile.TemporaryDirectory() as folder:
        return create_app(Settings(Path(folder), solvers=0)).openapi()


def _place(path: tuple[str, dict]) -> int:
    """Put the calls of a component first, those for other protocols and operators last."""
    starts = ("/v1/components/{name}/displacement", "/v1/", "/")
    return next(place for place, start in enumerate(starts) if path[0].startswith(start))


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
    rows = []
    for name, field in schema.get("properties", {}).items():
        default = f"`{json.dumps(field['default'])}`" if "default" in field else ""
        default = "required" if name in needed else default
        rows.append((f"`{name}`", _type(field), default, _text(field)))
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
    "data/docs/reference/python": python,
}
"""The pages that the functions' text is appended to."""


if __name__ == "__main__":
    for name in TABLES:
        (FOLDER / f"reference/{name}.md").write_text(with_table(name))
