"""Waiting for what other threads and processes do."""

import time
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")


def until(condition: Callable[[], T], seconds: float = 600.0) -> T:
    """Look again and again until there is something; return it. After `seconds` it hangs."""
    deadline = time.monotonic() + seconds
    while not (result := condition()):
        assert time.monotonic() < deadline, f"did not come about in {seconds:g} s"
        time.sleep(0.01)
    return result
