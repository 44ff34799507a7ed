"""Strains and stiffness of one cell."""
