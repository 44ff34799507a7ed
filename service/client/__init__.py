"""What a simulator imports: numpy and the standard library only.

>>> from service.client import Client
>>> with Client("http://127.0.0.1:8000") as client:            # doctest: +SKIP
...     answer = client.displacement("plate", [0, 0, -800], [0, 40, 0])
...     R, p = answer.apply(R0, p0)
"""

from service.client.errors import ProblemError, ServerTimeout, ServerUnreachable
from service.client.library import Library
from service.client.questions import Questions
from service.client.replies import Displacement, Displacements
from service.client.solves import Job, Round
from service.client.working import Working


class Client(Questions, Working, Library):
    """A client of one server, for any number of threads.

    Parameters
    ----------
    url : str
        Address of the server.
    timeout : float
        Seconds without an answer before `ServerTimeout`; the time a call asks the server to wait
        is added to it.

    Examples
    --------
    >>> with Client() as client:                                # doctest: +SKIP
    ...     answer = client.displacement("plate", [0, 0, -800], on_thin="wait")
    ...     answer.translation, answer.error_translation
    """


__all__ = [
    "Client",
    "Displacement",
    "Displacements",
    "Job",
    "ProblemError",
    "Round",
    "ServerTimeout",
    "ServerUnreachable",
]
