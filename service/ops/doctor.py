"""The doctor: compares the ledger, the table files and all other files of a data directory.

The ledger and the table files have the same rows; each is repaired from the other. Nothing is
deleted: replaced files are moved aside.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from wrenchbook.service.files.durable import sync
from wrenchbook.service.ledger import Ledger, LedgerDamagedError, LedgerError
from wrenchbook.service.ledger.acknowledged import Acknowledged
from wrenchbook.service.ledger.connection import unfinished_restore
from wrenchbook.service.ledger.repair import salvage
from wrenchbook.service.library.component import Component
from wrenchbook.service.library.library import Library
from wrenchbook.service.ops.backup import LEDGER
from wrenchbook.service.ops.checks import (
    COMMAND,
    REPAIR,
    DataFinding,
    check_disk,
    check_side_files,
    find_leftovers,
    move_aside,
)
from wrenchbook.service.ops.replica import read_status, trouble_of
from wrenchbook.service.ops.restore import in_use
from wrenchbook.service.tables.rows import unsolved, with_changes
from wrenchbook.service.tables.store import TableStore
from wrenchbook.surrogate.table.hdf5 import TableFileError, read_table
from wrenchbook.surrogate.table.meta import TableMeta
from wrenchbook.surrogate.table.rows import Rows

Tables = dict[str, tuple[Rows, TableMeta]]


def examine(folder: Path, *, repair: bool = False) -> list[DataFinding]:
    """Check a data directory; with `repair`, repair parts that another copy has.

    A server may use the directory meanwhile, except for the repair of a damaged ledger file.
    """
    folder = folder.absolute()
    if not folder.is_dir():
        return [
            DataFinding("fault", f"there is no data directory {folder}", "name another with --data")
        ]
    if problem := unfinished_restore(folder / LEDGER):
        return [DataFinding("fault", problem)]
    if not any(folder.glob(f"{LEDGER}*")) and not (folder / "tables").is_dir():
        text = f"{folder} is not a data directory: it has neither {LEDGER} nor tables/"
        return [DataFinding("fault", text, "name the server's data directory with --data")]
    findings = [*check_disk(folder), *check_side_files(folder, repair=repair)]
    if copies := trouble_of(read_status(folder)):
        remedy = "check that the target exists, has room and can be written; the server tries again"
        findings.append(DataFinding("fault", f"copies of this directory: {copies}", remedy))
    ledger, of_ledger = _open_ledger(folder, repair=repair)
    findings += of_ledger
    if ledger is None:
        return findings

    try:
        library = Library(folder / "components")
        findings += [
            DataFinding("fault", f"component {name} cannot be used: {why}", "correct its files")
            for name, why in library.broken().items()
        ]
        tables, of_files = _read_all(folder / "tables", repair=repair, count=ledger.count_rows)
        findings += [*of_files, *_damaged_rows(ledger, tables, repair=repair)]
        store = TableStore(folder / "tables", ledger)
        for name in library.names():
            findings += _check_component(ledger, library[name], store, tables, repair=repair)
        remedy = "put its bundle back into components/, or move the file away"
        for name in sorted(tables.keys() - set(library.names())):
            text = f"tables/{name}.h5 belongs to a component that is not in the library"
            findings.append(DataFinding("note", text, remedy))
        findings += find_leftovers(folder, ledger)
        findings += _losses(ledger, repair=repair)
    except LedgerError as error:
        findings.append(DataFinding("fault", str(error)))
    except OSError as error:  # a full disk, while a file is written again
        remedy = "make room, or make the directory writable, and repeat the command"
        findings.append(DataFinding("fault", f"the check could not be completed: {error}", remedy))
    finally:
        ledger.close()
    return findings


def _open_ledger(folder: Path, *, repair: bool) -> tuple[Ledger | None, list[DataFinding]]:
    """Return the ledger, repaired if necessary; None if it cannot be used."""
    path = folder / LEDGER
    log = path.with_name(f"{LEDGER}-wal")
    findings = []
    if _has_bytes(log) and not _has_bytes(path):
        text = f"there is {log.name} without {LEDGER}, so the newest rows in it cannot be read"
        if not repair:
            return None, [DataFinding("fault", text, f"put {LEDGER} back; if it is lost, {REPAIR}")]
        findings.append(DataFinding("repaired", text, f"moved to {move_aside(log, 'orphan').name}"))
    if not _has_bytes(path):
        text = f"{LEDGER} is empty" if path.exists() else f"there is no {LEDGER}"
        if not repair:
            remedy = f"put it back or restore a backup; tables/ has rows, but no jobs; {REPAIR}"
            return None, [*findings, DataFinding("fault", text, remedy)]
        findings.append(DataFinding("repaired", text, "a new one was made; see the tables below"))

    try:
        return Ledger(path), findings
    except LedgerDamagedError as error:
        if repair and not in_use(folder):
            try:
                findings += _rebuild(folder, str(error))
            except OSError as failure:
                remedy = f"no new one could be written: {failure}. Nothing was changed; make room"
                return None, [*findings, DataFinding("fault", str(error), remedy)]
            ledger, more = _open_ledger(folder, repair=False)
            return ledger, findings + more
        remedy = f"stop the server and restore a backup, or {REPAIR}"
        if repair:
            remedy = "stop the server that uses it, then repair"
        return None, [*findings, DataFinding("fault", str(error), remedy)]
    except LedgerError as error:
        return None, [*findings, DataFinding("fault", str(error))]


def _has_bytes(path: Path) -> bool:
    return path.exists() and path.stat().st_size > 0


def _rebuild(folder: Path, problem: str) -> list[DataFinding]:
    """Replace a damaged ledger by its readable part and the table files."""
    path = folder / LEDGER
    tables = folder / "tables"
    with tempfile.TemporaryDirectory(prefix=".repairing-", dir=folder) as scratch:
        copy = Path(scratch) / "damaged.sqlite"
        new = Path(scratch) / LEDGER
        shutil.copyfile(path, copy)
        if _has_bytes(log := path.with_name(f"{LEDGER}-wal")):
            shutil.copyfile(log, copy.with_name(f"{copy.name}-wal"))
        spare = (
            (name, rows, (tables / f"{name}.h5").stat().st_mtime)
            for name, (rows, _) in _read_all(tables, repair=False)[0].items()
        )
        salvaged = salvage(copy, new, spare, Acknowledged(path).read())
        for end in ("-wal", "-shm", ""):
            if (old := path.with_name(f"{LEDGER}{end}")).exists():
                move_aside(old)
        new.rename(path)
        sync(folder)

    jobs, rows, highest = salvaged.read["jobs"], salvaged.read["rows"], salvaged.highest_job
    text = f"a new one was created: {jobs} jobs of {highest} and {rows} rows could be read, others "
    text += "come from the tables' files"
    if highest > jobs:
        text += f"; jobs that were lost: {highest - jobs}"
    if salvaged.reopened:
        text += f"; {salvaged.reopened} jobs wait again, their rows being lost"
    text += ". The damaged one was moved aside; a backup may have more"
    return [
        DataFinding("repaired", problem, text),
        *_report_lost(f"up to {salvaged.lost_rows} rows", salvaged.lost_rows),
    ]


def _losses(ledger: Ledger, *, repair: bool) -> list[DataFinding]:
    """Return lost acknowledged jobs and rows; with `repair` for the last time."""
    losses = ledger.losses()
    if not repair or not losses:
        return [DataFinding("fault", loss, f"note it with: {COMMAND}") for loss in losses]
    acknowledged = Acknowledged(ledger.path)
    with ledger.reading() as db:
        gone = acknowledged.lost(db)
    acknowledged.archive_losses(lambda file: move_aside(file, "settled"))
    findings = [DataFinding("repaired", loss, "noted; it is reported no more") for loss in losses]
    return findings + _report_lost(f"up to {gone.rows} rows and {gone.jobs} jobs", sum(gone))


def _report_lost(subject: str, count: int) -> list[DataFinding]:
    if not count:
        return []
    remedy = "restore a backup, or load or solve them again; the next check does not repeat this"
    return [DataFinding("fault", f"{subject} that were acknowledged are lost", remedy)]


def _read_all(
    folder: Path, *, repair: bool, count: Callable[[str], int] = lambda _: 0
) -> tuple[Tables, list[DataFinding]]:
    """Return the tables of readable files, and findings; `count`: rows of a component's ledger."""
    tables: Tables = {}
    findings = []
    for path in sorted(folder.glob("*.h5")):
        name = f"tables/{path.name}"
        if not os.access(path, os.R_OK):
            remedy = f"make it readable and writable for user {os.getuid()}, as the server runs"
            findings.append(DataFinding("fault", f"{name} may not be read", remedy))
            continue
        try:
            rows, meta = read_table(path)
            if meta.component != path.stem:
                raise TableFileError(f"{path.name} is the table of {meta.component!r}")
            tables[path.stem] = rows, meta
        except (TableFileError, OSError) as error:
            stored = count(path.stem)
            remedy = f"moved to {move_aside(path).name}" if repair else ""
            if not stored:
                lost = "the ledger has no row of it; restore a backup, or solve its rows again"
                remedy = f"{remedy}; {lost}" if repair else lost
            elif not repair:
                remedy = f"the ledger has {stored} rows of it; {REPAIR}"
            kind = "repaired" if repair and stored else "fault"
            findings.append(DataFinding(kind, f"{name} cannot be used: {error}", remedy))
    return tables, findings


def _damaged_rows(ledger: Ledger, tables: Tables, *, repair: bool) -> Iterator[DataFinding]:
    """Report the ledger's damaged rows; with `repair`, write them again from the tables."""
    for seq, named in ledger.damaged_rows().items():
        text = f"row {seq} of {named} is damaged in the ledger"
        name = next((name for name, (rows, _) in tables.items() if seq in rows.seq), None)
        if name is None:
            remedy = (
                "no complete table file has it; ask for its wrench again, load it again, or "
                "restore a backup"
            )
            yield DataFinding("fault", text, remedy)
        elif not repair:
            yield DataFinding("fault", text, f"tables/{name}.h5 has it; {REPAIR}")
        else:
            rows = tables[name][0]
            if ledger.rewrite(name, seq, rows.take(np.flatnonzero(rows.seq == seq)[:1])):
                yield DataFinding("repaired", text, f"written again from tables/{name}.h5")
            else:
                remedy = "the same row is there under another number, which is used"
                yield DataFinding("note", text, remedy)


def _check_component(
    ledger: Ledger, component: Component, store: TableStore, tables: Tables, *, repair: bool
) -> Iterator[DataFinding]:
    """Compare a component's table file with the ledger, and report its rows of another setup."""
    name = component.name
    count = ledger.count_rows(name)
    text = ""
    known = tables.get(name)
    if known is None:
        if count and store.written(name) is None:  # otherwise `_read_all` has reported the damage
            text = f"tables/{name}.h5 is not there; the ledger has {count} rows of it"
    elif not known[1].ledger or known[1].ledger != ledger.digest(name, known[1].last_seq):
        last = known[1].last_seq
        text = f"tables/{name}.h5 and the ledger do not have the same rows up to {last}"
    if text and repair:
        store.load(component)  # restores rows in the ledger that only the file has
        rows, last_seq = with_changes(ledger, component, Rows.empty(component.space), 0)
        store.save(component, rows, last_seq)
        back = ledger.count_rows(name) - count
        remedy = f"{back} rows put back into the ledger; the file written anew with {len(rows)}"
        yield DataFinding("repaired", text, f"{remedy} rows")
    elif text:
        yield DataFinding(
            "fault" if known else "note", text, f"a server's start writes it; or {REPAIR}"
        )

    others = ledger.of_other_setups(name, component.fingerprint)
    if not others:
        return
    rows, _ = with_changes(ledger, component, Rows.empty(component.space), 0)
    complete = component.linear and bool(np.isfinite(rows.compliance).all(axis=(1, 2)).any())
    wrenches = unsolved(component, others, rows.wrench)
    # One solve of a linear component determines its compliance.
    if not complete and len(wrenches):
        text = f"{sum(others.values())} rows of {name} belong to another setup of it"
        remedy = "they come back if its files are restored"
        if component.has_fea:
            solves = f"wrenchbook resolve {name} solves their {len(wrenches)} wrenches again"
            remedy = f"{solves}; {remedy}"
        yield DataFinding("note", text, remedy)
