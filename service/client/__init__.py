"""What a simulator imports, as `wrenchbook`: numpy and the standard library only.

>>> from wrenchbook import Client
>>> with Client("http://127.0.0.1:8000") as client:            # doctest: +SKIP
...     answer = client.displacement("plate", [0, 0, -800], [0, 40, 0])
...     R, p = answer.apply(R0, p0)
"""

from .deformed import DeformedShape, DeformedShapes, Stress
from .errors import ProblemError, ServerTimeout, ServerUnreachable
from .event_calls import Event, EventCalls
from .job import Job, Round
from .job_calls import JobCalls
from .library import Library
from .questions import Questions
from .recording import Recorder, RecorderError
from .recording_calls import Envelope, Recording, RecordingCalls, Started
from .replies import Displacement, Displacements
from .scene import ComponentPlan, Scene, SceneError
from .table import Downloads, Table


class Client(Questions, DeformedShapes, JobCalls, Library, Downloads, RecordingCalls, EventCalls):
    """A client of one server, for any number of threads.

    Parameters
    ----------
    url : str
        Address of the server.
    timeout : float
        Seconds without an answer before `ServerTimeout`; the time a call asks the server to wait
        is added to it.
    key : str, optional
        What the server was told to let in; the variable WRENCHBOOK_KEY if not given.

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
    "Job",
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
]
