"""What a simulator imports, as `wrenchbook`: numpy and the standard library only.

`AsyncClient` is in `async_client`, apart, since asyncio takes longer to load than all the rest.

>>> from wrenchbook import Client
>>> with Client("http://127.0.0.1:8000") as client:            # doctest: +SKIP
...     answer = client.displacement("plate", [0, 0, -800], [0, 40, 0])
...     R, p = answer.apply(R0, p0)
"""

from ..messages import DeformedShape, Stress
from .deformed import SurfaceCalls
from .displacement import DisplacementCalls
from .errors import (
    InvalidArgument,
    MissingPackage,
    ProblemError,
    ServerTimeout,
    ServerUnreachable,
    TableError,
    WrenchbookError,
)
from .events import Event, EventCalls
from .job import Job, JobCalls, Round
from .library import LibraryCalls
from .recorder import Recorder, RecorderError
from .recording import Envelope, Recording, RecordingCalls, Started
from .replies import Displacement, Displacements
from .scene import ComponentPlan, Scene, SceneError
from .table import DownloadCalls, Table


class Client(
    DisplacementCalls,
    SurfaceCalls,
    JobCalls,
    LibraryCalls,
    DownloadCalls,
    RecordingCalls,
    EventCalls,
):
    """A client of one server, for any number of threads.

    Parameters
    ----------
    url : str
        Address of the server.
    timeout : float
        Seconds without an answer before `ServerTimeout`; the time that a call lets the server wait
        is added. A server that refuses the connection, as while it restarts, is tried again for as
        long, but 10 s at most.
    key : str, optional
        A key of the server; the variable WRENCHBOOK_KEY if not given.

    Attributes
    ----------
    retry_s : float
        Those 10 s; 0 for no second attempt.

    Examples
    --------
    >>> with Client() as client:                                # doctest: +SKIP
    ...     answer = client.displacement("plate", [0, 0, -800], on_thin="wait")
    ...     answer.translation, answer.error_translation
    """


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
