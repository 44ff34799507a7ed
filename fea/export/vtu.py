"""A displaced mesh as a VTU file, for ParaView and its like."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import meshio
import numpy as np

from wrenchbook.fea.component import ComponentModel

Array = np.ndarray

_NAMES = {
    "hex8": "hexahedron",
    "hex20": "hexahedron20",
    "hex27": "hexahedron27",
    "tet4": "tetra",
    "tet10": "tetra10",
    "wedge6": "wedge",
    "wedge15": "wedge",  # meshio 5.3 cannot hold wedges of 15 nodes: their corners only
}
_CORNERS = {"wedge15": 6}


def write_state(path: Path, component: ComponentModel, displacements: Array) -> None:
    """Write the undeformed mesh with a displacement at each point.

    Parameters
    ----------
    path
        Ends in ``.vtu``.
    component
        Its mesh, materials, supports and section.
    displacements
        Shape (n, 3), m, in the mesh's own axes. "Warp by vector" shows the part displaced.

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    mesh = component.mesh
    marks = {"supported": component.fixed_nodes, "interface": component.section.node_ids}
    point_data: dict[str, Any] = {"displacement": displacements}
    for name, nodes in marks.items():
        point_data[name] = np.zeros(len(mesh.points), dtype=np.int8)
        point_data[name][nodes] = 1
    meshio.Mesh(
        mesh.points,
        [(_NAMES[block.kind], block.nodes[:, : _CORNERS.get(block.kind)]) for block in mesh.blocks],
        point_data=point_data,
        cell_data={"material": list(component.material_of_cells)},
    ).write(path, file_format="vtu")
