"""Exports: CalculiX decks, reduced parts, records of failed solves with their last state."""
