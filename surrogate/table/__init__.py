"""Rows, axes, compliance and physics of a table, and its HDF5 file."""
