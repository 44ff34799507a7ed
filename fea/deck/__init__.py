"""Decks: an expert's own input file for an outside solver, in place of the embedded one.

The bundle brings a parametrised deck, the command that solves it and the reader of what it prints.
This package fills in the wrench, runs the command in a folder of its own and reads the motion of
the interface. How a bundle says it is in `fea.deck.table`, how to add a reader in
`fea.deck.readers`.
"""

from __future__ import annotations

from fea.deck.solving import solve_deck

__all__ = ["solve_deck"]
