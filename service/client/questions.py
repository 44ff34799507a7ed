"""The calls that a simulator makes in its loop."""

from __future__ import annotations

from typing import Any
from urllib.parse import quote

from numpy.typing import ArrayLike

from .connection import Connection
from .replies import Displacement, Displacements
from .wrenches import Vector, many_wrenches, one_wrench, options

BINARY_FROM = 1000  # wrenches from which a batch goes as float64 unless told


def component_path(name: str, call: str = "") -> str:
    """Return the path of a component's call, or of the component itself."""
    return f"/v1/components/{quote(name, safe='')}" + (f"/{call}" if call else "")


class Questions(Connection):
    """Ask for displacements."""

    def displacement(
        self,
        name: str,
        force: ArrayLike,
        moment: ArrayLike | None = None,
        *,
        on_thin: str = "queue",
        wait_s: float | None = None,
        tolerance: Any = None,
        method: str | None = None,
        detail: bool = False,
    ) -> Displacement:
        """Return the displacement of a component's interface under one wrench.

        Parameters
        ----------
        name : str
            The component.
        force : array_like
            Shape (3,), N, acting ON the component, in the undeformed interface frame; or the whole
            wrench, shape (6,).
        moment : array_like, optional
            Shape (3,), N·m, about the interface point.
        on_thin : {"queue", "wait", "estimate", "reject"}
            Where the table is too thin: queue a solve and answer with the best guess; wait for that
            solve; only guess; refuse.
        wait_s : float, optional
            With ``wait``: seconds to wait for the solve; the server's default is 30.
        tolerance : mapping or pair, optional
            ``{"translation": m, "rotation": rad}``; the component's own otherwise.
        method : str, optional
            ``griddata``, ``tangent``, ``rbf``, ``corrected``, ``auto``, ``linear`` or ``nearest``;
            the component's own choice otherwise.
        detail : bool
            Whether ``raw["axes"]`` shall say which rows each axis used.

        Returns
        -------
        Displacement
            m and rad; with `Displacement.job` while a solve is queued or running.

        Raises
        ------
        ValueError
            If a number is not finite or a shape is wrong; nothing was sent.
        ProblemError
            If there is no such component (404), with ``reject`` if it is not covered (409), if the
            solve of this wrench failed (424).
        ServerUnreachable, ServerTimeout
            See `Connection.call`.
        """
        wrench = one_wrench(force, moment)
        body = {"force": wrench[:3].tolist(), "moment": wrench[3:].tolist()}
        body |= options(
            on_thin=on_thin,
            wait_s=wait_s,
            tolerance=tolerance,
            method=method,
            detail=detail or None,
        )
        reply = self.call_json(
            "POST",
            component_path(name, "displacement"),
            body,
            wait_s=_held(on_thin, wait_s),
        )
        return Displacement.read(name, wrench, reply)

    def displacements(
        self,
        name: str,
        wrenches: ArrayLike,
        *,
        on_thin: str = "queue",
        wait_s: float | None = None,
        tolerance: Any = None,
        method: str | None = None,
        binary: bool | None = None,
    ) -> Displacements:
        """Return the displacements under many wrenches, shape (n, 6), in one call.

        Parameters and errors are those of `displacement`; with ``wait`` one `wait_s` is for all.

        Parameters
        ----------
        binary : bool, optional
            Whether to send and receive float64 instead of JSON, some twenty times as fast; from
            1000 wrenches on if not given. The answers then do not list the jobs they queued.
        """
        block = many_wrenches(wrenches)
        if len(block) >= BINARY_FROM if binary is None else binary:
            return self._binary(
                name, block, on_thin=on_thin, wait_s=wait_s, tolerance=tolerance, method=method
            )
        body = {"wrenches": block.tolist()}
        body |= options(on_thin=on_thin, wait_s=wait_s, tolerance=tolerance, method=method)
        reply = self.call_json(
            "POST",
            component_path(name, "displacements"),
            body,
            wait_s=_held(on_thin, wait_s),
        )
        return Displacements.read(name, block, reply)

    def _binary(self, name: str, block: Vector, **given: Any) -> Displacements:
        """Ask a batch in its binary form."""
        query = options(**given)
        query |= query.pop("tolerance", {})
        reply = self.call(
            "POST",
            component_path(name, "displacements"),
            block.astype("<f8").tobytes(),
            kind="application/octet-stream",
            query=query,
            wait_s=_held(given["on_thin"], given["wait_s"]),
        )
        return Displacements.read_binary(name, block, reply)

    def solve(
        self,
        name: str,
        force: ArrayLike,
        moment: ArrayLike | None = None,
        *,
        wait_s: float | None = None,
    ) -> Displacement:
        """Solve one wrench with finite elements, whatever the table says.

        Parameters
        ----------
        name, force, moment
            As in `displacement`.
        wait_s : float, optional
            Seconds to wait for the solve; at once back with the job if not given.

        Returns
        -------
        Displacement
            With ``source`` ``fea`` when the solve is done, else with its `Displacement.job`.

        Raises
        ------
        ValueError, ProblemError, ServerUnreachable, ServerTimeout
            As in `displacement`.
        """
        wrench = one_wrench(force, moment)
        body = {"force": wrench[:3].tolist(), "moment": wrench[3:].tolist()}
        body |= options(wait_s=wait_s)
        reply = self.call_json("POST", component_path(name, "solve"), body, wait_s=wait_s)
        return Displacement.read(name, wrench, reply)


def _held(on_thin: str, wait_s: float | None) -> float:
    """Return how long the server may hold the answer back, s: 30 unless told."""
    if on_thin != "wait":
        return 0.0
    return 30.0 if wait_s is None else wait_s
