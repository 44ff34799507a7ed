"""Deformed surfaces and stresses of solved rows: stored, and interpolated between rows."""
