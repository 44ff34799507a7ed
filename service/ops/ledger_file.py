"""The ledger's file itself: there, whole, of this program, with the log that belongs to it."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

from service.files.durable import sync_folder
from service.ledger import Ledger, LedgerDamagedError, LedgerError
from service.ledger.acknowledged import Acknowledged
from service.ledger.salvage import Salvaged, Spare, salvage
from service.ops.archive import LEDGER
from service.ops.findings import MEND, Finding, move_aside
from service.ops.restore import in_use
from service.ops.table_files import read_all
from service.tables.files import new_row

_KEPT = "The damaged one was moved aside; a backup may have more"


def check_ledger_file(folder: Path, *, mend: bool) -> tuple[bool, list[Finding]]:
    """Tell whether the ledger can be used, and what is wrong with it; mend it if asked to."""
    path = folder / LEDGER
    log = path.with_name(f"{LEDGER}-wal")
    found = []
    if _has_bytes(log) and not _has_bytes(path):
        what = f"there is {log.name} without {LEDGER}: what was newest is in it and not readable"
        if not mend:
            return False, [Finding("fault", what, f"put {LEDGER} back; if it is gone, {MEND}")]
        found.append(Finding("mended", what, f"moved to {move_aside(log, 'orphan').name}"))
    if not _has_bytes(path):
        what = f"{LEDGER} is empty" if path.exists() else f"there is no {LEDGER}"
        if not mend:
            remedy = f"put it back or restore a backup; tables/ has rows, but no jobs; {MEND}"
            return False, [*found, Finding("fault", what, remedy)]
        Ledger(path).close()
        found.append(Finding("mended", what, "a new one was made; see the tables below"))
    try:
        Ledger(path).close()
    except LedgerDamagedError as error:
        usable, told = _mend(folder, str(error), mend=mend)
        return usable, found + told
    except LedgerError as error:
        return False, [*found, Finding("fault", str(error))]
    if mend and Acknowledged(path).losses():
        found += _settled(path)
    return True, found


def _settled(path: Path) -> list[Finding]:
    noted = Acknowledged(path)
    losses = noted.losses()
    noted.settle(lambda file: move_aside(file, "settled"))
    return [Finding("mended", one, "noted; it is told no more") for one in losses]


def _mend(folder: Path, what: str, *, mend: bool) -> tuple[bool, list[Finding]]:
    if not mend:
        return False, [Finding("fault", what, f"stop the server and restore a backup, or {MEND}")]
    if in_use(folder):
        return False, [Finding("fault", what, "stop the server that uses it, then mend")]
    made = _made_anew(folder)
    jobs, rows = made.read["jobs"], made.read["rows"]
    told = f"a new one was made: {jobs} jobs of {made.given} and {rows} rows could be read, others "
    told += "come from the tables' files"
    told += f"; jobs that were lost: {lost}" if (lost := made.given - jobs) > 0 else ""
    again = f"; {made.reopened} jobs wait again, their rows being lost" if made.reopened else ""
    return True, [Finding("mended", what, f"{told}{again}. {_KEPT}")]


def _made_anew(folder: Path) -> Salvaged:
    """Replace a damaged ledger by what can be read of it and of the tables' files."""
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
    whole, _ = read_all(tables, mend=False)
    for name, (rows, _) in whole.items():
        written = (tables / f"{name}.h5").stat().st_mtime
        for place, seq in enumerate(rows.seq.tolist()):
            yield Spare(name, seq, new_row(rows, place), written)


def _has_bytes(path: Path) -> bool:
    return path.exists() and path.stat().st_size > 0
