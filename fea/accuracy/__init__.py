"""What a solver's own answers may be wrong by, whatever the table: mesh and linearity.

`fea.accuracy.estimate.accuracy_of` is the front. Nothing here changes an answer.
"""
