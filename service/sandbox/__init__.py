"""Strangers' bytes are read here: in a child with limits on memory, time and files.

`fenced` runs a function of the rooms, by name, on a file, in a child that ends with it; `program`
runs a module as a program the same way. What a child answers is numbers and JSON, in a file whose
size is bounded; never a pickle.
"""

from service.sandbox.errors import (
    FenceBusyError,
    FenceCrashError,
    FenceError,
    FenceMemoryError,
    FenceSizeError,
    FenceTimeError,
    RaisedInFenceError,
)
from service.sandbox.limits import Limits
from service.sandbox.parts import Part
from service.sandbox.process import fenced, warm_up
from service.sandbox.program import Printed, program

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
