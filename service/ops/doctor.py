"""A look at a data directory: the ledger against the tables, files, disk and leftovers."""

from __future__ import annotations

from pathlib import Path

from service.ledger import Ledger, LedgerError
from service.library.library import Library
from service.ops.archive import LEDGER
from service.ops.disk import check_disk
from service.ops.findings import Finding
from service.ops.ledger_file import check_ledger_file
from service.ops.leftovers import find_leftovers
from service.ops.side_files import check_side_files
from service.ops.table_files import check_tables


def examine(folder: Path, *, mend: bool = False) -> list[Finding]:
    """Look through a data directory, and mend what can be from whichever copy is whole.

    Nothing is deleted: what is replaced is moved aside. A server may use the directory meanwhile;
    only a damaged ledger's file needs it stopped.

    Parameters
    ----------
    folder : path
        The data directory.
    mend : bool
        Whether to change anything.
    """
    folder = folder.absolute()
    if not folder.is_dir():
        return [Finding("fault", f"there is no data directory {folder}", "say which with --data")]
    found = [*check_disk(folder), *check_side_files(folder, mend=mend)]
    usable, told = check_ledger_file(folder, mend=mend)
    found += told
    if usable:
        try:
            found += _beyond_the_file(folder, mend=mend)
        except LedgerError as error:
            found.append(Finding("fault", str(error)))
    return found


def _beyond_the_file(folder: Path, *, mend: bool) -> list[Finding]:
    ledger = Ledger(folder / LEDGER)
    try:
        library = Library(folder / "components")
        found = [
            Finding("fault", f"component {name} cannot be used: {why}", "mend its files")
            for name, why in library.broken().items()
        ]
        found += check_tables(ledger, library, folder / "tables", mend=mend)
        return found + find_leftovers(folder, ledger)
    finally:
        ledger.close()
