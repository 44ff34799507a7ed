"""Command lines of the processes the service starts: of the same wrenchbook, not of another one."""

from __future__ import annotations

import sys


def child_command(module: str, *arguments: str) -> list[str]:
    """Return the command line that runs a module of wrenchbook in a process of its own.

    The child runs the wrenchbook that its parent runs, whatever the current folder or PYTHONPATH
    hold: it is started by the path of the file.

    Parameters
    ----------
    module : str
        What ``python -m`` would be given, such as ``wrenchbook.fea.check``.
    arguments : str
        Its arguments.
    """
    start = sys.modules["wrenchbook"].__file__
    return [sys.executable, "-P", str(start), "-m", module, *arguments]
