"""Equilibrium by Newton's method, load steps and arc length; linear response, modes, buckling."""
