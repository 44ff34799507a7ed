"""Faces and meshes of geometry files (STEP), by gmsh, which the optional extra ``cad`` brings.

A bundle names the file, the cell size, facet groups by face and cell groups by body; the keys are
in ``data/docs/reference/component.md``. Bodies that touch are glued to each other.
``wrenchbook check`` lists every face with its number, area, centre and normal, also while the rest
of the bundle has mistakes.

gmsh runs in a child process (`child`), one for each geometry, because it aborts on some sound files
at some sizes. `meshing` is the caller's side. The child imports numpy and gmsh, no finite elements.
"""
