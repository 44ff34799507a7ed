"""Boxes of any cell kind, for tests: those of the verification suite, and volumes of cells."""

from tests.validation.boxes import box
from wrenchbook.fea.mesh.mapping import determinants
from wrenchbook.fea.mesh.reference_cell import reference_element

__all__ = ["box", "volumes"]


def volumes(points, block):
    """Return the volume of each cell, shape (m,), m^3."""
    return determinants(points, block) @ reference_element(block.kind).weights
