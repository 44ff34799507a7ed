"""Sources of a mount's answers: a downloaded table, a server's table, a solve of each wrench."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING, cast

import numpy as np

from wrenchbook.surrogate.table.space import DEFAULT

from ..errors import InvalidArgument, ServerTimeout, SourceError
from ..job import LONGEST_POLL_S, SHORTEST_POLL_S
from ..replies import Displacement
from ..wrenches import OnThin, Vector, tolerance_body

if TYPE_CHECKING:
    from .. import Client, Table

Limit = dict[str, float]
Ask = Callable[[Vector, bool], Displacement]


def from_table(
    table: Table, component: str, tolerance: Limit | None, method: str | None
) -> tuple[Limit | None, Ask]:
    """Answer from a downloaded table: in microseconds, without a server."""
    name = getattr(table, "name", component)
    if name != component:
        raise InvalidArgument(f"the table belongs to {name!r}; pass the table of {component!r}")
    space = getattr(table, "space", DEFAULT)
    if space.several or len(space.inputs) != len(DEFAULT.inputs):
        raise InvalidArgument(
            f"a mount takes components with one interface and no further inputs, but {component} "
            f"has the inputs {', '.join(space.input_names)}; call table.answer in the loop instead"
        )
    if method is not None:  # an unknown method is refused here, not in the loop
        table.answer(np.zeros(6), tolerance=tolerance, method=method)

    def ask(wrench: Vector, derivatives: bool) -> Displacement:
        return table.answer(wrench, tolerance=tolerance, method=method, derivatives=derivatives)

    default = getattr(table, "tolerance", None)
    return tolerance or (None if default is None else tolerance_body(default)), ask


def from_server(
    client: Client, component: str, tolerance: Limit | None, method: str | None, on_thin: OnThin
) -> tuple[Limit | None, Ask]:
    """Answer from the server's table; uncovered wrenches are queued, if they can be solved."""
    facts = client.component(component)
    # A measured table is never solved: a queued wrench would be refused in the middle of the loop.
    thin: OnThin = on_thin if facts.get("has_fea", True) else "estimate"
    if method is not None:  # an unknown method is refused here, not in the loop
        client.displacement(component, np.zeros(6), on_thin="estimate", method=method)

    def ask(wrench: Vector, derivatives: bool) -> Displacement:
        return client.displacement(
            component,
            wrench,
            on_thin=thin,
            tolerance=tolerance,
            method=method,
            derivatives=derivatives,
        )

    return tolerance or facts.get("tolerance"), ask


def from_solves(
    client: Client, component: str, tolerance: Limit | None, timeout: float, beyond_range: bool
) -> tuple[Limit | None, Ask]:
    """Solve each wrench, and wait for it at most `timeout` seconds (DirectFEA)."""

    def ask(wrench: Vector, derivatives: bool) -> Displacement:
        deadline = time.monotonic() + timeout
        while True:
            began = time.monotonic()
            remaining = max(deadline - began, 0.0)
            answer = client.solve(
                component, wrench, wait_s=min(remaining, LONGEST_POLL_S), beyond_range=beyond_range
            )
            if answer.covered:
                break
            if remaining == 0.0:
                job = f"job {answer.job.id}" if answer.job else "its solve"
                raise ServerTimeout(
                    f"{job} of {component} has not ended within {timeout:g} s and continues on the "
                    "server; step again, or create the mount with a longer solve_timeout"
                )
            if time.monotonic() - began < SHORTEST_POLL_S:
                time.sleep(SHORTEST_POLL_S)
        if not derivatives:
            return answer
        # The row of the solve brings its tangent.
        row = client.displacement(component, wrench, on_thin="estimate", derivatives=True)
        return row if row.covered else answer

    return tolerance or client.component(component).get("tolerance"), ask


def require_server(source: Table | Client, mode: str) -> Client:
    """Return a source that is a server's client; raises SourceError if it is none."""
    if hasattr(source, "__aenter__"):
        raise SourceError("a mount's steps block; pass a Client instead of the AsyncClient")
    if hasattr(source, "displacement") and hasattr(source, "solve"):
        return cast("Client", source)
    sources = "a Client" if mode != "table" else "a Client, or a Table from client.download(...)"
    raise SourceError(f"mode {mode!r} needs {sources} as source, not {type(source).__name__}")
