"""The axes: triangulations of the rows of single axes, composed to answers."""
