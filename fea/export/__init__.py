"""Exports: VTK states, CalculiX decks, records of failures."""
