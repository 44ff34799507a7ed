"""The joint: a flexible part as a force element between two moving rigid bodies."""

from ..errors import JointError, JointRangeError, JointWarning
from .joint import Joint
from .joints import Joints
from .linear_part import LinearPart
from .report import JointReport

__all__ = [
    "Joint",
    "JointError",
    "JointRangeError",
    "JointReport",
    "JointWarning",
    "Joints",
    "LinearPart",
]
