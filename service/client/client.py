"""The client: displacements, deformed surfaces and events; other files have its further calls."""

from __future__ import annotations

import http.client
import json
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlencode

from numpy.typing import ArrayLike

from ..contract import LOADS, QUERY_WAIT_S, OnThin
from ..messages import DeformedShape
from .errors import Document, ProblemError, ServerUnreachable
from .job import JobCalls
from .library import LibraryCalls, format_of
from .recording import RecordingCalls
from .replies import Displacement, Displacements
from .table import DownloadCalls
from .transport import BINARY, Connection, component_path
from .wrenches import Load, Tolerance, loads_body, many_wrenches, options, single_wrench, wrench_of

# Wrenches from which a batch is sent as float64 by default: twenty times faster than JSON.
BINARY_FROM = 1000
FORMATS = {".glb": "gltf", ".vtu": "vtu", ".json": "json"}  # of a surface's file by its ending
SILENCE_S = 45.0  # three heartbeats: a connection without one in this time is dead
# Pause between attempts while the server is away, s: doubled from the first to the second.
AGAIN_S = (0.2, 5.0)


class DisplacementCalls(Connection):
    """Displacements under one wrench, under many, and from a finite-element solve."""

    def displacement(
        self,
        name: str,
        force: ArrayLike | None = None,
        moment: ArrayLike | None = None,
        *,
        loads: Mapping[str, Load] | None = None,
        inputs: Mapping[str, float] | None = None,
        on_thin: OnThin = "queue",
        wait_s: float | None = None,
        tolerance: Tolerance | None = None,
        method: str | None = None,
        detail: bool = False,
        derivatives: bool = False,
        beyond_range: bool = False,
    ) -> Displacement:
        """Return the displacement of a component's interface under one wrench, N and N·m.

        Parameters
        ----------
        name : str
            The component.
        force, moment : array_like
            Shape (3,), N, and shape (3,), N·m, acting ON the component about its interface point
            where it is now, in axes fixed to the undeformed interface frame; or the whole wrench as
            the force alone, shape (6,).
        loads : mapping, optional
            Instead of force and moment, of a component with several interfaces: the wrench at each
            by its name, shape (6,) or a mapping of ``force`` and ``moment``; zero where it is left
            out.
        inputs : mapping, optional
            The component's further inputs by name, in the unit of the component: ``temperature`` in
            degC unless its bundle says K.
        on_thin : {"queue", "wait", "estimate", "reject"}
            Where the table does not cover the wrench: queue a solve and answer with an estimate;
            wait for that solve; only estimate; refuse.
        wait_s : float, optional
            With ``wait``: seconds to wait for the solve; the server's default is 30.
        tolerance : mapping or pair, optional
            ``{"translation": m, "rotation": rad}``; the component's own otherwise.
        method : str, optional
            The method of the answer, such as ``griddata``; the component's own choice otherwise.
        detail : bool
            Whether ``raw`` has ``error_parts``, the parts of the error bar, and ``axes``,
            the displacement by the loads of each axis.
        derivatives : bool
            Whether the answer has `derivative`, du/dw, 6 x 6 for each wrench.
        beyond_range : bool
            Whether a wrench outside the component's load range may be solved. If not, ``queue``
            answers it flagged and without a job, and ``wait`` and `solve` refuse it.

        Returns
        -------
        Displacement
            Shapes (3,), m and rad; with `Displacement.job` while a solve is queued or running.

        Raises
        ------
        ValueError
            If a number is not finite or a shape is wrong; nothing was sent.
        ProblemError
            404 without such a component; 409 if ``reject`` finds the wrench not covered
            or ``wait`` finds it beyond the load range; 424 if its solve failed.
        """
        body = loads_body(force, moment, loads, inputs)
        chosen = options(
            on_thin=on_thin,
            wait_s=wait_s,
            tolerance=tolerance,
            method=method,
            detail=detail or None,
            derivatives=derivatives or None,
            beyond_range=beyond_range or None,
        )
        return self._displacement(name, "displacement", body, chosen)

    def displacements(
        self,
        name: str,
        wrenches: ArrayLike,
        *,
        on_thin: OnThin = "queue",
        wait_s: float | None = None,
        tolerance: Tolerance | None = None,
        method: str | None = None,
        derivatives: bool = False,
        beyond_range: bool = False,
        binary: bool | None = None,
    ) -> Displacements:
        """Return the displacements under many wrenches, shape (n, inputs), SI, in one call.

        Other parameters and errors are those of `displacement`; with ``wait`` one `wait_s` is for
        all wrenches.

        Parameters
        ----------
        binary : bool, optional
            Whether to send and receive float64 instead of JSON, some twenty times as fast; from
            1000 wrenches on if not given. The answers then do not list the jobs they queued.
        """
        block = many_wrenches(wrenches, None)
        chosen = options(
            on_thin=on_thin,
            wait_s=wait_s,
            tolerance=tolerance,
            method=method,
            derivatives=derivatives or None,
            beyond_range=beyond_range or None,
        )
        path = component_path(name, "displacements")
        wait_s = _server_wait(chosen)
        if len(block) >= BINARY_FROM if binary is None else binary:
            tolerance_query = chosen.pop("tolerance", {})
            query = chosen | tolerance_query | {"inputs": block.shape[1]}
            content = block.astype("<f8").tobytes()
            reply = self.call("POST", path, content, kind=BINARY, query=query, wait_s=wait_s)
            return Displacements.read_binary(name, block, reply)
        reply = self.call_json("POST", path, {"wrenches": block.tolist()} | chosen, wait_s=wait_s)
        return Displacements.read({"component": name} | reply, block)

    def solve(
        self,
        name: str,
        force: ArrayLike | None = None,
        moment: ArrayLike | None = None,
        *,
        loads: Mapping[str, Load] | None = None,
        inputs: Mapping[str, float] | None = None,
        wait_s: float | None = None,
        beyond_range: bool = False,
    ) -> Displacement:
        """Solve one wrench, N and N·m, with finite elements, whatever the table says.

        Other parameters are those of `displacement`.

        Parameters
        ----------
        wait_s : float, optional
            Seconds to wait for the solve; at once back with the job if not given.

        Returns
        -------
        Displacement
            Shapes (3,), m and rad; with ``source`` ``fea`` when the solve is done, else with its
            `Displacement.job`.

        Raises
        ------
        ValueError, ProblemError, ServerUnreachable, ServerTimeout
            As in `displacement`.
        """
        body = loads_body(force, moment, loads, inputs)
        chosen = options(wait_s=wait_s, beyond_range=beyond_range or None)
        return self._displacement(name, "solve", body, chosen)

    def _displacement(
        self, name: str, call: str, loads: Document, chosen: Document
    ) -> Displacement:
        path = component_path(name, call)
        body = loads | chosen
        reply = self.call_json("POST", path, body, wait_s=_server_wait(chosen))
        return Displacement.read({"component": name} | reply, wrench_of(loads), loads.get("loads"))


def _server_wait(chosen: Document) -> float:
    """Return the seconds for which the server may wait: `wait_s`, or its default with ``wait``."""
    if "on_thin" not in chosen:
        return chosen.get("wait_s", 0.0)
    return chosen.get("wait_s", QUERY_WAIT_S) if chosen["on_thin"] == "wait" else 0.0


def deformed_format(file: str | Path) -> str:
    """Return the format of a surface's file by its ending; raises InvalidArgument."""
    return format_of(file, "surface", FORMATS)


class SurfaceCalls(Connection):
    """Deformed surfaces, as arrays and as files."""

    def deformed(
        self, name: str, force: ArrayLike, moment: ArrayLike | None = None
    ) -> DeformedShape:
        """Return a component's deformed surface under one wrench, N and N·m.

        Raises
        ------
        ValueError
            If a number is not finite or a shape is wrong; nothing was sent.
        ProblemError
            If there is no such component (404); if no row of it has a surface, or the wrench is
            far beyond the load range (409): the message says what to do.
        """
        return DeformedShape.read(self.call_json("GET", _path(name, force, moment, "json")))

    def deformed_file(
        self,
        name: str,
        force: ArrayLike,
        moment: ArrayLike | None = None,
        format: str = "gltf",  # noqa: A002 (the contract's word)
    ) -> bytes:
        """Return the surface of `deformed` as a file: ``gltf`` (.glb), ``vtu`` or ``json``.

        Lengths in the file are m.
        """
        return self.call("GET", _path(name, force, moment, format)).content


def _path(name: str, force: ArrayLike, moment: ArrayLike | None, form: str) -> str:
    loads = single_wrench(force, moment).tolist()
    query = {load: repr(value) for load, value in zip(LOADS, loads, strict=True)}
    return f"{component_path(name, 'deformed')}?{urlencode({**query, 'format': form})}"


@dataclass(frozen=True)
class Event:
    """One event.

    Parameters
    ----------
    kind : str
        ``hello``, ``job``, ``jobs``, ``table``, ``missed`` or ``dropped``.
    body : dict
        Of ``job`` its id, status, component and, while it runs, progress; of ``table`` its
        component and table_version; of ``missed`` and ``dropped`` the reason.
    id : str
        To go on after it, with ``client.events(after=...)``.
    """

    kind: str
    body: Document
    id: str = ""


class EventCalls(Connection):
    """Events of the server."""

    def events(
        self,
        component: str | None = None,
        *,
        after: str | None = None,
        timeout_s: float | None = None,
    ) -> Iterator[Event]:
        """Iterate over the events of one component, or of all; heartbeats are no events.

        While the server is away it is tried again and again. The iteration then goes on after the
        last event; where the server no longer has what came in between, an event is ``missed``.

        Parameters
        ----------
        component : str, optional
            Only events about this one.
        after : str, optional
            The id of an earlier event.
        timeout_s : float, optional
            The iteration ends after so long without an event; never if not given.

        Yields
        ------
        Event

        Raises
        ------
        ProblemError
            If there is no such component (404), or too many listen (503; of this key 429).
        ServerUnreachable
            If nothing answers at the first attempt.
        """
        last = after
        wait = AGAIN_S[0]
        first = True
        limit = float("inf") if timeout_s is None else timeout_s
        newest = time.monotonic()  # time of the last event
        while True:
            if (remaining := newest + limit - time.monotonic()) <= 0:
                return

            headers = {"Accept": "text/event-stream", **({"Last-Event-ID": last} if last else {})}
            try:
                query = {"component": component}
                stream = self._listen("/v1/events", query, headers, min(SILENCE_S, remaining))
                first = False
                try:
                    parser = EventParser()
                    while line := stream.readline():
                        event = parser.feed(line)
                        if event is not None:
                            last = event.id or last
                            wait = AGAIN_S[0]
                            yield event
                            newest = time.monotonic()
                        elif newest + limit <= time.monotonic():
                            return
                finally:
                    stream.close()
            except ProblemError as error:
                if first or error.status < 500:
                    raise
            except (ServerUnreachable, http.client.HTTPException, EOFError, OSError) as error:
                if first and not isinstance(error, TimeoutError):
                    raise

            first = False
            time.sleep(max(min(wait, newest + limit - time.monotonic()), 0.0))
            wait = min(2 * wait, AGAIN_S[1])


class EventParser:
    """Parser of server-sent events, by lines (WHATWG HTML, section 9.2.6)."""

    def __init__(self) -> None:
        self._kind = "message"
        self._id = ""
        self._content: list[str] = []

    def feed(self, line: bytes) -> Event | None:
        """Take a line; return the event that it completes, if any."""
        name, _, value = line.rstrip(b"\r\n").decode(errors="replace").partition(":")
        value = value.removeprefix(" ")
        if name == "event":
            self._kind = value
        elif name == "data":
            self._content.append(value)
        elif name == "id":
            self._id = value
        elif not line.strip():
            kind, content = self._kind, self._content
            self._kind = "message"
            self._content = []
            return Event(kind, json.loads("\n".join(content)), self._id) if content else None
        return None


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
        Seconds of further attempts at a server that refuses the connection, 10; 0 for none.

    Examples
    --------
    >>> with Client() as client:                                # doctest: +SKIP
    ...     answer = client.displacement("plate", [0, 0, -800], on_thin="wait")
    ...     answer.translation, answer.error_translation
    """
