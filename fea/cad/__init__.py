"""Geometry files (STEP): their faces, and their mesh; needs the optional extra ``cad``.

gmsh is imported only when a geometry file is opened, which the solver's and the check's processes
do and the web process does not.
"""

from fea.cad.meshing import mesh_geometry
from fea.cad.shape import Body, Face, list_shape

__all__ = ["Body", "Face", "list_shape", "mesh_geometry"]
