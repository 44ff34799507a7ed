"""The numbers of surrogate/kernel/wrenchbook.h, by name."""

from __future__ import annotations

METHODS = ("griddata", "additive", "tangent", "kriging", "linear", "nearest")
ANSWERED = (*METHODS, "row", "estimate")  # what a reply may name
COVERAGE = ("covered", "thin", "outside")
