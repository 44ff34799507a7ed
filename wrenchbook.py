"""Displacements of deformable components from tables of finite-element solves.

>>> from wrenchbook import Client
>>> with Client("http://127.0.0.1:8000") as client:            # doctest: +SKIP
...     answer = client.displacement("plate", [0, 0, -800], [0, 40, 0])
...     R, p = answer.apply(R0, p0)

Each public name is loaded when it is first used, so that a simulator pays for what it uses. The
client and the surrogate are found beside this file and not by the names ``service`` and
``surrogate``: a project may have packages of those names of its own.

Run as a program, this file is the command ``wrenchbook``, and with ``-m`` any other program of the
rooms beside it: ``python wrenchbook.py -m wrenchbook.fea.check FOLDER``.
"""

from __future__ import annotations

import importlib
import importlib.util
import runpy
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .service.client import (
        Client,
        ComponentPlan,
        Displacement,
        Displacements,
        Job,
        ProblemError,
        Recorder,
        RecorderError,
        Round,
        Scene,
        SceneError,
        ServerTimeout,
        ServerUnreachable,
        Table,
        conventions,
    )
    from .service.client.mount import CouplingDiverged, Mount, MountError, MountWarning
    from .service.client.mount.mujoco_mount import MujocoMount

_HERE = Path(__file__).resolve().parent
# This file is one module that is also a package of what simulators import: `wrenchbook.client` is
# service/client beside this file, whatever the name `service` means in the program that imports it.
__path__ = [str(_HERE / "service")]

_ROOMS = ("fea", "surrogate", "service")
_HOME = {
    "Client": "client",
    "ComponentPlan": "client",
    "CouplingDiverged": "client.mount",
    "Displacement": "client",
    "Displacements": "client",
    "Job": "client",
    "Mount": "client.mount",
    "MountError": "client.mount",
    "MountWarning": "client.mount",
    "MujocoMount": "client.mount.mujoco_mount",
    "ProblemError": "client",
    "Recorder": "client",
    "RecorderError": "client",
    "Round": "client",
    "Scene": "client",
    "SceneError": "client",
    "ServerTimeout": "client",
    "ServerUnreachable": "client",
    "Table": "client",
    "conventions": "client.conventions",
}
__all__ = [
    "Client",
    "ComponentPlan",
    "CouplingDiverged",
    "Displacement",
    "Displacements",
    "Job",
    "Mount",
    "MountError",
    "MountWarning",
    "MujocoMount",
    "ProblemError",
    "Recorder",
    "RecorderError",
    "Round",
    "Scene",
    "SceneError",
    "ServerTimeout",
    "ServerUnreachable",
    "Table",
    "conventions",
]


def __getattr__(name: str) -> Any:
    """Load a public name when it is first asked for (PEP 562)."""
    if name not in _HOME:
        raise AttributeError(f"module 'wrenchbook' has no {name!r}; it has {', '.join(__all__)}")
    home = importlib.import_module(f"wrenchbook.{_HOME[name]}")
    found = home if name == _HOME[name].rpartition(".")[2] else getattr(home, name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted(__all__)


def main() -> None:
    """Run the command line in a process of its own.

    Raises
    ------
    SystemExit
        With 1 and what to install if the server's packages are missing, else as the command says.
    """
    claim_rooms()
    try:
        program = importlib.import_module("service.cli.main")
    except ModuleNotFoundError as error:
        if error.name is None or error.name.partition(".")[0] in _ROOMS:
            raise
        sys.exit(
            f"wrenchbook: the package {error.name!r} is not installed. The server and the command "
            "line need more than the client: pip install 'wrenchbook[server]'"
        )
    program.main()


def claim_rooms() -> None:
    """Make ``fea``, ``surrogate`` and ``service`` mean the packages beside this file.

    For processes that are wrenchbook's own, before they import anything: neither the current folder
    nor PYTHONPATH can then put another package of that name in the way.

    Raises
    ------
    RuntimeError
        If another package of such a name has been imported already.
    """
    for name in _ROOMS:
        there, start = sys.modules.get(name), _HERE / name / "__init__.py"
        if there is not None:
            if there.__file__ and Path(there.__file__).resolve() == start:
                continue
            raise RuntimeError(
                f"this process has imported the package {name!r} of {there.__file__}, so it cannot "
                "run wrenchbook's own; start wrenchbook in a process of its own"
            )
        _load_room(name, name)


def _load_room(name: str, folder: str) -> None:
    """Load the package of a folder beside this file under a name."""
    start = _HERE / folder / "__init__.py"
    spec = importlib.util.spec_from_file_location(
        name, start, submodule_search_locations=[str(start.parent)]
    )
    assert spec is not None
    assert spec.loader is not None
    room = importlib.util.module_from_spec(spec)
    sys.modules[name] = room
    spec.loader.exec_module(room)


def _run() -> None:
    """Run the command line, or after ``-m`` another program of the rooms."""
    if sys.argv[1:2] != ["-m"]:
        main()
        return
    claim_rooms()
    module = sys.argv[2]
    del sys.argv[1:3]
    runpy.run_module(module, run_name="__main__", alter_sys=True)


# What a table in this process is made of, under a name that no other package has. It is a line of
# text until something of it is used.
_load_room(f"{__name__}.surrogate", "surrogate")

if __name__ == "__main__":
    _run()
