"""`Solution`, the result of one solve, and `checked_wrench`, the check of its inputs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from wrenchbook.fea.coupling.coupling import PER_INTERFACE, CoupledState
from wrenchbook.fea.spec.problems import suggest

_MAX_QUOTED = 100  # characters of a wrong input in a message
Progress = Callable[[float, str], None]
"""Called with the fraction done (0 to 1) and a message, after each step of the work."""


class Iteration(NamedTuple):
    """One step of Newton's method."""

    load_factor: float  # the part of the wrench that acts, 0 to 1
    iteration: int  # counted from 1 within a load step
    # Euclidean norm of the nodal forces out of balance after this iteration, N
    residual_norm: float


@dataclass(frozen=True, eq=False)
class Solution:
    """The displacement of i interfaces under their wrenches, each in its undeformed frame."""

    # Shape (k,): the inputs, 6 i loads, N and N·m, and further ones in the bundle's units
    wrench: np.ndarray
    # Shape (6 i,), m and rad: translation and rotation vector of each; with bolts relative to the
    # tightened part, if that is the bundle's zero
    displacement: np.ndarray
    # Shape (6 i, k): d displacement / d wrench at this wrench; rows and columns of locked freedoms
    # are zero. NaN if unknown: a nonlinear deck.
    compliance: np.ndarray
    strain_energy: float  # J, from the stresses; NaN if unknown: a nonlinear deck
    # J: the external work along the load path, of loads, weight, bolts, accelerations and the
    # temperature. Linear: half of that of all loads at their full size. Nonlinear: by quadrature
    # over the converged load steps, of fourth order. Its difference from the strain energy measures
    # the steps, not the answer (nonlinear with a temperature they differ by a part of the thermal
    # strain's size). NaN for a nonlinear deck.
    work: float
    unknowns: int  # degrees of freedom solved for; 0 where a deck's solver does not print them
    # Wall time of this solve, s; work that a `Solver` shares between solves is not counted again
    seconds: float
    # The iterations, in order; empty for a linear solve and a zero wrench
    history: tuple[Iteration, ...]
    # Shape (n, 3), m: displacement of each mesh point, in the mesh's axes; none for a deck. It
    # counts from the mesh, before bolts are tightened; at the slip of a bolt it is the slip.
    nodes: np.ndarray
    notes: tuple[str, ...] = ()  # remarks on the solve for an engineer
    # Shape (n, 3, k), m per unit of each input: change of `nodes` with them; None for a deck
    tangents: np.ndarray | None = None
    # Shape (p,), p = k (k + 1) (k + 2) / 6: third derivatives of the complementary energy by the
    # loads (F, mu) and further inputs, which are the second ones of the displacements by them; m
    # and rad over the units of two inputs (`fea.solver.third_derivatives`). Entries of locked
    # freedoms are zero. None for a linear solve, a deck, or more than eight inputs.
    curvature: np.ndarray | None = None
    # The state of the equations, as a start of a nearby solve; None for a linear solve and a deck.
    state: CoupledState | None = None


Loads = Sequence[float] | np.ndarray | Mapping[str, float | Sequence[float] | np.ndarray]
"""Force and moment, N and N·m, of each interface in turn and then further inputs, or by name."""


def checked_wrench(
    wrench: Loads, names: Sequence[str] = ("",), further: Sequence[str] = ()
) -> np.ndarray:
    """Return all inputs as a new array, shape (6 i + f,): N and N·m, then f others.

    wrench: shape (6 i + f,); or a mapping from an interface's name to six numbers (an interface
    without a load may be missing) and from each further input's name to a number.

    Raises ValueError if there are not six finite numbers for each interface and one for each
    further input, an interface is unknown, or a further input is missing.
    """
    values = _in_order(wrench, names, further) if isinstance(wrench, Mapping) else wrench
    count = PER_INTERFACE * len(names) + len(further)
    try:
        # numpy would read digits in quotes, and drop imaginary parts.
        items = np.asarray(values, dtype=object).flat
        not_real = str | bytes | complex | np.complexfloating
        is_real = not any(isinstance(item, not_real) for item in items)
        inputs = np.array(values if is_real else [], dtype=float)
    except (TypeError, ValueError, OverflowError):  # words, lists of several lengths, 10**400
        inputs = np.empty(0)
    if inputs.shape == (count,) and np.isfinite(inputs).all():
        return inputs
    wrong = str(inputs.tolist() if inputs.size else values)[:_MAX_QUOTED]
    if len(names) == 1 and not further:
        raise ValueError(f"a wrench must be six finite numbers in N and N·m, not {wrong}")
    parts = [f"force (N) and moment (N·m){name and ' of ' + name}" for name in names]
    if further:
        parts.append(", ".join(further))
    order = ", then ".join(parts)
    raise ValueError(f"the inputs must be {count} finite numbers: {order}; not {wrong}")


def _in_order(
    wrench: Mapping[str, Any], names: Sequence[str], further: Sequence[str]
) -> list[object]:
    """Return named inputs in the order of `checked_wrench`, before it checks their types."""
    known = (*names, *further)
    for name in wrench:
        if name not in known:
            wanted = ", ".join(filter(None, known)) or "six numbers in a list, without a name"
            raise ValueError(f'"{name}" is no input here; give {wanted}{suggest(str(name), known)}')
    values: list[object] = []
    for name in names:
        loads = np.ravel(np.asarray(wrench.get(name, np.zeros(PER_INTERFACE)), dtype=object))
        if loads.size != PER_INTERFACE:
            message = f'"{name}" must be six finite numbers, force (N) and moment (N·m)'
            raise ValueError(f"{message}, not {str(loads.tolist())[:_MAX_QUOTED]}")
        values += loads.tolist()
    for name in further:
        if name not in wrench:
            raise ValueError(f'the input "{name}" is missing; give its value, a number')
        values.append(wrench[name])
    return values
