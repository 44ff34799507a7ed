"""Deformed surfaces and stresses of solved rows: kept, and answered between rows."""
