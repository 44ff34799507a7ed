"""Systematic errors of measured rows: their causes, found from the rows alone."""
