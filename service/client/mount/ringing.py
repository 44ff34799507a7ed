"""Warning of loads that change too fast for answers at rest."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, cast

import numpy as np
from numpy.typing import ArrayLike

from ..errors import InvalidArgument, MountWarning, warn
from ..wrenches import Vector, floats_of

if TYPE_CHECKING:
    from .. import Client, Table

# Rise time of a load in periods of the first natural frequency: with 8 or more, an undamped
# component vibrates about its displacement at rest by at most 4 % of the step
# (`_largest_vibration`).
QUASI_STATIC = 8.0


def first_frequency(
    alone: float | None, compliance: Vector | None, carried: Vector | None
) -> float:
    """Return a lower bound of the first natural frequency, Hz; infinite if nothing has mass.

    It is that of the component alone, Hz (None: weightless), lowered by a carried rigid system's
    mass matrix about the interface point (6, 6), kg to kg·m^2, on a compliance du/dw (6, 6), SI.

    Dunkerley (1894): 1/f^2 = 1/f_alone^2 + 1/f_carried^2, with 1/(2 pi f_carried)^2 the largest
    eigenvalue of compliance times mass: exact if one of the two masses is zero.
    """
    square = 0.0 if alone is None else 1.0 / alone**2
    if compliance is not None and carried is not None:
        largest = float(np.linalg.eigvals(compliance @ carried).real.max())
        square += (2.0 * math.pi) ** 2 * max(largest, 0.0)
    return math.inf if square == 0.0 else square**-0.5


def warn_if_ringing(
    source: Table | Client,
    component: str,
    frequency: float | None,
    ramp_time: float | None,
    carried: float | ArrayLike | None,
) -> None:
    """Warn if loads rise within `ramp_time`, s, too fast for answers at rest.

    By default a server gives the first natural frequency, Hz.

    Raises InvalidArgument if one of frequency and ramp time is given without the other, or
    `carried`, kg or a mass matrix (6, 6), cannot be used.
    """
    if frequency is None and ramp_time is not None and hasattr(source, "compliance"):
        frequency = _known_frequency(cast("Client", source), component, carried)
        if frequency is None:
            return
    elif carried is not None:
        raise InvalidArgument(
            "carried serves only to compute the natural frequency; pass it with a Client as "
            "source and ramp_time, and without natural_frequency"
        )
    elif frequency is None and ramp_time is None:
        return
    if frequency is None or ramp_time is None:
        raise InvalidArgument(
            "natural_frequency (Hz) and ramp_time (s) belong together; give both. With a Client "
            "as source, ramp_time alone is enough"
        )
    if not (frequency > 0.0 and ramp_time > 0.0):
        raise InvalidArgument(
            f"natural_frequency and ramp_time must be above 0, not {frequency} Hz and {ramp_time} s"
        )

    periods = frequency * ramp_time
    if periods < QUASI_STATIC:
        warn(
            f"{component} rings: loads build up in {ramp_time:g} s, {periods:.3g} periods of its "
            f"first natural frequency, {frequency:g} Hz. Without damping it then vibrates by up to "
            f"{100.0 * _largest_vibration(periods):.2g} % of the step about the answers, which are "
            f"those at rest. Use rises of {QUASI_STATIC:g} periods or more, a stiffer component or "
            "a joint",
            MountWarning,
        )


def _largest_vibration(periods: float) -> float:
    """Return the amplitude that a linear rise over `periods` leaves, as a fraction of the step.

    An undamped oscillator keeps |sin(pi n)| / (pi n) after a rise of n periods, 1 after a sudden
    step (Chopra, Dynamics of Structures, "Step force with finite rise time"); this is its envelope.
    """
    return min(1.0, 1.0 / (math.pi * periods))


def _known_frequency(
    client: Client, component: str, carried: float | ArrayLike | None
) -> float | None:
    """Return the first natural frequency, Hz, from a server; None after a warning if unknown."""
    alone = (client.component(component).get("vibration") or {}).get("first_frequency")
    unknown = f"{component}: it is unknown whether loads build up slowly enough."

    matrix, compliance = None, None
    if carried is not None:
        is_mass = np.ndim(carried) == 0
        mass = floats_of("carried, a mass or its matrix,", carried, () if is_mass else (6, 6))
        matrix = np.diag([float(mass)] * 3 + [0.0] * 3) if is_mass else mass
        if (np.diag(matrix) < 0.0).any():
            where = "" if is_mass else " on its diagonal"
            raise InvalidArgument(f"carried must be 0 kg or more{where}, not {mass.tolist()}")
        facts = client.compliance(component)
        # At zero load, if there is a row: a part that stiffens under load oscillates slower there.
        compliance = np.array(facts.get("tangent") or facts["matrix"], dtype=float)
        if not np.isfinite(compliance).all():
            compliance = None
            warn(
                f"{unknown} Its table has too few rows for a compliance, so the carried mass is "
                "left out; fill it first",
                MountWarning,
            )

    frequency = first_frequency(alone, compliance, matrix)
    if math.isfinite(frequency):
        return frequency
    warn(
        f"{unknown} Its bundle gives no density and no carried mass is known; give "
        "natural_frequency=, Hz, or carried=, kg",
        MountWarning,
    )
    return None
