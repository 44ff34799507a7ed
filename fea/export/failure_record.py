"""Files of a failed solve in its attempt's folder: the history, and the last state as VTU."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import meshio
import numpy as np

from wrenchbook.fea.component import ComponentModel
from wrenchbook.fea.failure import SolveFailed
from wrenchbook.fea.mesh.io.read import MESHIO_KINDS

Array = np.ndarray

HISTORY, LAST_STATE = "history.json", "last_state.vtu"  # files in the attempt's folder
_COLUMNS = ("load_factor", "iteration", "residual_norm")  # fields of each iteration of the history
_NAMES = {kind: name for name, kind in MESHIO_KINDS.items()}


def keep(folder: Path, failure: SolveFailed, component: ComponentModel) -> None:
    """Write the history of a failure and the last converged state.

    ``history.json`` has the failure's kind, message and remedy, the load factor of the last
    converged state and that at which the part gives way (null if unknown), and each iteration. The
    state is the undeformed mesh if there was none. Errors of writing are reported on standard error
    only: the failure itself matters more.
    """
    factor, nodes = failure.last or (0.0, np.zeros_like(component.mesh.points))
    record = {
        "kind": failure.kind,
        "message": failure.message,
        "remedy": failure.remedy,
        "last_load_factor": factor,
        "critical_load_factor": failure.load_factor,
        "iterations": [dict(zip(_COLUMNS, step, strict=True)) for step in failure.history],
    }
    try:
        (folder / HISTORY).write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
        write_state(folder / LAST_STATE, component, nodes)
    except OSError as error:
        print(f"the last state was not kept: {error}", file=sys.stderr)


def write_state(path: Path, component: ComponentModel, displacements: Array) -> None:
    """Write the undeformed mesh with a displacement at each point.

    path: ends in ``.vtu``.
    component: its mesh, materials, supports and section.
    displacements: shape (n, 3), m, in the mesh's axes. "Warp by vector" shows the part
    displaced.
    Raises OSError if the file cannot be written.
    """
    mesh = component.mesh
    sections = np.concatenate([interface.section.node_ids for interface in component.interfaces])
    marks = {"supported": component.supported_nodes, "interface": sections}
    for bolt in component.bolts:  # the slip belongs to no cell: its point moves with the cut
        displacements = displacements.copy()
        displacements[bolt.slip] = displacements[bolt.nodes].mean(axis=0)
    point_data: dict[str, Any] = {"displacement": displacements}
    for name, nodes in marks.items():
        point_data[name] = np.zeros(len(mesh.points), dtype=np.int8)
        point_data[name][nodes] = 1
    meshio.Mesh(
        mesh.points,
        [(_NAMES[block.kind], block.nodes) for block in mesh.blocks],
        point_data=point_data,
        cell_data={"material": list(component.material_of_cells)},
    ).write(path, file_format="vtu")
