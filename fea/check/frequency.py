"""Mass and first natural frequency of a component, for the report of `wrenchbook check`."""

from __future__ import annotations

from typing import Any

from wrenchbook.fea.failure import SolveFailed
from wrenchbook.fea.solve import Solver
from wrenchbook.fea.solver.vibration import Riding
from wrenchbook.fea.spec.problems import Problem


def frequency(solver: Solver, riding: Riding | None) -> tuple[dict[str, Any], list[Problem]]:
    """Return what the component weighs and how slowly it swings, and what stands in the way.

    Parameters
    ----------
    solver
        Of the component; its materials without a density weigh nothing.
    riding
        The rigid mass on the interface; None for none.

    Returns
    -------
    vibration
        ``mass`` (kg, of the component; None without any density), ``first_frequency`` (Hz),
        ``motion`` of the interface (6 numbers, m and rad, of length one), ``riding_mass`` (kg);
        empty where neither the bundle nor the argument tells a mass, or no frequency was found.
    warnings
        Why not, or that some materials count as weightless.
    """
    component = solver.component
    silent = [one.region for one in component.materials if one.density is None]
    if riding is None and len(silent) == len(component.materials):
        return {}, []
    carried = riding or Riding.of()
    warnings = []
    if silent:
        names = ", ".join(f'"{name}"' for name in silent)
        message = f"no density for {names}: it counts as weightless in mass and frequency"
        warnings.append(Problem("material", message))
    try:
        found = solver.vibration(carried)
    except (ValueError, SolveFailed) as error:
        return {}, [*warnings, Problem("material", f"no natural frequency: {error}")]
    result = {
        "mass": found.mass if len(silent) < len(component.materials) else None,
        "first_frequency": found.frequency,
        "motion": found.interface.tolist(),
        "riding_mass": carried.mass,
    }
    return result, warnings
