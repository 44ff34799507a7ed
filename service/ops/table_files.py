"""The ledger's rows against the tables' files: each is the other's second copy."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np

from service.ledger import Ledger
from service.library.component import Component
from service.library.library import Library
from service.ops.findings import MEND, Finding, move_aside
from service.tables.files import TableFiles, new_row
from service.tables.news import usable, without
from service.tables.other_setup import unsolved
from surrogate.table.hdf5 import TableFileError, read_table
from surrogate.table.meta import TableMeta
from surrogate.table.rows import Rows

Found = dict[str, tuple[Rows, TableMeta]]


def check_tables(ledger: Ledger, library: Library, folder: Path, *, mend: bool) -> list[Finding]:
    """Compare every row of the ledger and every table's file, and mend either from the other."""
    whole, found = read_all(folder, mend=mend, count=ledger.count_rows)
    found += _damaged_rows(ledger, whole, mend=mend)
    files = TableFiles(folder, ledger)
    for name in library.names():
        found += _compare(ledger, library[name], files, whole.get(name), folder, mend=mend)
        found += _of_another_setup(ledger, library[name])
    strangers = sorted(whole.keys() - set(library.names()))
    what = "{} is the table of a component that is not in the library"
    remedy = "put its bundle into components/ again, or move the file away"
    return found + [Finding("note", what.format(f"tables/{name}.h5"), remedy) for name in strangers]


def read_all(
    folder: Path, *, mend: bool, count: Callable[[str], int] = lambda _: 0
) -> tuple[Found, list[Finding]]:
    """Return the tables of all files that are whole, and what is wrong with the others.

    `count` tells how many rows of a component the ledger has.
    """
    whole: Found = {}
    found = []
    for path in sorted(folder.glob("*.h5")):
        if not os.access(path, os.R_OK):
            remedy = f"make it readable and writable for user {os.getuid()}, as the server runs"
            found.append(Finding("fault", f"tables/{path.name} may not be read", remedy))
            continue
        try:
            rows, meta = read_table(path)
            if meta.component != path.stem:
                raise TableFileError(f"{path.name} is the table of {meta.component!r}")
        except (TableFileError, OSError) as error:
            what = f"tables/{path.name} cannot be used: {error}"
            found.append(_unusable(path, what, count(path.stem), mend=mend))
            continue
        whole[path.stem] = rows, meta
    return whole, found


def _unusable(path: Path, what: str, left: int, *, mend: bool) -> Finding:
    """Tell of a damaged file, and whether the ledger still has rows of it."""
    if not left:
        lost = "the ledger has no row of it: restore a backup, or load or solve its rows again"
        moved = f"moved to {move_aside(path).name}; " if mend else ""
        return Finding("fault", what, f"{moved}{lost}")
    if mend:
        return Finding("mended", what, f"moved to {move_aside(path).name}")
    return Finding("fault", what, f"the ledger has {left} rows of it; {MEND}")


def _damaged_rows(ledger: Ledger, whole: Found, *, mend: bool) -> list[Finding]:
    found = []
    for seq, named in ledger.unsound().items():
        what = f"row {seq} of {named} is damaged in the ledger"
        copy = _copy_of(seq, whole)
        if copy is None:
            remedy = (
                "no whole table file has it: ask for its wrench again to have it solved or load it "
                "again, or restore a backup"
            )
            found.append(Finding("fault", what, remedy))
        elif not mend:
            found.append(Finding("fault", what, f"tables/{copy[0]}.h5 has it; {MEND}"))
        elif ledger.heal(copy[0], seq, new_row(copy[1], copy[2])):
            found.append(Finding("mended", what, f"written anew from tables/{copy[0]}.h5"))
        else:
            remedy = "the same row is there under another number, which is used"
            found.append(Finding("note", what, remedy))
    return found


def _copy_of(seq: int, whole: Found) -> tuple[str, Rows, int] | None:
    for name, (rows, _) in whole.items():
        places = np.flatnonzero(rows.seq == seq)
        if len(places):
            return name, rows, int(places[0])
    return None


def _compare(
    ledger: Ledger,
    component: Component,
    files: TableFiles,
    held: tuple[Rows, TableMeta] | None,
    folder: Path,
    *,
    mend: bool,
) -> list[Finding]:
    """Compare one component's file with the ledger; written anew if it is missing or older."""
    name = component.name
    count = ledger.count_rows(name)
    if held is None:
        if not count:
            return []
        what = f"tables/{name}.h5 is not there; the ledger has {count} rows of it"
    elif held[1].ledger and held[1].ledger == ledger.digest(name, held[1].last_seq):
        return []
    else:
        what = f"tables/{name}.h5 and the ledger do not have the same rows up to {held[1].last_seq}"
    if not mend:
        return [Finding("fault" if held else "note", what, f"a server's start or {MEND}")]
    before = count
    files.load(component)  # puts back into the ledger what the file alone has
    rows, last_seq = whole_table(ledger, component)
    folder.mkdir(parents=True, exist_ok=True)
    files.save(component, rows, last_seq)
    back = ledger.count_rows(name) - before
    remedy = f"{back} rows put back into the ledger; the file written anew with {len(rows)} rows"
    return [Finding("mended", what, remedy)]


def _of_another_setup(ledger: Ledger, component: Component) -> list[Finding]:
    """Tell the rows that no table shows, since the component's files have changed."""
    others = ledger.of_other_setups(component.name, component.fingerprint)
    if not others:
        return []
    rows, _ = whole_table(ledger, component)
    told = component.linear and bool(np.isfinite(rows.compliance).all(axis=(1, 2)).any())
    wrenches = unsolved(component, others, rows.wrench)
    if told or not len(wrenches):  # one solve of a linear component tells all of it
        return []
    what = f"{sum(others.values())} rows of {component.name} belong to another setup of it"
    again = f"wrenchbook resolve {component.name} solves their {len(wrenches)} wrenches again"
    back = "they come back if its files are as they were"
    remedy = f"{again}; {back}" if component.has_fea else back
    return [Finding("note", what, remedy)]


def whole_table(ledger: Ledger, component: Component) -> tuple[Rows, int]:
    """Return all rows that the ledger has of a component, and up to which number."""
    rows, after = Rows.empty(), 0
    while True:
        news = ledger.news(component.name, after)
        rows, after = without(rows, news) + usable(component, news), news.last_seq
        if news.whole:
            return rows, after
