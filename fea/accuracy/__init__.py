"""Error of the solver's answers, independent of a table: mesh and linearity.

`fea.accuracy.estimate.accuracy_of` is the entry point. This package changes no answer.
"""
