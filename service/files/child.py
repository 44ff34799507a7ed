"""Command lines of the processes the service starts: always the rooms beside its own."""

from __future__ import annotations

import sys
from pathlib import Path

# The public face beside this room; run by its path there is no doubt about which one it is.
_FACE = Path(__file__).resolve().parents[2] / "wrenchbook.py"


def child_command(module: str, *arguments: str) -> list[str]:
    """Return the command line that runs a module of the rooms in a process of its own.

    Whatever the current folder or PYTHONPATH hold, the child runs the ``fea``, ``surrogate`` and
    ``service`` that its parent runs.

    Parameters
    ----------
    module : str
        What ``python -m`` would be given, such as ``fea.check``.
    arguments : str
        Its arguments.
    """
    return [sys.executable, "-P", str(_FACE), "-m", module, *arguments]
