"""Who answers a mount: a table in this process, the server's table, or a solve each time."""

from __future__ import annotations

import math
import time
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ...contract import OUTPUTS, OnThin
from ..errors import InvalidArgument, ServerTimeout
from ..replies import Displacement
from ..wrenches import tolerance_body
from .errors import DisplacementUnknown
from .options import require_server

Vector = NDArray[np.float64]
Tolerance = dict[str, float]

LONGEST_CALL_S = 20.0  # proxies end calls that take longer


class Source(Protocol):
    """What a mount asks.

    Attributes
    ----------
    tolerance : dict or None
        ``translation``, m, and ``rotation``, rad: the component's own.
    """

    tolerance: Tolerance | None

    def ask(self, wrench: Vector, *, derivatives: bool) -> Displacement:
        """Return the answer to a wrench, shape (6,), N and N·m."""
        ...


class TableSource:
    """A downloaded table: microseconds, no server."""

    def __init__(
        self, table: Any, component: str, tolerance: Tolerance | None, method: str | None
    ) -> None:
        name = getattr(table, "name", component)
        if name != component:
            raise InvalidArgument(f"the table is of component {name!r}, not of {component!r}")
        self._table, self._asked, self._method = table, tolerance, method
        if method is not None:  # an unknown one is refused here, not in the loop
            table.answer(np.zeros(6), tolerance=tolerance, method=method)
        own = getattr(table, "tolerance", None)
        self.tolerance = tolerance or (None if own is None else tolerance_body(own))

    def ask(self, wrench: Vector, *, derivatives: bool) -> Displacement:
        """Return the answer to a wrench, shape (6,), N and N·m."""
        return self._table.answer(
            wrench, tolerance=self._asked, method=self._method, derivatives=derivatives
        )


class ServerSource:
    """The server's table; what it does not cover is queued there, where it can be solved."""

    def __init__(
        self,
        client: Any,
        component: str,
        tolerance: Tolerance | None,
        method: str | None,
        on_thin: OnThin,
    ) -> None:
        facts = client.component(component)
        # A measured table is never solved: to queue would be refused in the middle of the loop.
        self._on_thin: OnThin = on_thin if facts.get("has_fea", True) else "estimate"
        self._client, self._component = client, component
        self._asked, self._method = tolerance, method
        self.tolerance = tolerance or facts.get("tolerance")
        if method is not None:  # an unknown one is refused here, not in the loop
            client.displacement(component, np.zeros(6), on_thin="estimate", method=method)

    def ask(self, wrench: Vector, *, derivatives: bool) -> Displacement:
        """Return the answer to a wrench, shape (6,), N and N·m."""
        return self._client.displacement(
            self._component,
            wrench,
            on_thin=self._on_thin,
            tolerance=self._asked,
            method=self._method,
            derivatives=derivatives,
        )


class SolveSource:
    """DirectFEA: each wrench is solved, and waited for."""

    def __init__(
        self,
        client: Any,
        component: str,
        tolerance: Tolerance | None,
        timeout: float,
        beyond_range: bool,
    ) -> None:
        self._client, self._component = client, component
        self._timeout, self._beyond = timeout, beyond_range
        self.tolerance = tolerance or client.component(component).get("tolerance")

    def ask(self, wrench: Vector, *, derivatives: bool) -> Displacement:
        """Return the answer to a wrench, shape (6,), N and N·m.

        Raises
        ------
        ProblemError
            If the solve failed (424), or the wrench is beyond the load range (409).
        ServerTimeout
            If it has not ended in time; it goes on in the server.
        """
        deadline = time.monotonic() + self._timeout
        while True:
            left = max(deadline - time.monotonic(), 0.0)
            answer = self._client.solve(
                self._component,
                wrench,
                wait_s=min(left, LONGEST_CALL_S),
                beyond_range=self._beyond,
            )
            if answer.covered:
                break
            if left == 0.0:
                job = f"job {answer.job.id}" if answer.job else "its solve"
                raise ServerTimeout(
                    f"{job} of {self._component} has not ended within {self._timeout:g} s; it goes "
                    "on in the server: step again, or make the mount with a longer solve_timeout"
                )
        return self._with_derivative(answer, wrench) if derivatives else answer

    def _with_derivative(self, solved: Displacement, wrench: Vector) -> Displacement:
        """Return the answer of the solve's row, which brings its tangent with it."""
        from_row = self._client.displacement(
            self._component, wrench, on_thin="estimate", derivatives=True
        )
        return from_row if from_row.covered else solved


def table_source(
    source: Any, component: str, tolerance: Tolerance | None, method: str | None, on_thin: OnThin
) -> Source:
    """Return who answers from a table: the one given, or the server with its own."""
    if hasattr(source, "answer"):
        return TableSource(source, component, tolerance, method)
    server = require_server(source, "table")
    return ServerSource(server, component, tolerance, method, on_thin)


def known(answer: Displacement, unmeasured: str) -> Vector | None:
    """Return an answer as numbers only, shape (6,), m and rad; None if there is none at all.

    Parameters
    ----------
    answer : Displacement
    unmeasured : {"refuse", "rigid"}
        What an output that the table does not hold does: raise, or not move.

    Raises
    ------
    DisplacementUnknown
        If an output is not in the table.
    """
    vector = answer.vector
    if vector is None:
        return None
    if not math.isnan(float(vector.sum())):
        return vector
    missing = np.isnan(vector)
    if unmeasured == "rigid":
        return np.where(missing, 0.0, vector)
    names = ", ".join(np.array(OUTPUTS)[missing])
    raise DisplacementUnknown(
        f"the table of {answer.component} does not say {names} under this wrench, and a pose needs "
        "all six: load a table that has them, name them among the scene's outputs if it was cut to "
        "one, or make the mount with unmeasured='rigid', which takes 0 for them"
    )
