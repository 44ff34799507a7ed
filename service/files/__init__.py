"""Locks that die with their holder, and writes that last."""
