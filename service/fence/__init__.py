"""Strangers' bytes are read here: in a child with limits on memory, time and files.

`fenced` runs a function of the rooms, by name, on a file, in a child that ends with it; `program`
runs a module as a program the same way. What a child answers is numbers and JSON, in a file whose
size is bounded; never a pickle.
"""

from service.fence.errors import (
    FenceBusyError,
    FenceCrashError,
    FenceError,
    FenceMemoryError,
    FenceSizeError,
    FenceTimeError,
    RaisedInFenceError,
)
from service.fence.fence import fenced, warm_up
from service.fence.limits import Limits
from service.fence.parts import Part
from service.fence.program import Printed, program

__all__ = [
    "FenceBusyError",
    "FenceCrashError",
    "FenceError",
    "FenceMemoryError",
    "FenceSizeError",
    "FenceTimeError",
    "Limits",
    "Part",
    "Printed",
    "RaisedInFenceError",
    "fenced",
    "program",
    "warm_up",
]
