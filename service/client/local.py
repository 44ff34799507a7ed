"""The surrogate room in a simulator's own process, loaded when a table is downloaded."""

from __future__ import annotations

import importlib
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

# The room beside this one: `wrenchbook.surrogate` to a simulator, which may have a package of its
# own called `surrogate`; `surrogate` in the server and its tests, where this is `service.client`.
ROOM = "wrenchbook.surrogate" if __name__.startswith("wrenchbook.") else "surrogate"


@dataclass(frozen=True, eq=False)
class Built:
    """One version of a component's table, and what answers from it.

    Attributes
    ----------
    content : bytes
        The HDF5 file that it is built from.
    etag : str or None
        The server's name of this version.
    surrogate : surrogate.build.AnyTable
    component : str
    """

    content: bytes
    etag: str | None
    surrogate: Any
    component: str


def room(module: str) -> Any:
    """Return a module of the surrogate room.

    Raises
    ------
    ImportError
        If a package that it needs is not installed; the text says how to install it.
    """
    try:
        return importlib.import_module(f"{ROOM}.{module}")
    except ModuleNotFoundError as error:
        if error.name is None or error.name.startswith(ROOM):
            raise
        raise ImportError(
            f"a table in this process needs the package {error.name!r}, which is not installed: "
            "pip install 'wrenchbook[local]'",
            name=error.name,
        ) from error


def require_room() -> None:
    """Load what building a table needs.

    Raises
    ------
    ImportError
        See `room`.
    """
    for module in ("table.hdf5", "build", "derivative"):
        room(module)


def build(content: bytes, etag: str | None, before: Any = None) -> Built:
    """Build what answers from a table's HDF5 file, as the server does from the same rows.

    Parameters
    ----------
    content, etag
        As in `Built`.
    before : surrogate.build.AnyTable, optional
        Another version: what has not changed since is taken from it.

    Raises
    ------
    ImportError
        See `room`.
    surrogate.table.hdf5.TableFileError
        If the bytes are no table that this version reads.
    """
    with tempfile.TemporaryDirectory(prefix="wrenchbook-") as folder:
        path = Path(folder) / "table.h5"
        path.write_bytes(content)
        rows, meta = room("table.hdf5").read_table(path)
    # The server computes on one thread; with several, sums are added up in another order.
    with room("kriging.threads").one_thread():
        surrogate = room("build").build(
            rows,
            meta.load_range,
            tolerance=meta.tolerance,
            linear=meta.linear,
            off_axis=meta.off_axis,
            version=meta.last_seq,
            before=before,
            solver_error=room("solver_error").SolverError.read(meta.solver_error),
            locked=meta.locked,
        )
    return Built(content, etag, surrogate, meta.component)


def build_scene(content: bytes, etag: str | None, component: str) -> Built:
    """Return what answers from a scene's file: nothing is built anew, it is in the file.

    Raises
    ------
    ImportError
        See `room`.
    surrogate.scene.file.SceneFileError
        If the bytes are no scene's table that this version reads.
    """
    return Built(content, etag, room("scene.file").read_scene(content), component)
