"""The calls that a simulator makes in its loop."""

from __future__ import annotations

from collections.abc import Mapping

from numpy.typing import ArrayLike

from ..contract import OnThin
from .errors import Document
from .replies import Displacement, Displacements
from .transport import BINARY, Connection, component_path
from .wrenches import Load, Tolerance, loads_body, many_wrenches, options, wrench_of

BINARY_FROM = 1000  # wrenches from which a batch is sent as float64, if not given


class DisplacementCalls(Connection):
    """Displacements under one wrench, under many, and from a finite-element solve.

    What the calls have in common:

    name : str
        The component.
    force, moment : array_like
        Shape (3,), N, and shape (3,), N·m, acting ON the component about its interface point where
        it is now, in axes fixed to the undeformed interface frame; or the whole wrench as the force
        alone, shape (6,).
    loads : mapping, optional
        Instead of force and moment, of a component with several interfaces: the wrench at each by
        its name, shape (6,) or a mapping of ``force`` and ``moment``; zero where it is left out.
    inputs : mapping, optional
        The component's further inputs by name, such as ``temperature``, SI.
    on_thin : {"queue", "wait", "estimate", "reject"}
        Where the table is too thin: queue a solve and answer with the best estimate; wait for
        that solve; only estimate; refuse.
    wait_s : float, optional
        With ``wait``: seconds to wait for the solve; the server's default is 30.
    tolerance : mapping or pair, optional
        ``{"translation": m, "rotation": rad}``; the component's own otherwise.
    method : str, optional
        How the table shall answer, such as ``griddata``; the component's own choice otherwise.
    derivatives : bool
        Whether the answer shall have du/dw, 6 x 6 a wrench: ``derivative``, ``derivatives``.
    beyond_range : bool
        Whether a wrench outside the component's load range may be solved. If not, ``queue`` answers
        it flagged and without a job, and ``wait`` and `solve` refuse it.
    """

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

        Parameters are those of `DisplacementCalls`; `detail`: ``raw["axes"]`` has each axis' rows.

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

        Parameters are those of `DisplacementCalls`, errors those of `displacement`; with
        ``wait`` one `wait_s` is for all.

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
        path, wait_s = component_path(name, "displacements"), _server_wait(chosen)
        if len(block) >= BINARY_FROM if binary is None else binary:
            tolerance_query = chosen.pop("tolerance", {})
            query, content = chosen | tolerance_query, block.astype("<f8").tobytes()
            reply = self.call("POST", path, content, kind=BINARY, query=query, wait_s=wait_s)
            return Displacements.read_binary(name, block, reply)
        body = {"wrenches": block.tolist()} | chosen
        return Displacements.read(name, block, self.call_json("POST", path, body, wait_s=wait_s))

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

        Parameters are those of `DisplacementCalls`.

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
        """Send the loads that `loads_body` returns."""
        path, body = component_path(name, call), loads | chosen
        reply = self.call_json("POST", path, body, wait_s=_server_wait(chosen))
        return Displacement.read(name, wrench_of(loads), reply, loads.get("loads"))


def _server_wait(chosen: Document) -> float:
    """Return how long the server may wait before it answers, s.

    With ``on_thin`` it waits only with ``wait``, 30 s if not given; `solve` gives the time.
    """
    if "on_thin" not in chosen:
        return chosen.get("wait_s", 0.0)
    return chosen.get("wait_s", 30.0) if chosen["on_thin"] == "wait" else 0.0
