"""The client package of simulators, imported as `wrenchbook`: numpy and the standard library only.

`AsyncClient` is in `async_client`, apart, since asyncio takes longer to load than the rest.

>>> from wrenchbook import Client
>>> with Client("http://127.0.0.1:8000") as client:            # doctest: +SKIP
...     answer = client.displacement("plate", [0, 0, -800], [0, 40, 0])
...     R, p = answer.apply(R0, p0)
"""

from ..messages import DeformedShape, Stress
from .client import Client, Event
from .errors import (
    InvalidArgument,
    MissingPackage,
    ProblemError,
    ServerTimeout,
    ServerUnreachable,
    TableError,
    WrenchbookError,
)
from .job import Job, Round
from .recorder import Recorder, RecorderError
from .recording import Envelope, Recording, Started
from .replies import Displacement, Displacements
from .scene import ComponentPlan, Scene, SceneError
from .table import Table

__all__ = [
    "Client",
    "ComponentPlan",
    "DeformedShape",
    "Displacement",
    "Displacements",
    "Envelope",
    "Event",
    "InvalidArgument",
    "Job",
    "MissingPackage",
    "ProblemError",
    "Recorder",
    "RecorderError",
    "Recording",
    "Round",
    "Scene",
    "SceneError",
    "ServerTimeout",
    "ServerUnreachable",
    "Started",
    "Stress",
    "Table",
    "TableError",
    "WrenchbookError",
]
