"""The axes: triangulations of the rows of single axes, combined to answers."""
