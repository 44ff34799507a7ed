"""Rows in; displacement, error bar and coverage out."""
