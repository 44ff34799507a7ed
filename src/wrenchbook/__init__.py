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
    A downloaded or opened table, which answers in this process: in 20 to 40 µs with 100 solves, in
    0.7 to 2 ms with 3,000 measured rows.
arrays
    A table on arrays of JAX and PyTorch, for many environments at once.
Mount, MujocoMount, Settled
    The coupling of a rigid-body simulation to a component; in MuJoCo; its state at rest.
Joint, MujocoJoint, step_joints, pull_joints, joints_in_mj_step, LinearPart, JointReport
    A deformable part as a force element between two moving bodies; in MuJoCo, one or several;
    as springs.
Joints, MujocoJoints
    Many of them in one call a step; in many MuJoCo environments.
conventions
    Wrenches and poses of ROS, Drake, MuJoCo and PyBullet.
Scene, ComponentPlan
    The loads, outputs and tolerance that a simulation needs; the plan for each component.
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
packages are ``wrenchbook.fea``, ``wrenchbook.surrogate`` and ``wrenchbook.service``: in a checkout
links to the folders at its top, in a wheel folders.
"""

from __future__ import annotations

import importlib
import sys
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .service.client import (
        Client as Client,
        ComponentPlan as ComponentPlan,
        DeformedShape as DeformedShape,
        Displacement as Displacement,
        Displacements as Displacements,
        Envelope as Envelope,
        Event as Event,
        InvalidArgument as InvalidArgument,
        Job as Job,
        MissingPackage as MissingPackage,
        ProblemError as ProblemError,
        Recorder as Recorder,
        RecorderError as RecorderError,
        Recording as Recording,
        Round as Round,
        Scene as Scene,
        SceneError as SceneError,
        ServerTimeout as ServerTimeout,
        ServerUnreachable as ServerUnreachable,
        Started as Started,
        Stress as Stress,
        Table as Table,
        TableError as TableError,
        WrenchbookError as WrenchbookError,
        arrays as arrays,
        conventions as conventions,
        plot as plot,
    )
    from .service.client.async_client import AsyncClient as AsyncClient
    from .service.client.joint import (
        Joint as Joint,
        JointError as JointError,
        JointRangeError as JointRangeError,
        JointReport as JointReport,
        JointWarning as JointWarning,
        Joints as Joints,
        LinearPart as LinearPart,
    )
    from .service.client.joint.mujoco_joints import MujocoJoints as MujocoJoints
    from .service.client.joint.mujoco_callback import joints_in_mj_step as joints_in_mj_step
    from .service.client.joint.mujoco_joint import (
        MujocoJoint as MujocoJoint,
        pull_joints as pull_joints,
        step_joints as step_joints,
    )
    from .service.client.mount import (
        CouplingDiverged as CouplingDiverged,
        DisplacementUnknown as DisplacementUnknown,
        Mount as Mount,
        MountError as MountError,
        MountWarning as MountWarning,
        SensorError as SensorError,
        Settled as Settled,
    )
    from .service.client.mount.mujoco_mount import MujocoMount as MujocoMount

__version__ = "0.4.0"

_NAMES = {
    "service.client.async_client": "AsyncClient",
    "service.client": (
        "Client ComponentPlan DeformedShape Displacement Displacements Envelope Event "
        "InvalidArgument Job MissingPackage ProblemError Recorder RecorderError Recording "
        "Round Scene SceneError ServerTimeout ServerUnreachable Started Stress Table "
        "TableError WrenchbookError"
    ),
    "service.client.mount": (
        "CouplingDiverged DisplacementUnknown Mount MountError MountWarning SensorError Settled"
    ),
    "service.client.joint": (
        "Joint JointError JointRangeError JointReport JointWarning Joints LinearPart"
    ),
    "service.client.joint.mujoco_callback": "joints_in_mj_step",
    "service.client.joint.mujoco_joint": "MujocoJoint pull_joints step_joints",
    "service.client.joint.mujoco_joints": "MujocoJoints",
    "service.client.mount.mujoco_mount": "MujocoMount",
    "service.client.arrays": "arrays",
    "service.client.conventions": "conventions",
    "service.client.plot": "plot",
}
_HOME = {name: module for module, names in _NAMES.items() for name in names.split()}
__all__ = sorted(_HOME)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    """Load a public name at its first use (PEP 562)."""
    if name not in _HOME:
        raise AttributeError(f"module 'wrenchbook' has no {name!r}; it has {', '.join(__all__)}")
    home = importlib.import_module(f"wrenchbook.{_HOME[name]}")
    globals()[name] = home if name == _HOME[name].rpartition(".")[2] else getattr(home, name)
    return globals()[name]


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
