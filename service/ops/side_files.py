"""The files beside the ledger and the tables: keys, settings, demand, solvers' errors, surfaces."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from service.fields.codec import DamagedFieldsError
from service.fields.record import read_geometry, read_row
from service.keys.keyring import Keyring, KeysError
from service.ops.findings import MEND, Finding, move_aside
from surrogate.solver_error import SolverError


def check_side_files(folder: Path, *, mend: bool) -> list[Finding]:
    """Tell which of them cannot be used; what is made anew by itself is moved aside if asked to."""
    found = list(_keys_and_settings(folder))
    for path, remedy, error in _damaged(folder):
        what = f"{path.relative_to(folder)} cannot be used: {error}"
        if mend:
            aside = move_aside(path).name
            found.append(Finding("mended", what, f"moved to {aside}; {remedy}"))
        else:
            found.append(Finding("fault", what, f"{remedy}, once it is moved away; {MEND}"))
    return found


def _keys_and_settings(folder: Path) -> Iterator[Finding]:
    """Give what nobody but its owner can mend: a wrong guess would let strangers in, or nobody."""
    try:
        Keyring(folder)
    except KeysError as error:
        yield Finding("fault", f"nobody is let in: {error}")
    path = folder / "wrenchbook.toml"
    try:
        tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return
    except (OSError, ValueError) as error:
        yield Finding("fault", f"{path.name} cannot be read as TOML: {error}", "mend it")


def _damaged(folder: Path) -> Iterator[tuple[Path, str, Exception]]:
    """Give the files that are not what was written, what becomes of that, and why."""
    begins = "the demand map begins anew"
    estimate = "bars lack the solver's share until the component's next solve estimates it again"
    surface = "its row answers as before; its surface comes from the others until it is solved anew"
    kinds = [
        ("demand.json", json.loads, begins),
        ("solver_errors/*/*.json", _solver_error, estimate),
        ("fields/*/*/*.fields", read_row, surface),
        ("fields/*/*/*.geometry", read_geometry, "surfaces come back with further solves"),
    ]
    for pattern, read, remedy in kinds:
        for path in sorted(folder.glob(pattern)):
            try:
                read(path.read_bytes())
            except FileNotFoundError:
                continue  # a server that is at work has removed it
            except (DamagedFieldsError, OSError, ValueError, TypeError, AttributeError) as error:
                yield path, remedy, error


def _solver_error(content: bytes) -> Any:
    return SolverError(json.loads(content))
