"""Mesh files: gmsh, Abaqus and CalculiX, VTK."""
