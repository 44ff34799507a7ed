"""Inspection of a component before a solve: its cells, bodies and places."""
