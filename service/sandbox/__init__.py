"""Parsers of untrusted files run here: each in a subprocess with limits on memory, time and files.

A subprocess returns JSON and plain arrays in a file of bounded size, never a pickle.
"""

from wrenchbook.service.sandbox.parts import MIB, Limits, Part, SandboxBusyError, SandboxError
from wrenchbook.service.sandbox.process import Sandbox, run, warm_up

__all__ = [
    "MIB",
    "Limits",
    "Part",
    "Sandbox",
    "SandboxBusyError",
    "SandboxError",
    "run",
    "warm_up",
]
