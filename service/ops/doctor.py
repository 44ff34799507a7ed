"""The doctor: compares the ledger, the table files and all other files of a data directory.

The ledger and the table files have the same rows; each is repaired from the other. Nothing is
deleted: what is replaced is moved aside.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from wrenchbook.service.files.durable import sync_folder
from wrenchbook.service.ledger import Ledger, LedgerDamagedError, LedgerError, NewRow, repair
from wrenchbook.service.ledger.repair import Acknowledged, Salvaged, Spare, salvage
from wrenchbook.service.ledger.rows import rewrite
from wrenchbook.service.library.component import Component
from wrenchbook.service.library.library import Library
from wrenchbook.service.ops.backup import LEDGER
from wrenchbook.service.ops.checks import (
    REPAIR,
    DataFinding,
    check_disk,
    check_side_files,
    find_leftovers,
    move_aside,
)
from wrenchbook.service.ops.restore import in_use
from wrenchbook.service.tables.rows import followed, unsolved
from wrenchbook.service.tables.store import TableStore, new_row
from wrenchbook.surrogate.table.hdf5 import TableFileError, read_table
from wrenchbook.surrogate.table.meta import TableMeta
from wrenchbook.surrogate.table.rows import Rows

Found = dict[str, tuple[Rows, TableMeta]]
_KEPT = "The damaged one was moved aside; a backup may have more"


def examine(folder: Path, *, mend: bool = False) -> list[DataFinding]:
    """Check a data directory; repair what another copy has.

    A server may use the directory meanwhile, except for the repair of a damaged ledger file.

    Parameters
    ----------
    folder : path
        The data directory.
    mend : bool
        Whether to repair.
    """
    folder = folder.absolute()
    if not folder.is_dir():
        return [
            DataFinding("fault", f"there is no data directory {folder}", "say which with --data")
        ]
    found = [*check_disk(folder), *check_side_files(folder, mend=mend)]
    ledger, of_ledger = _opened(folder, mend=mend)
    found += of_ledger
    if ledger is None:
        return found
    try:
        library = Library(folder / "components")
        found += [
            DataFinding("fault", f"component {name} cannot be used: {why}", "mend its files")
            for name, why in library.broken().items()
        ]
        found += _check_tables(ledger, library, folder / "tables", mend=mend)
        found += find_leftovers(folder, ledger)
        found += _losses(ledger, mend=mend)
    except LedgerError as error:
        found.append(DataFinding("fault", str(error)))
    finally:
        ledger.close()
    return found


def _opened(folder: Path, *, mend: bool) -> tuple[Ledger | None, list[DataFinding]]:
    """Return the ledger, repaired if necessary; None if it cannot be used."""
    path = folder / LEDGER
    log = path.with_name(f"{LEDGER}-wal")
    found = []
    if _has_bytes(log) and not _has_bytes(path):
        what = f"there is {log.name} without {LEDGER}: what was newest is in it and not readable"
        if not mend:
            return None, [DataFinding("fault", what, f"put {LEDGER} back; if it is gone, {REPAIR}")]
        found.append(DataFinding("mended", what, f"moved to {move_aside(log, 'orphan').name}"))
    if not _has_bytes(path):
        what = f"{LEDGER} is empty" if path.exists() else f"there is no {LEDGER}"
        if not mend:
            remedy = f"put it back or restore a backup; tables/ has rows, but no jobs; {REPAIR}"
            return None, [*found, DataFinding("fault", what, remedy)]
        found.append(DataFinding("mended", what, "a new one was made; see the tables below"))
    try:
        return Ledger(path), found
    except LedgerDamagedError as error:
        if not mend:
            remedy = f"stop the server and restore a backup, or {REPAIR}"
            return None, [*found, DataFinding("fault", str(error), remedy)]
        if in_use(folder):
            remedy = "stop the server that uses it, then mend"
            return None, [*found, DataFinding("fault", str(error), remedy)]
        found += _rebuilt(folder, str(error))
    except LedgerError as error:
        return None, [*found, DataFinding("fault", str(error))]
    ledger, more = _opened(folder, mend=False)
    return ledger, found + more


def _losses(ledger: Ledger, *, mend: bool) -> list[DataFinding]:
    """Return acknowledged jobs and rows that are gone; with `mend` for the last time."""
    losses = ledger.losses()
    if not mend or not losses:
        return [DataFinding("fault", one, "settle it with: --mend") for one in losses]
    acknowledged = Acknowledged(ledger.path)
    with ledger.reading() as db:
        gone = repair.lost(db, acknowledged)
    acknowledged.settle(lambda file: move_aside(file, "settled"))
    found = [DataFinding("mended", one, "noted; it is told no more") for one in losses]
    if not any(gone):
        return found
    return [*found, _gone(f"up to {gone.rows} rows and {gone.jobs} jobs")]


def _gone(what: str) -> DataFinding:
    remedy = "restore a backup, or load or solve them again; the next look does not repeat this"
    return DataFinding("fault", f"{what} that were acknowledged are gone", remedy)


def _rebuilt(folder: Path, what: str) -> list[DataFinding]:
    """Replace a damaged ledger that no server uses."""
    made = _salvaged(folder)
    jobs, rows = made.read["jobs"], made.read["rows"]
    text = f"a new one was made: {jobs} jobs of {made.given} and {rows} rows could be read, others "
    text += "come from the tables' files"
    text += f"; jobs that were lost: {lost}" if (lost := made.given - jobs) > 0 else ""
    again = f"; {made.reopened} jobs wait again, their rows being lost" if made.reopened else ""
    found = [DataFinding("mended", what, f"{text}{again}. {_KEPT}")]
    return [*found, _gone(f"up to {made.lost_rows} rows")] if made.lost_rows else found


def _salvaged(folder: Path) -> Salvaged:
    """Replace a damaged ledger by the readable part of it and of the table files."""
    path = folder / LEDGER
    with tempfile.TemporaryDirectory(prefix=".mending-", dir=folder) as scratch:
        copy, new = Path(scratch) / "damaged.sqlite", Path(scratch) / LEDGER
        shutil.copyfile(path, copy)
        if _has_bytes(log := path.with_name(f"{LEDGER}-wal")):
            shutil.copyfile(log, copy.with_name(f"{copy.name}-wal"))
        made = salvage(copy, new, _spare(folder / "tables"), Acknowledged(path))
        for end in ("-wal", "-shm", ""):
            if (old := path.with_name(f"{LEDGER}{end}")).exists():
                move_aside(old)
        new.rename(path)
        sync_folder(folder)
    return made


def _spare(tables: Path) -> Iterator[Spare]:
    whole, _ = _read_all(tables, mend=False)
    for name, (rows, _) in whole.items():
        written = (tables / f"{name}.h5").stat().st_mtime
        for place, seq in enumerate(rows.seq.tolist()):
            yield name, seq, new_row(rows, place), written


def _has_bytes(path: Path) -> bool:
    return path.exists() and path.stat().st_size > 0


def _check_tables(
    ledger: Ledger, library: Library, folder: Path, *, mend: bool
) -> list[DataFinding]:
    """Compare the rows of the ledger and of the table files; repair either from the other."""
    whole, found = _read_all(folder, mend=mend, count=ledger.count_rows)
    found += _damaged_rows(ledger, whole, mend=mend)
    files = TableStore(folder, ledger)
    for name in library.names():
        found += _compare(ledger, library[name], files, whole.get(name), mend=mend)
        found += _of_another_setup(ledger, library[name])
    unknown = sorted(whole.keys() - set(library.names()))
    what = "{} is the table of a component that is not in the library"
    remedy = "put its bundle into components/ again, or move the file away"
    return found + [
        DataFinding("note", what.format(f"tables/{name}.h5"), remedy) for name in unknown
    ]


def _read_all(
    folder: Path, *, mend: bool, count: Callable[[str], int] = lambda _: 0
) -> tuple[Found, list[DataFinding]]:
    """Return the tables of all readable files, and findings on the others.

    `count` returns how many rows of a component the ledger has.
    """
    whole: Found = {}
    found = []
    for path in sorted(folder.glob("*.h5")):
        if not os.access(path, os.R_OK):
            remedy = f"make it readable and writable for user {os.getuid()}, as the server runs"
            found.append(DataFinding("fault", f"tables/{path.name} may not be read", remedy))
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


def _unusable(path: Path, what: str, left: int, *, mend: bool) -> DataFinding:
    """Return the finding on a damaged table file; `left` rows of it are in the ledger."""
    if not left:
        lost = "the ledger has no row of it: restore a backup, or load or solve its rows again"
        moved = f"moved to {move_aside(path).name}; " if mend else ""
        return DataFinding("fault", what, f"{moved}{lost}")
    if mend:
        return DataFinding("mended", what, f"moved to {move_aside(path).name}")
    return DataFinding("fault", what, f"the ledger has {left} rows of it; {REPAIR}")


def _damaged_rows(ledger: Ledger, whole: Found, *, mend: bool) -> list[DataFinding]:
    found = []
    with ledger.reading() as db:
        damaged = repair.damaged_rows(db)
    for seq, named in damaged.items():
        what = f"row {seq} of {named} is damaged in the ledger"
        copy = _copy_of(seq, whole)
        if copy is None:
            remedy = (
                "no whole table file has it: ask for its wrench again to have it solved or load it "
                "again, or restore a backup"
            )
            found.append(DataFinding("fault", what, remedy))
        elif not mend:
            found.append(DataFinding("fault", what, f"tables/{copy[0]}.h5 has it; {REPAIR}"))
        elif _rewritten(ledger, copy[0], seq, new_row(copy[1], copy[2])):
            found.append(DataFinding("mended", what, f"written anew from tables/{copy[0]}.h5"))
        else:
            remedy = "the same row is there under another number, which is used"
            found.append(DataFinding("note", what, remedy))
    return found


def _rewritten(ledger: Ledger, component: str, seq: int, row: NewRow) -> bool:
    with ledger.writing() as db:
        return rewrite(db, component, seq, row)


def _copy_of(seq: int, whole: Found) -> tuple[str, Rows, int] | None:
    for name, (rows, _) in whole.items():
        places = np.flatnonzero(rows.seq == seq)
        if len(places):
            return name, rows, int(places[0])
    return None


def _compare(
    ledger: Ledger,
    component: Component,
    files: TableStore,
    on_file: tuple[Rows, TableMeta] | None,
    *,
    mend: bool,
) -> list[DataFinding]:
    """Compare a component's file with the ledger; write it again if it is missing or older."""
    name, count = component.name, ledger.count_rows(component.name)
    if on_file is None:
        if not count:
            return []
        what = f"tables/{name}.h5 is not there; the ledger has {count} rows of it"
    else:
        meta = on_file[1]
        if meta.ledger and meta.ledger == ledger.digest(name, meta.last_seq):
            return []
        what = f"tables/{name}.h5 and the ledger do not have the same rows up to {meta.last_seq}"
    if not mend:
        return [DataFinding("fault" if on_file else "note", what, f"a server's start or {REPAIR}")]
    files.load(component)  # puts rows that the file alone has back into the ledger
    rows, last_seq = followed(ledger, component, Rows.empty(component.space), 0)
    files.save(component, rows, last_seq)
    back = ledger.count_rows(name) - count
    remedy = f"{back} rows put back into the ledger; the file written anew with {len(rows)} rows"
    return [DataFinding("mended", what, remedy)]


def _of_another_setup(ledger: Ledger, component: Component) -> list[DataFinding]:
    """Find rows that no table has, since the component's files have changed."""
    others = ledger.of_other_setups(component.name, component.fingerprint)
    if not others:
        return []
    rows, _ = followed(ledger, component, Rows.empty(component.space), 0)
    known = component.linear and bool(np.isfinite(rows.compliance).all(axis=(1, 2)).any())
    wrenches = unsolved(component, others, rows.wrench)
    if known or not len(wrenches):  # one solve of a linear component determines its compliance
        return []
    what = f"{sum(others.values())} rows of {component.name} belong to another setup of it"
    again = f"wrenchbook resolve {component.name} solves their {len(wrenches)} wrenches again"
    back = "they come back if its files are as they were"
    remedy = f"{again}; {back}" if component.has_fea else back
    return [DataFinding("note", what, remedy)]
