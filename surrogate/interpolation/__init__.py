"""Scattered data on one axis: triangulation, walks, slopes."""
