"""Readers of what outside solvers print, and the registry a bundle names them from."""
