"""Equilibrium: linear, Newton, load steps, arc length."""
