"""Straight direction influence: three axes to one answer."""
