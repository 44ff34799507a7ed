"""What one solve gives back."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from wrenchbook.fea.coupling.coupling import PER_INTERFACE, CoupledState
from wrenchbook.fea.spec.problems import suggest

Array = np.ndarray

Progress = Callable[[float, str], None]
"""Called with the fraction done (0 to 1) and a message, after each step of the work."""


class Iteration(NamedTuple):
    """One step of Newton's method.

    Attributes
    ----------
    load_factor
        The part of the wrench that acts, 0 to 1.
    iteration
        Counted from 1 within a load step.
    residual_norm
        Euclidean norm of the nodal forces out of balance after this iteration, N.
    """

    load_factor: float
    iteration: int
    residual_norm: float


@dataclass(frozen=True, eq=False)
class Solution:
    """The displacement of i interfaces under their wrenches, each in its undeformed frame.

    Attributes
    ----------
    wrench
        Shape (6 i,), N and N·m.
    displacement
        Shape (6 i,), m and rad: translation and rotation vector of each.
    compliance
        Shape (6 i, 6 i): d displacement / d wrench at this wrench; rows and columns of locked
        freedoms are zero. NaN where it is unknown: a nonlinear deck.
    strain_energy
        J. NaN where it is unknown: a nonlinear deck.
    work
        J. Linear: wrench . displacement, twice the strain energy. Nonlinear: the external work
        along the load path by quadrature over the converged load steps, of fourth order. On the
        path it equals the strain energy, so that their difference measures the steps, not the
        answer. NaN for a nonlinear deck.
    unknowns
        Degrees of freedom solved for; 0 where a deck's solver does not tell.
    seconds
        Wall time of this solve; what a `Solver` shares between solves is not counted again.
    history
        The iterations, in order; empty for a linear solve and a zero wrench.
    nodes
        Shape (n, 3), m: displacement of each mesh point, in the mesh's own axes; none for a
        deck.
    notes
        What an engineer should know about how the answer was found.
    tangents
        Shape (n, 3, 6 i), m/N and m/(N·m): change of `nodes` with the wrench; None for a deck.
    state
        Where the equations were left, to start a nearby solve from; None for a linear solve and a
        deck.
    """

    wrench: Array
    displacement: Array
    compliance: Array
    strain_energy: float
    work: float
    unknowns: int
    seconds: float
    history: tuple[Iteration, ...]
    nodes: Array
    notes: tuple[str, ...] = ()
    tangents: Array | None = None
    state: CoupledState | None = None


Loads = Sequence[float] | Array | Mapping[str, Sequence[float] | Array]
"""Force and moment, N and N·m, of each interface in turn, or by the interfaces' names."""


def checked_wrench(wrench: Loads, names: Sequence[str] = ("",)) -> Array:
    """Return the wrenches of all interfaces as an array of its own, shape (6 i,), N and N·m.

    Parameters
    ----------
    wrench
        Shape (6 i,), or six numbers by an interface's name; one without a name has no load.
    names
        Of the i interfaces.

    Raises
    ------
    ValueError
        If it is not six finite numbers an interface, or names an unknown interface.
    """
    if isinstance(wrench, Mapping):
        wrench = np.concatenate(_by_name(wrench, names))
    whole = np.array(wrench, dtype=float)
    count = PER_INTERFACE * len(names)
    if whole.shape == (count,) and np.isfinite(whole).all():
        return whole
    if len(names) == 1:
        raise ValueError("a wrench is six finite numbers: force (N) and moment (N·m)")
    raise ValueError(
        f"the loads of {len(names)} interfaces are {count} finite numbers: force (N) and moment "
        f"(N·m) of {', '.join(names)}"
    )


def _by_name(loads: Mapping[str, Sequence[float] | Array], names: Sequence[str]) -> list[Array]:
    for name in loads:
        if name not in names:
            known = ", ".join(names)
            raise ValueError(f'no interface "{name}"{suggest(name, names)} (there are {known})')
    return [np.asarray(loads.get(name, np.zeros(PER_INTERFACE)), dtype=float) for name in names]
