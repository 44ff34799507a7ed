"""Reference of the command line: a section a command, with its usage and its options."""

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from typing import Any

import typer

from data.docs.markdown import check_groups, table
from wrenchbook.service.cli.local import PROGRAMS
from wrenchbook.service.cli.main import app as program

COMMON = {"--json": "[--json]", "--server": "[--server URL]", "--data": "[--data DIR]"}
"""Options that the page describes above its sections, as the usage shows them."""
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
TYPES = {"str": "TEXT", "float": "NUMBER", "int": "N", "path": "FILE", "datetime": "TIME"}
"""Values of options without a metavar of their own."""


def commands() -> list[str]:
    """Return a heading for each group, and a section for each command."""
    known = typer.main.get_command(program).commands
    check_groups("command", COMMANDS, set(known))
    lines = []
    for heading, names in COMMANDS.items():
        lines += [f"## {heading}", ""]
        for name in names:
            for word, command in getattr(known[name], "commands", {"": known[name]}).items():
                lines += _section(" ".join(filter(None, [name, word])), command, known[name])
    return lines


def _section(call: str, command: Any, group: Any) -> list[str]:
    """Return the purpose, the usage and the options of a command."""
    purpose = (command.help or group.help or "").partition("\n\n")[0]
    options = [*(_printed(call) if call in PROGRAMS else _typed(command))]
    common = [text for name, text in COMMON.items() if name in (row[0] for row in options)]
    listed = [row for row in options if row[0] not in COMMON]
    arguments = [*_positional(call, command)]
    usage = [
        "wrenchbook",
        call,
        *(word for word, _ in arguments),
        *(["[OPTIONS]"] if listed else []),
    ]
    rows = [(f"`{word}`", "", meaning) for word, meaning in arguments]
    rows += [
        (f"`{' '.join([name, *filter(None, [value])])}`", default, text)
        for name, value, default, text in listed
    ]
    return [
        *(f"### {call}", "", " ".join(purpose.split()), ""),
        *("```text", " ".join([*usage, *common]), "```", ""),
        *table(("argument or option", "default", "meaning"), rows),
    ]


def _positional(call: str, command: Any) -> Iterator[tuple[str, str]]:
    """Yield the positional arguments of a command, optional ones in brackets, and meanings."""
    if call in PROGRAMS:
        usage, _, rest = _help_of(call).partition("\n\n")
        for word in re.sub(r"\[-[^]]*\]", "", usage.partition(f"{call} ")[2]).split():
            meaning = re.search(rf"^  {re.escape(word.strip('[]'))} +(.*)$", rest, re.M)
            yield word.upper(), meaning[1] if meaning else ""
        return
    for item in command.params:
        if item.param_type_name == "argument":
            word = (item.metavar or item.name or "").strip("{}[]").upper()
            yield word if item.required else f"[{word}]", getattr(item, "help", None) or ""


def _typed(command: Any) -> Iterator[tuple[str, str, str, str]]:
    """Yield each option of a typer command, its value, default and meaning."""
    for item in command.params:
        if item.param_type_name == "argument" or getattr(item, "hidden", False):
            continue
        kind = item.type.name.removesuffix(" range")
        value = "" if item.is_flag else item.metavar or TYPES.get(kind, kind.upper())
        text, choices = item.help or "", [str(word) for word in getattr(item.type, "choices", ())]
        if choices:
            value = item.metavar or "WORD"
            if not all(word in text for word in choices):
                text += f": {', '.join(choices)}"
        default = "" if "by default" in text else _default(item)
        for name in item.opts:
            if name != "--help":
                yield name, value, default, text + _limits(item.type)


def _default(item: Any) -> str:
    """Return the default of an option that states one."""
    default = getattr(item.default, "value", item.default)
    if isinstance(item.show_default, str):  # of a setting, which the command line leaves unset
        default = item.show_default
    shown = f"{default:g}" if type(default) is float else default
    return f"`{shown}`" if type(default) in (float, int, str) and default != "" else ""


def _limits(kind: Any) -> str:
    """Return the limits of a number, unless that is only that it may not be negative."""
    low, high = getattr(kind, "min", None), getattr(kind, "max", None)
    if high is not None:
        return f" ({low:g} to {high:g})"
    return f" ({low:g} or more)" if low else ""


def _printed(call: str) -> list[tuple[str, str, str, str]]:
    """Return the options of a command of `PROGRAMS`, from its help."""
    shown = r"^  (?:-\w, )?(--[\w-]+)((?: \S+)*?)(?:  +|\n +)(.*)"
    rows = []
    for name, value, text in re.findall(shown, _help_of(call), re.M):
        meaning, _, default = text.partition(" (default ")
        if name != "--help":
            rows.append((name, value.strip(), f"`{default[:-1]}`" if default else "", meaning))
    return rows


@cache
def _help_of(call: str) -> str:
    """Return the help of a command of `PROGRAMS`, whose arguments typer does not know."""
    arguments = [sys.executable, "-m", "wrenchbook.fea.check.commands", call, "--help"]
    wide = {**os.environ, "COLUMNS": "1000"}  # argparse breaks lines at the terminal's width
    return subprocess.run(arguments, capture_output=True, text=True, check=True, env=wide).stdout
