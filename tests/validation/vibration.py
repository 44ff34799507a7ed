"""Craig-Bampton's matrices against the equations of the whole part."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.linalg import eigh

from tests.validation.clamped import shipped
from tests.validation.finding import Finding, case
from wrenchbook.fea.solve import Solver
from wrenchbook.fea.solver.vibration import Riding

_MODES = 12
_CARRIED = 2.0  # kg, of the order of the parts' own mass
_PARTS = (("bar", 0.0), ("bar", _CARRIED), ("plate", 0.0), ("plate", _CARRIED), ("link", 0.0))


@case("vibration")
def first_frequency() -> Iterator[Finding]:
    """Condensed part of 12 modes: its first natural frequency, alone and with a mass."""
    for name, mass in _PARTS:
        solver = Solver(shipped(name))
        part = solver.craig_bampton(_MODES)
        riding, whole = Riding.of(mass), part.mass[6:, 6:].copy()
        whole[:6, :6] += riding.matrix
        square = eigh(part.stiffness[6:, 6:], whole, eigvals_only=True)[0]
        quantity = f"{name} with {mass:g} kg: first natural frequency, Hz"
        exact, result = solver.vibration(riding).frequency, np.sqrt(square) / (2 * np.pi)
        yield Finding(quantity, "the whole part's equations", exact, float(result), 1e-3)
