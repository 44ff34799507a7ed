"""Turn a downloaded table into an FMU, on this machine: the server compiles nothing."""

from __future__ import annotations

from pathlib import Path

from wrenchbook.service.fmu.export import make_fmu
from wrenchbook.surrogate.kernel.binding import PackedTable


def fmu_of(file: Path, name: str, table: bytes, method: str | None) -> tuple[bytes, str]:
    """Return an FMU and what to say of it.

    Parameters
    ----------
    table : bytes
        The component's packed table.
    method : str or None
        How it answers; the table's default if None.

    Raises
    ------
    UnknownMethodError, NotExportableError, CompilerError
        See `service.fmu.export.make_fmu`.
    """
    made = make_fmu(name, PackedTable.from_bytes(table), method)
    if made.platform:
        return made.content, f"{file} written: FMI 2.0, {made.platform}, method {made.method}."
    return made.content, (
        f"{file} written: FMI 2.0, method {made.method}, sources only, since this machine has no C "
        "compiler for a platform of FMI 2.0. Tools that compile sources can use it; or install "
        "gcc, or name a compiler with CC=..., and export again."
    )
