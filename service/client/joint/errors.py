"""Errors of a joint; each text says what to do."""

from __future__ import annotations

import sys
import warnings
from pathlib import Path
from types import FrameType

from ..errors import WrenchbookError


class JointError(WrenchbookError, RuntimeError):
    """A joint cannot go on, or its scene cannot have one."""


class JointRangeError(JointError):
    """The relative pose is far beyond what the part can have."""


class JointWarning(UserWarning):
    """The simulation goes on, with numbers that may be wrong; issued once a joint and kind."""


def warn(message: str) -> None:
    """Issue a `JointWarning` at the line that called this folder, from however deep within."""
    folder, level = str(Path(__file__).parent), 1
    caller: FrameType | None = sys._getframe()
    while caller is not None and caller.f_code.co_filename.startswith(folder):
        level, caller = level + 1, caller.f_back
    warnings.warn(message, JointWarning, stacklevel=level)
