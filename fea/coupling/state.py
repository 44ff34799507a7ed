"""Where the body and its interface are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class CoupledState:
    """One configuration.

    Attributes
    ----------
    nodes
        Shape (n, 3), m: nodal displacements.
    interface
        Shape (6,), m and rad: translation and rotation vector of the interface.
    multipliers
        Shape (6,), N and N/m: a distributed coupling's; node i feels w_i (l + m x b_i). Zero in a
        rigid one.
    """

    nodes: Array
    interface: Array
    multipliers: Array


class Border(NamedTuple):
    """How the border joins the body's tangent K at one state.

    With ties T, columns c and block d the whole tangent is
    [[K, K T + c], [(K T + c)^T, T^T K T + d]].

    Attributes
    ----------
    ties
        Shape (n, 3, border): how nodes that are no unknowns move with the border; dimensionless for
        translations, m/rad for rotations.
    columns
        Shape (n, 3, border): the border's forces on free nodes, N over the unit of each unknown.
    block
        Shape (border, border): J over the units of both unknowns, so N/m, N and N·m for interface
        freedoms.
    """

    ties: Array
    columns: Array
    block: Array
