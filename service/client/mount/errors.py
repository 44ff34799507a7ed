"""Errors of a mount; each text says what to do."""

from __future__ import annotations

from collections.abc import Sequence

from ..errors import WrenchbookError


class MountError(WrenchbookError, RuntimeError):
    """A mount cannot go on; nothing of it has moved."""


class SensorError(MountError):
    """The reading of the simulation cannot be the wrench on the component."""


class SourceError(MountError, TypeError):
    """The source of a mount is neither a table nor a client that the mode can use."""


class DisplacementUnknown(MountError):  # noqa: N818 (a state of the table, and a public name)
    """The component's table cannot answer, or lacks an output that the pose needs."""


class CouplingDiverged(MountError):  # noqa: N818 (the public name)
    """Scene and component drive each other apart instead of to an equilibrium.

    Parameters
    ----------
    message : str
        What happened, and the remedy.
    residuals : sequence of float
        How far pose and answer were apart, iteration by iteration, in tolerances.
    spectral_radius : float, optional
        G, the spectral radius of compliance times the scene's stiffness, where it is known.
    """

    def __init__(
        self, message: str, residuals: Sequence[float] = (), spectral_radius: float | None = None
    ) -> None:
        super().__init__(message)
        self.residuals = tuple(residuals)
        self.spectral_radius = spectral_radius


class MountWarning(UserWarning):
    """The loop goes on, with numbers that may be wrong; issued once a mount and kind."""
