"""Options of a mount, checked where a slip is likely."""

from __future__ import annotations

import warnings
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import InvalidArgument
from .errors import MountWarning, SourceError

Vector = NDArray[np.float64]

MODES = ("table", "solve", "record", "envelope")
RELAXATIONS = ("aitken", "newton", "off")

# Periods of the first natural frequency that a load takes to build up: with fewer, the component
# rings, and an answer at rest misses it, by a factor of 2 and more either way.
QUASI_STATIC = 8.0


def require_word(name: str, given: Any, words: tuple[str, ...]) -> None:
    """Refuse an option that is none of its words.

    Raises
    ------
    ValueError
        If so; the text lists them.
    """
    if given not in words:
        raise InvalidArgument(f"{name} must be one of {', '.join(words)}, not {given!r}")


def fixed_factor(relaxation: str | float) -> float | None:
    """Return the fixed factor of a relaxation, or None for Aitken's.

    Raises
    ------
    ValueError
        If it is no word of a relaxation and no number over 0 and up to 1.
    """
    if isinstance(relaxation, str):
        require_word("relaxation", relaxation, RELAXATIONS)
        return None if relaxation == "aitken" else 1.0
    if not isinstance(relaxation, Real) or not 0.0 < relaxation <= 1.0:
        words = ", ".join(RELAXATIONS)
        raise InvalidArgument(
            f"relaxation must be one of {words}, or a fixed factor over 0 and at most 1, not "
            f"{relaxation!r}"
        )
    return float(relaxation)


def square(stiffness: ArrayLike | None) -> Vector | None:
    """Return a scene's stiffness, shape (6, 6), N/m to N·m/rad, or None.

    Raises
    ------
    ValueError
        If its shape is another, or a number not finite.
    """
    if stiffness is None:
        return None
    matrix = np.array(stiffness, dtype=float)
    if matrix.shape != (6, 6) or not np.isfinite(matrix).all():
        raise InvalidArgument(f"stiffness must be finite, of shape (6, 6), not {matrix.shape}")
    return matrix


def require_server(source: Any, mode: str) -> Any:
    """Return a source that is a server's client.

    Raises
    ------
    TypeError
        If it is none, and the mode needs one; a SourceError.
    """
    if hasattr(source, "__aenter__"):
        raise SourceError("a mount's steps block: give a Client in the place of the AsyncClient")
    if hasattr(source, "displacement") and hasattr(source, "solve"):
        return source
    what = "a Client" if mode != "table" else "a Client, or a Table from client.download(...)"
    raise SourceError(f"mode {mode!r} asks {what}, not {type(source).__name__}")


def warn_of_ringing(component: str, frequency: float | None, ramp_time: float | None) -> None:
    """Warn where loads build up too fast for answers at rest.

    Parameters
    ----------
    component : str
    frequency : float or None
        First natural frequency, Hz.
    ramp_time : float or None
        In which loads build up, s.

    Raises
    ------
    ValueError
        If one is given without the other, or is not over 0.
    """
    if frequency is None and ramp_time is None:
        return
    if frequency is None or ramp_time is None:
        raise InvalidArgument(
            "natural_frequency, Hz, and ramp_time, s, are given together; ramp_time alone where "
            "the source is a Client, whose server tells the frequency"
        )
    if not (frequency > 0.0 and ramp_time > 0.0):
        raise InvalidArgument("natural_frequency and ramp_time must be over 0")
    periods = frequency * ramp_time
    if periods < QUASI_STATIC:
        warnings.warn(
            f"{component} rings: its loads build up in {ramp_time:g} s, {periods:.3g} periods of "
            f"its first natural frequency, {frequency:g} Hz. Below about {QUASI_STATIC:g} answers "
            "at rest miss the ringing, by a factor of 2 and more either way: slower ramps, or a "
            "stiffer component",
            MountWarning,
            stacklevel=4,  # whoever makes the mount
        )
