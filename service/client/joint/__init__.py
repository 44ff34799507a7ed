"""The joint: a part that bends as a force element between two rigid bodies that move."""

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
