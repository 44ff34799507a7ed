"""Systematic errors of measured rows and their causes, estimated from the rows alone."""
