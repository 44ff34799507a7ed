"""Geometry files (STEP): their faces, and their mesh; needs the optional extra ``cad``.

A bundle names the file, the cell size, and groups by face::

    [mesh]
    file = "bracket.step"          # holds its length unit; cells are tet10
    size = 0.004                   # edge length of the cells, m
    curvature = 16                 # least cells round a full turn; optional
    [mesh.groups]                  # facet groups, by the law of `fea.mesh.surface`
    base = {plane = "z", at = 0.0}                # every plane face there, m
    bolts = {radius = 0.0033}                     # every cylinder of that radius, m
    head = {near = [0.04, 0.03, 0.058]}           # the face nearest to a point, or a list of points
    rest = {faces = [3, 7]}                       # by the numbers that the check lists
    [mesh.regions]                 # cell groups, for materials
    rubber = {near = [0.0, 0.0, 0.01]}            # the body there; or {bodies = [2]}

Bodies that touch are glued to each other. ``wrenchbook check`` lists every face with its number,
area, centre and normal, also while the rest of the bundle has mistakes.

gmsh runs in a child process (`child`), one for each geometry, because it aborts on some sound files
at some sizes. `meshing` is the caller's side. The child imports numpy and gmsh, no finite elements.
"""
