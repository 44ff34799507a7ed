"""The connection of a command to its server, and the options that commands share."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperCommand

from wrenchbook.fea.bundle.read import FILE_NAME
from wrenchbook.fea.bundle.shipped import SHIPPED
from wrenchbook.service.client import Client
from wrenchbook.service.client.errors import InvalidArgument

DEFAULT_SERVER = "http://127.0.0.1:8000"
_NO_NUMBER = re.compile(r"^(.+) is not a valid (int|integer|float)( range)?\.$")
_NO_RANGE = re.compile(r"^(\S+) is not in the range (?:(\S+?)(<=?))?x(?:([<>]=?)(\S+?))?\.$")
_BOUNDS = {">=": "at least", ">": "above", "<=": "at most", "<": "below"}
COMPLETION_S = 2.0  # s for which a shell waits at each tab


def component_names(ctx: typer.Context, incomplete: str) -> list[str]:
    """Return the components, of --data or of the server, with this beginning; [] on failure."""
    try:
        if data := ctx.params.get("data"):
            known = {path.parent.name for path in Path(data).glob(f"components/*/{FILE_NAME}")}
            known |= {path.parent.name for path in SHIPPED.glob(f"*/{FILE_NAME}")}
        else:
            with Client(ctx.params.get("server") or DEFAULT_SERVER, timeout=COMPLETION_S) as client:
                client.retry_s = 0.0
                known = {component["name"] for component in client.components()}
    except Exception:  # a shell that completes a word cannot show a message
        return []
    return sorted(name for name in known if name.startswith(incomplete))


def _refuse_both(ctx: typer.Context, value: Any) -> Any:
    """Refuse --server beside --data; a variable of the environment may name a server."""
    sources = [ctx.get_parameter_source(name) for name in ("server", "data")]
    if all(source is not None and source.name == "COMMANDLINE" for source in sources):
        raise typer.BadParameter("--server and --data exclude each other; leave one out")
    return value


class NumbersCommand(TyperCommand):
    """A command that refuses wrong numbers, and too few, in plain words."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Refuse an option of n numbers that another option follows before the n-th."""
        for option in self.params:
            if option.nargs < 2:
                continue
            for name in set(option.opts) & set(args):
                first = args.index(name) + 1
                for count, text in enumerate(args[first : first + option.nargs]):
                    if "," in text:
                        ctx.fail(f"{name} {text}: write {option.nargs} numbers separated by blanks")
                    if text.startswith("--"):
                        ctx.fail(f"{name} needs {option.nargs} numbers, but {text} follows {count}")
            if "--force" in option.opts and len(args) > 1 and re.match(r"[-+]?\.?\d", args[1]):
                ctx.fail(f"{args[1]}: write a wrench as --force FX FY FZ --moment MX MY MZ")
        try:
            return super().parse_args(ctx, args)
        except typer.BadParameter as error:
            error.message = _in_plain_words(error.message)
            raise


def _in_plain_words(message: str) -> str:
    """Return click's message on a wrong number in other words; any other message as it is."""
    if text := _NO_NUMBER.match(message):
        kind = "a number" if text[2] == "float" else "a whole number"
        return f"must be {kind}, not {text[1]}."
    if text := _NO_RANGE.match(message):
        value, low, less, sign, end = text.groups()
        bounds = [f"{_BOUNDS[less.replace('<', '>')]} {low}"] if low else []
        bounds += [f"{_BOUNDS[sign]} {end}"] if sign else []
        return f"must be {' and '.join(bounds)}, not {value}."
    return message


class Commands(typer.Typer):
    """A group whose commands are `NumbersCommand`s."""

    def command(self, name: str | None = None, **options: Any) -> Any:
        """Return the decorator of a command."""
        return super().command(name, cls=NumbersCommand, **options)


Name = Annotated[str, typer.Argument(help="name of the component", autocompletion=component_names)]
Server = Annotated[
    str,
    typer.Option(
        envvar="WRENCHBOOK_SERVER", help="address of a running server", callback=_refuse_both
    ),
]
Data = Annotated[
    Path | None,
    typer.Option(
        help="use this data directory by a temporary server, instead of --server",
        callback=_refuse_both,
    ),
]
BeyondRange = Annotated[
    bool, typer.Option("--beyond-range", help="solve wrenches outside the load range as well")
]
AsJson = Annotated[
    bool, typer.Option("--json", help="print JSON on stdout, and progress on stderr")
]

FurtherInput = Annotated[
    list[str] | None,
    typer.Option(
        "--input", help="a further input in its own unit; repeatable", metavar="NAME=NUMBER"
    ),
]

Three = tuple[float, float, float]
ZERO: Three = (0.0, 0.0, 0.0)


@contextmanager
def connected(server: str, data: Path | None, solvers: int = 2) -> Iterator[Client]:
    """Yield a client of the running server, or of a temporary one on ``data``."""
    if data is None:
        with Client(server) as client:
            client.retry_s = 0.0  # without a server its error, with the remedy, must come at once
            yield client
        return
    from wrenchbook.service.workers.private import private_server

    with private_server(data, solvers) as client:
        yield client


def further_inputs(options: list[str] | None) -> dict[str, float] | None:
    """Return the further inputs of ``--input NAME=NUMBER``; None without."""
    if not options:
        return None
    pairs = by_name("--input", "NAME=NUMBER", options)
    return {name: number(f"--input {name}", text) for name, text in pairs}


def by_name(option: str, form: str, values: list[str] | None) -> list[tuple[str, str]]:
    """Return the two sides of each value of an option, of a form such as NAME=NUMBER.

    Raises InvalidArgument if a value has no name or no ``=``, or a name is repeated.
    """
    pairs: dict[str, str] = {}
    for text in values or ():
        name, equals, value = text.partition("=")
        if not (name and equals):
            raise InvalidArgument(f"{option} {text!r} must have the form {option} {form}")
        if name in pairs:
            raise InvalidArgument(f"{option} {name} is given twice; keep one")
        pairs[name] = value
    return list(pairs.items())


def in_folder(file: Path | None) -> Path | None:
    """Refuse an output file whose folder does not exist, before anything is solved or served."""
    if file is not None and not file.parent.is_dir():
        raise typer.BadParameter(
            f"the folder {file.parent} for {file.name} does not exist; create it first, or name a "
            "file in another folder"
        )
    return file


def number(option: str, text: str) -> float:
    """Return the number of an option; raises InvalidArgument if it is none."""
    try:
        return float(text)
    except ValueError:
        raise InvalidArgument(f"{option}: {text!r} must be a number, such as -12.5") from None


def refuse_alone(needed: str, options: Mapping[str, object]) -> None:
    """Refuse options by name that have a value although the option `needed` has none."""
    names = ", ".join(name for name, value in options.items() if value)
    if names:
        raise typer.BadParameter(
            f"{names} has an effect only with {needed}; add {needed}, or leave {names} out"
        )
