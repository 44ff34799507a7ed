"""Mesh files: gmsh, Abaqus and CalculiX, Nastran, Ansys, VTK."""
