"""Commands that work on this machine rather than ask a server."""

from __future__ import annotations

import subprocess
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from service.files.child import child_command

DEFAULT_DATA = Path("wrenchbook-data")


def serve(
    data: Annotated[Path, typer.Option(help="data directory", envvar="WRENCHBOOK_DATA")] = (
        DEFAULT_DATA
    ),
    host: Annotated[str, typer.Option(help="address to listen on")] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535, help="0 takes a free one")] = 8000,
    solvers: Annotated[int, typer.Option(min=0, help="solves at once")] = 2,
    engine: Annotated[str, typer.Option(help="where solves run: local")] = "local",
    allow_decks: Annotated[
        bool, typer.Option(help="take uploaded bundles with a deck: solvers run its command")
    ] = False,
    queue_limit: Annotated[
        int, typer.Option(min=0, help="open jobs of a component that queries may have")
    ] = 64,
    log_level: Annotated[str, typer.Option(help="debug, info, warning or error")] = "info",
) -> None:
    """Serve the API and solve what is queued."""
    from service.http.server import serve as run
    from service.jobs.engines.registry import ENGINES
    from service.workspace import Settings

    if engine not in ENGINES:
        raise typer.BadParameter(f"there is no engine {engine!r}; there are: {', '.join(ENGINES)}")
    run(Settings(data, solvers, engine, allow_decks, queue_limit), host, port, log_level)


def work(
    data: Annotated[Path, typer.Option(help="data directory", envvar="WRENCHBOOK_DATA")] = (
        DEFAULT_DATA
    ),
    solvers: Annotated[int, typer.Option(min=1, help="solves at once")] = 2,
) -> None:
    """Only solve: take jobs from the data directory that a server accepts them in."""
    from service.cli.worker import work as run

    run(data, solvers)


def demo(
    keep: Annotated[Path | None, typer.Option(help="keep the data directory here")] = None,
) -> None:
    """Show the main job end to end on real finite elements; about five minutes."""
    from service.cli.demo import run

    raise typer.Exit(run(Console(), keep))


def validate(
    topic: Annotated[
        str, typer.Argument(help="patch, bar, plate, curved_beam, spring or all")
    ] = "all",
    markdown: Annotated[bool, typer.Option(help="print the tables as Markdown")] = False,
) -> None:
    """Verify the solver against closed forms, published numbers and CalculiX; minutes for all."""
    # In a process of its own: this one never imports the finite elements.
    words = child_command("fea.validation", topic, *(["--markdown"] * markdown))
    raise typer.Exit(subprocess.run(words, check=False).returncode)


def check(
    bundle: Annotated[Path, typer.Argument(help="the bundle's folder")],
    as_json: Annotated[bool, typer.Option("--json", help="print the report as JSON")] = False,
) -> None:
    """Check a component bundle before it is uploaded: mesh, groups, supports, cost of a solve."""
    words = child_command("fea.check", *(() if as_json else ("--text",)), str(bundle))
    raise typer.Exit(subprocess.run(words, check=False).returncode)


LOCAL_COMMANDS = (serve, work, demo, check, validate)
