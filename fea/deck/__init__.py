"""Decks: an expert's input file for an outside solver, in place of the embedded solver.

The bundle brings a parametrised deck, the command that solves it and the reader of what it prints.
`fea.deck.solving` fills in the wrench, runs the command in a new folder and reads the motion
of the interface. How a bundle says it is in `fea.bundle.tables`, how to add a reader in
`fea.readers`. Nothing is imported here, because reading a bundle must stay light.
"""
