"""Reproduce the paper: ``python -m data.paper FOLDER [--quick]``.

Writes ``paper.html`` and ``paper.json`` into the folder, prints a table of what was found, and ends
with status 1 if a band is missed. It runs in a process of its own, as every solve does, next to a
private server on an empty data directory.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table
from threadpoolctl import threadpool_limits

from data.paper.arm import arm
from data.paper.bar import tip_load
from data.paper.page import HEAD, as_page, lines_of
from data.paper.part import PAPER, QUICK, WHOLE, Effort, ProgressCallback
from data.paper.spring import spring
from wrenchbook.service.client import Client
from wrenchbook.service.files.durable import write_atomically
from wrenchbook.service.workers.private import private_server

PARTS = {"bar": tip_load, "spring": spring, "arm": arm}
SOLVERS = 2  # of the server, at once
_COLOURS = {"pass": "green", "FAIL": "bold red"}


def run(client: Client, effort: Effort, report: ProgressCallback) -> dict[str, Any]:
    """Run all parts on a server; return findings, numbers and plots as JSON-able values."""
    began, parts = time.monotonic(), {}
    for number, (name, part) in enumerate(PARTS.items()):

        def progress(fraction: float, message: str, number: int = number) -> None:
            report((number + fraction) / len(PARTS), message)

        parts[name] = part(client, effort, progress).as_body()
    verdicts = [finding["verdict"] for part in parts.values() for finding in part["findings"]]
    passed, missed = verdicts.count("pass"), verdicts.count("FAIL")
    seconds = time.monotonic() - began
    return {
        "source": PAPER,
        "made": datetime.now(UTC).isoformat(timespec="seconds"),
        "quick": effort is QUICK,
        "seconds": seconds,
        "bands": {"held": passed, "missed": missed, "reported": verdicts.count("reported")},
        "summary": f"{passed} bands held, {missed} missed; {seconds:.0f} s"
        + ", the quick form" * (effort is QUICK),
        "parts": parts,
    }


def main(folder: Path, quick: bool) -> int:
    """Reproduce the paper into a folder; return the exit status."""
    folder.mkdir(parents=True, exist_ok=True)
    columns = BarColumn(), TextColumn("{task.description}"), TimeElapsedColumn()
    with (
        threadpool_limits(limits=1),  # the solvers have the other core
        tempfile.TemporaryDirectory(prefix="wrenchbook-") as data,
        private_server(Path(data), SOLVERS) as client,
        Progress(*columns, console=Console(stderr=True)) as progress,
    ):
        task = progress.add_task("starting", total=1.0)
        body = run(
            client,
            QUICK if quick else WHOLE,
            lambda part, text: progress.update(task, completed=part, description=text),
        )
        progress.update(task, completed=1.0, description="done")
    written = json.dumps(body, allow_nan=False).encode()
    write_atomically(folder / "paper.json", written)
    write_atomically(folder / "paper.html", as_page(body).encode())
    _print(body, folder)
    return 1 if body["bands"]["missed"] else 0


def _print(body: dict[str, Any], folder: Path) -> None:
    """Print all findings as a table, and where the page is."""
    # A pipe has no width of its own; eighty columns would cut the quantities to pieces.
    out = Console(width=None if sys.stdout.isatty() else 160)
    table = Table(title="The coupling paper, reproduced")
    for name in HEAD:
        table.add_column(name, overflow="fold")
    for part in body["parts"].values():
        for *cells, verdict in lines_of(part["findings"]):
            table.add_row(*cells, verdict, style=_COLOURS.get(verdict, ""))
        table.add_section()
    out.print(table)
    out.print(
        f"{body['summary']}. {folder / 'paper.html'}, {folder / 'paper.json'}", soft_wrap=True
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--quick", action="store_true")
    options = parser.parse_args()
    sys.exit(main(options.folder, options.quick))
