"""Which method `auto` takes for each output, by errors at rows that the methods do not know."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from surrogate.bars.heldout import hold_out
from surrogate.composition.composition import Composition
from surrogate.straight import StraightSplines
from surrogate.table.rows import OUTPUTS, Floats

CLEARLY = 0.8  # of the error of `griddata`: what another method must reach to be chosen


class Choice(NamedTuple):
    """One output's method and why it was chosen."""

    output: str
    method: str
    why: str


def choose(
    scores: dict[str, Floats], seconds: dict[str, float], slowest: float, basis: str
) -> tuple[Choice, ...]:
    """Choose per output.

    Parameters
    ----------
    scores : dict of str to ndarray, shape (6,), m and rad
        Root mean square error of each method; "griddata" must be among them.
    seconds : dict of str to float
        Time of one answer.
    slowest : float, s
        Methods that take longer are not chosen, `griddata` excepted.
    basis : str
        What the errors were found on.
    """
    quick = [name for name in scores if name == "griddata" or seconds[name] <= slowest]
    choices = []
    for output, name in enumerate(OUTPUTS):
        plain = float(scores["griddata"][output])
        best = min(quick, key=lambda method: float(scores[method][output]))
        least = float(scores[best][output])
        if least >= CLEARLY * plain:
            why = (
                f"no method is clearly better on {basis} (griddata {plain:.2g}, {best} {least:.2g})"
            )
            choices.append(Choice(name, "griddata", why))
        else:
            why = f"error {least:.2g} against {plain:.2g} by griddata on {basis}"
            choices.append(Choice(name, best, why))
    return tuple(choices)


def straight_scores(composition: Composition, straight: StraightSplines) -> dict[str, Floats]:
    """Return the errors at rows left out of their axes, of the methods that have only axes."""
    names = ("griddata", "tangent", "rbf")
    squares = {name: np.zeros(6) for name in names}
    for table, spline in zip(composition.tables, straight.splines, strict=True):
        if table is None or spline is None:
            continue
        outputs = list(table.axis.outputs)
        held = hold_out(table.interpolant, table.values, table.doubt, table.tangent)
        if not len(held.places):
            continue
        errors = {
            "griddata": held.errors,
            "tangent": held.errors - table.bars.bend * held.bends,
            "rbf": held.errors,
        }
        if len(spline.left_out) == len(table.values):
            errors["rbf"] = spline.left_out[held.places]
        for name in names:
            squares[name][outputs] += (errors[name] ** 2).mean(axis=0)
    return {name: np.sqrt(square) for name, square in squares.items()}
