"""Writers of a failed solve's files: the history as JSON, and the last state as VTU."""

from __future__ import annotations

import contextlib
import json
import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import meshio
import numpy as np

from wrenchbook.fea.component import ComponentModel
from wrenchbook.fea.failure import SolveFailed
from wrenchbook.fea.mesh.io.read import MESHIO_KINDS
from wrenchbook.fea.solution import Iteration

HISTORY, LAST_STATE = "history.json", "last_state.vtu"  # files in the attempt's folder
_MESHIO_NAMES = {kind: name for name, kind in MESHIO_KINDS.items()}


def write_failure(folder: Path, failure: SolveFailed, component: ComponentModel) -> None:
    """Write the history of a failure and the last converged state.

    ``history.json`` has the failure's kind, message and remedy, the load factor of the last
    converged state and that at which the part gives way (null if unknown), and each iteration, with
    null for a number that is not finite. The state is the undeformed mesh if there was none. Errors
    of writing are reported on standard error only: the failure itself matters more.
    """
    factor, nodes = failure.last or (0.0, np.zeros_like(component.mesh.points))
    record = {
        "kind": failure.kind,
        "message": failure.message,
        "remedy": failure.remedy,
        "last_load_factor": _finite(factor),
        "critical_load_factor": _finite(failure.load_factor),
        "iterations": [
            {name: _finite(value) for name, value in zip(Iteration._fields, step, strict=True)}
            for step in failure.history
        ],
    }

    text = json.dumps(record, indent=1, allow_nan=False) + "\n"
    _write(folder / HISTORY, lambda path: path.write_text(text, encoding="utf-8"))
    _write(folder / LAST_STATE, lambda path: write_state(path, component, nodes))


def _finite(number: float | None) -> float | None:
    """Return the number, or None if it is NaN or infinite, which JSON does not have."""
    return number if number is not None and math.isfinite(number) else None


def _write(path: Path, write: Callable[[Path], object]) -> None:
    """Write a file, or report on standard error why it cannot be written."""
    try:
        write(path)
    except (OSError, ValueError, meshio.WriteError) as error:
        why = f'"{path}" was not kept: {error}; correct this and solve again for the file'
        with contextlib.suppress(OSError):  # on a full disk the log has no room either
            print(why, file=sys.stderr)


def write_state(path: Path, component: ComponentModel, displacements: np.ndarray) -> None:
    """Write the undeformed mesh with a displacement at each point.

    path: ends in ``.vtu``.
    displacements: shape (n, 3), m, in the mesh's axes. "Warp by vector" shows the part
    displaced.
    Raises OSError if the file cannot be written.
    """
    mesh = component.mesh
    sections = np.concatenate([interface.section.node_ids for interface in component.interfaces])
    displacements = displacements.copy()
    for bolt in component.bolts:  # the slip belongs to no cell: its point moves with the cut
        displacements[bolt.slip] = displacements[bolt.nodes].mean(axis=0)
    point_data: dict[str, Any] = {"displacement": displacements}
    for name, nodes in (("supported", component.supported_nodes), ("interface", sections)):
        point_data[name] = np.zeros(len(mesh.points), dtype=np.int8)  # VTU has no booleans
        point_data[name][nodes] = 1
    meshio.Mesh(
        mesh.points,
        [(_MESHIO_NAMES[block.kind], block.nodes) for block in mesh.blocks],
        point_data=point_data,
        cell_data={"material": list(component.material_of_cells)},
    ).write(path, file_format="vtu")
