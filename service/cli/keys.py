"""``wrenchbook keys``: the keys of a data directory; servers take changes up within a second."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated, Literal

import typer
from rich.table import Table

from wrenchbook.service.cli.connect import AsJson, print_json
from wrenchbook.service.cli.screen import Screen
from wrenchbook.service.keys import MEGABYTES, RATE, Keyring

DEFAULT_DATA = Path("wrenchbook-data")
FIRST = "first"

keys = typer.Typer(no_args_is_help=True, help="List, add and revoke access keys.")

Folder = Annotated[Path, typer.Option(help="data directory", envvar="WRENCHBOOK_DATA")]
KeyName = Annotated[str, typer.Argument(help="name of the key's owner")]
ScopeName = Annotated[
    Literal["read", "write", "admin"],
    typer.Option(help="read: GET and queries; write: also changes; admin: also keys and decks"),
]
Rate = Annotated[float, typer.Option(help="largest number of requests a second")]
Megabytes = Annotated[int, typer.Option(help="largest body, MiB")]


@keys.command("add")
def add(
    name: KeyName,
    scope: ScopeName = "write",
    rate: Rate = RATE,
    megabytes: Megabytes = MEGABYTES,
    as_json: AsJson = False,
    data: Folder = DEFAULT_DATA,
) -> None:
    """Make a key and print it once."""
    key = Keyring(data).add(name, scope, rate=rate, megabytes=megabytes)
    print_json({"name": name, "scope": scope, "key": key}) if as_json else typer.echo(key)
    typer.echo(f"The key {name} for {scope}; it is not stored and not shown again.", err=True)


@keys.command("list")
def list_(as_json: AsJson = False, data: Folder = DEFAULT_DATA) -> None:
    """List the keys, without their secrets."""
    listed = [key.public() for key in Keyring(data).listed()]
    if as_json:
        print_json(listed)
        return
    table = Table("name", "scope", "made", "a second", "MiB")
    for key in listed:
        made = time.strftime("%Y-%m-%d", time.gmtime(key["created"]))
        table.add_row(key["name"], key["scope"], made, f"{key['rate']:g}", str(key["megabytes"]))
    Screen().print(table)


@keys.command("revoke")
def revoke(name: KeyName, as_json: AsJson = False, data: Folder = DEFAULT_DATA) -> None:
    """Revoke a key; servers refuse it within a second."""
    Keyring(data).revoke(name)
    if as_json:
        print_json({"name": name, "revoked": True})
    else:
        typer.echo(f"The key {name} is revoked.")


def make_first_key(data: Path, *, err: bool = False) -> None:
    """Make an admin key in a data directory without keys, and print it once, on stderr if `err`."""
    keyring = Keyring(data)
    if len(keyring):
        return
    secret = keyring.add(FIRST, "admin")
    typer.echo(f"The first key, for admin, shown this once: {secret}", err=err)
