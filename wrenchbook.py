"""Displacements of deformable components from tables of finite-element solves.

>>> from wrenchbook import Client
>>> with Client("http://127.0.0.1:8000") as client:            # doctest: +SKIP
...     answer = client.displacement("plate", [0, 0, -800], [0, 40, 0])
...     R, p = answer.apply(R0, p0)

Client, AsyncClient
    A client of a server; blocking, for any number of threads, or for asyncio.
Displacement, Displacements
    The answer to one wrench, the answers to many.
Table
    A downloaded or opened table, which answers in this process in microseconds.
arrays
    A table on arrays of JAX and PyTorch, for many environments at once.
Mount, MujocoMount, Settled
    The joint between a rigid-body simulation and a component; in MuJoCo; where it is at rest.
Joint, MujocoJoint, step_joints, LinearPart
    A part that bends as a force element between two bodies that move; in MuJoCo, one or several;
    as springs.
conventions
    Wrenches and poses of ROS, Drake, MuJoCo and PyBullet.
Scene, ComponentPlan
    What a simulation needs of its components, and what is left out.
Job, Round, Event
    A queued solve, a round of filling a table, an event of the server.
Recorder, Recording, Envelope, Started
    Wrenches of a loop, sent without waiting; the recorded ones; extremes; queued solves.
DeformedShape, Stress
    A deformed surface, and its largest von Mises stress.
plot
    Figures of a response with its error band, of coverage and of a deformed part.
WrenchbookError
    The base of all errors: InvalidArgument, MissingPackage, ProblemError, RecorderError,
    SceneError, ServerTimeout, ServerUnreachable, TableError, MountError (SensorError,
    DisplacementUnknown, CouplingDiverged), JointError (JointRangeError). MountWarning and
    JointWarning are the warnings.

Each public name is loaded when it is first used, so that a simulator pays for what it uses. The
packages next to this file are ``wrenchbook.fea``, ``wrenchbook.surrogate`` and
``wrenchbook.service``, in a checkout as in a wheel, where this file is ``wrenchbook/__init__.py``.

Run as a program, this file is the command ``wrenchbook``, and with ``-m`` any other program:
``python wrenchbook.py -m wrenchbook.fea.check FOLDER``.
"""

from __future__ import annotations

import importlib
import runpy
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .service.client import (
        Client,
        ComponentPlan,
        DeformedShape,
        Displacement,
        Displacements,
        Envelope,
        Event,
        InvalidArgument,
        Job,
        MissingPackage,
        ProblemError,
        Recorder,
        RecorderError,
        Recording,
        Round,
        Scene,
        SceneError,
        ServerTimeout,
        ServerUnreachable,
        Started,
        Stress,
        Table,
        TableError,
        WrenchbookError,
        arrays,
        conventions,
        plot,
    )
    from .service.client.async_client import AsyncClient
    from .service.client.joint import Joint, JointError, JointRangeError, JointWarning, LinearPart
    from .service.client.joint.mujoco_joint import MujocoJoint, step_joints
    from .service.client.mount import (
        CouplingDiverged,
        DisplacementUnknown,
        Mount,
        MountError,
        MountWarning,
        SensorError,
        Settled,
    )
    from .service.client.mount.mujoco_mount import MujocoMount

__path__ = [str(Path(__file__).resolve().parent)]  # one module that is also a package
if __name__ in ("__main__", "__mp_main__"):  # run by its path: the packages next to it
    sys.modules.setdefault("wrenchbook", sys.modules[__name__])
__version__ = "0.3.0"

_HOME = {
    "AsyncClient": "service.client.async_client",
    "Client": "service.client",
    "ComponentPlan": "service.client",
    "CouplingDiverged": "service.client.mount",
    "DeformedShape": "service.client",
    "Displacement": "service.client",
    "DisplacementUnknown": "service.client.mount",
    "Displacements": "service.client",
    "Envelope": "service.client",
    "Event": "service.client",
    "InvalidArgument": "service.client",
    "Job": "service.client",
    "Joint": "service.client.joint",
    "JointError": "service.client.joint",
    "JointRangeError": "service.client.joint",
    "JointWarning": "service.client.joint",
    "LinearPart": "service.client.joint",
    "MissingPackage": "service.client",
    "Mount": "service.client.mount",
    "MountError": "service.client.mount",
    "MountWarning": "service.client.mount",
    "MujocoJoint": "service.client.joint.mujoco_joint",
    "MujocoMount": "service.client.mount.mujoco_mount",
    "ProblemError": "service.client",
    "Recorder": "service.client",
    "RecorderError": "service.client",
    "Recording": "service.client",
    "Round": "service.client",
    "Scene": "service.client",
    "SceneError": "service.client",
    "SensorError": "service.client.mount",
    "ServerTimeout": "service.client",
    "ServerUnreachable": "service.client",
    "Settled": "service.client.mount",
    "Started": "service.client",
    "Stress": "service.client",
    "Table": "service.client",
    "TableError": "service.client",
    "WrenchbookError": "service.client",
    "arrays": "service.client.arrays",
    "conventions": "service.client.conventions",
    "plot": "service.client.plot",
    "step_joints": "service.client.joint.mujoco_joint",
}
__all__ = [
    "AsyncClient",
    "Client",
    "ComponentPlan",
    "CouplingDiverged",
    "DeformedShape",
    "Displacement",
    "DisplacementUnknown",
    "Displacements",
    "Envelope",
    "Event",
    "InvalidArgument",
    "Job",
    "Joint",
    "JointError",
    "JointRangeError",
    "JointWarning",
    "LinearPart",
    "MissingPackage",
    "Mount",
    "MountError",
    "MountWarning",
    "MujocoJoint",
    "MujocoMount",
    "ProblemError",
    "Recorder",
    "RecorderError",
    "Recording",
    "Round",
    "Scene",
    "SceneError",
    "SensorError",
    "ServerTimeout",
    "ServerUnreachable",
    "Settled",
    "Started",
    "Stress",
    "Table",
    "TableError",
    "WrenchbookError",
    "arrays",
    "conventions",
    "plot",
    "step_joints",
]


def __getattr__(name: str) -> Any:
    """Load a public name at its first use (PEP 562)."""
    if name not in _HOME:
        raise AttributeError(f"module 'wrenchbook' has no {name!r}; it has {', '.join(__all__)}")
    home = importlib.import_module(f"wrenchbook.{_HOME[name]}")
    found = home if name == _HOME[name].rpartition(".")[2] else getattr(home, name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted(__all__)


def main() -> None:
    """Run the command line.

    Raises
    ------
    SystemExit
        With 1 and what to install if the server's packages are missing, else as the command says.
    """
    try:
        program = importlib.import_module("wrenchbook.service.cli.main")
    except ModuleNotFoundError as error:
        if error.name is None or error.name.startswith("wrenchbook"):
            raise
        sys.exit(
            f"wrenchbook: the package {error.name!r} is not installed. The server and the command "
            "line need more than the client: pip install 'wrenchbook[server]'"
        )
    program.main()


def _run() -> None:
    """Run the command line, or after ``-m`` another program."""
    if sys.argv[1:2] != ["-m"]:
        main()
        return
    module = sys.argv[2]
    del sys.argv[1:3]
    runpy.run_module(module, run_name="__main__", alter_sys=True)


if __name__ == "__main__":
    _run()
