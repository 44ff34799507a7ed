"""What arrays something holds, counted."""

from __future__ import annotations

from collections.abc import Mapping
from types import BuiltinFunctionType, FunctionType, MethodType, ModuleType
from typing import Any

import numpy as np

_PLAIN = (
    str, bytes, int, float, bool, type(None), type, ModuleType, FunctionType, MethodType,
    BuiltinFunctionType,
)  # fmt: skip


def array_bytes(*held: Any) -> int:
    """Return the bytes of all arrays that objects hold, directly or not, each counted once.

    A view counts as the whole array that it is of, since it keeps that alive.
    """
    seen: set[int] = set()
    total, waiting = 0, list(held)
    while waiting:
        one = waiting.pop()
        if isinstance(one, np.ndarray):
            while isinstance(one.base, np.ndarray):
                one = one.base
        if isinstance(one, _PLAIN) or id(one) in seen:
            continue
        seen.add(id(one))
        if isinstance(one, np.ndarray):
            total += one.nbytes
        elif isinstance(one, Mapping):
            waiting.extend(one.values())
        elif isinstance(one, tuple | list | set | frozenset):
            waiting.extend(one)
        else:
            waiting.extend(getattr(one, "__dict__", {}).values())
    return total
