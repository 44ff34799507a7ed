"""Errors of a joint; each text says what to do."""

from __future__ import annotations

from ..errors import WrenchbookError


class JointError(WrenchbookError, RuntimeError):
    """A joint cannot go on, or its scene cannot have one."""


class JointRangeError(JointError):
    """The relative pose is far beyond what the part can have."""


class JointWarning(UserWarning):
    """The simulation goes on, with numbers that may be wrong; issued once a joint and kind."""
