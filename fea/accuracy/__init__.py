"""Error of the solver's answers, whatever the table: mesh and linearity.

`fea.accuracy.estimate.accuracy_of` is the front. Nothing here changes an answer.
"""
