"""Turn a downloaded table into an FMU, on this machine: the server compiles nothing."""

from __future__ import annotations

import tempfile
from pathlib import Path

from service.fmu.export import make_fmu
from surrogate.build import AnyTable, build
from surrogate.kriging.threads import one_thread
from surrogate.solver_error import SolverError
from surrogate.table.hdf5 import read_table


def fmu_of(file: Path, name: str, table: bytes, method: str | None) -> tuple[bytes, str]:
    """Return an FMU and what to say of it.

    Parameters
    ----------
    table : bytes
        The component's table as HDF5.
    method : str or None
        How it answers; the table's default if None.

    Raises
    ------
    UnknownMethodError, NotExportableError, CompilerError
        See `service.fmu.export.make_fmu`.
    """
    made = make_fmu(name, _built(table), method)
    if made.platform:
        return made.content, f"{file} written: FMI 2.0, {made.platform}, method {made.method}."
    return made.content, (
        f"{file} written: FMI 2.0, method {made.method}, sources only, since this machine has no C "
        "compiler for a platform of FMI 2.0. Tools that compile sources can use it; or install "
        "gcc, or name a compiler with CC=..., and export again."
    )


def _built(content: bytes) -> AnyTable:
    """Build the surrogate of a table's HDF5 file, as the server does from the same rows."""
    with tempfile.TemporaryDirectory(prefix="wrenchbook-") as folder:
        path = Path(folder) / "table.h5"
        path.write_bytes(content)
        rows, meta = read_table(path)
    # The server computes on one thread; with several, sums are added up in another order.
    with one_thread():
        return build(
            rows,
            meta.load_range,
            tolerance=meta.tolerance,
            linear=meta.linear,
            off_axis=meta.off_axis,
            version=meta.last_seq,
            solver_error=SolverError.read(meta.solver_error),
            locked=meta.locked,
        )
