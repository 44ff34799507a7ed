"""Decks: an expert's input file for an outside solver, in place of the embedded solver.

The bundle brings a parametrised deck, the command that solves it and the reader of its output.
`fea.deck.solving` inserts the wrench, runs the command in a new folder and reads the motion of the
interface. `fea.spec.schema.Deck` has the bundle's keys for it, `fea.readers` explains how to add a
reader. This file imports nothing, so that reading a bundle stays fast.
"""
