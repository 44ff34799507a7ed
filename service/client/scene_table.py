"""A table cut to a scene, in the simulator's own process."""

from __future__ import annotations

import threading
from time import perf_counter_ns
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .connection import Connection
from .local import fetched_table, room
from .replies import COVERAGE, EXACT, ROUNDED, Displacement, Displacements, judged
from .scene import ComponentPlan, Scene
from .wrenches import many_wrenches, one_wrench, tolerance_body


class SceneTable:
    """The part of a component's table that a scene needs, as `Client.download` returns it.

    Wrenches that the scene has not are ``outside``; an output that it does not read is NaN. Any
    number of threads may use one.

    Raises
    ------
    ImportError
        If scipy is not installed.
    SceneError
        If the scene has no such component.
    ProblemError, ServerUnreachable, ServerTimeout
        See `Connection.call`.
    """

    def __init__(self, client: Connection, name: str, scene: Scene) -> None:
        room("scene.file")  # before anything is fetched for nothing
        self.name, self._client = name, client
        self._query = {"wanted": scene.query(name)}
        self._fetching = threading.Lock()
        fetched = self._fetch(None)
        assert fetched is not None
        self._take(*fetched)

    @property
    def version(self) -> int:
        """The table's version, the server's `table_version`."""
        return self._table.version

    @property
    def tolerance(self) -> dict[str, float] | None:
        """The scene's or the component's tolerance, ``translation`` in m, ``rotation`` in rad."""
        return self._table.plan.get("tolerance")

    @property
    def plan(self) -> ComponentPlan:
        """The plan that the table follows."""
        return ComponentPlan.read(self.name, self._table.plan)

    def answer(
        self,
        force: ArrayLike,
        moment: ArrayLike | None = None,
        tolerance: Any = None,
        method: str | None = None,
        derivatives: bool = False,
    ) -> Displacement:
        """Return the displacement under one wrench; parameters and errors are `Table.answer`'s."""
        wrench = one_wrench(force, moment)
        asked = tuple((wrench + 0.0).tolist())  # no negative zeros, as in the server
        table, limit = self._table, _tolerance(tolerance)
        started = perf_counter_ns()
        answer = table.answer(asked, limit, method)
        elapsed_us = (perf_counter_ns() - started) / 1e3
        derivative = None
        if derivatives:
            by_row = answer.method == "row"
            derivative = room("derivative").derivative_at(table, asked, method, by_row=by_row)
        answer = answer._replace(error=room("whole_bars").whole_bar(table, asked, answer, method))
        body = _reply(table, asked, answer) | {
            "elapsed_us": elapsed_us,
            "derivative": _known(derivative),
            "within_tolerance": room("answer").within_tolerance(answer.error, self._limit(limit)),
        }
        return Displacement.read(self.name, wrench, body)

    def batch(
        self,
        wrenches: ArrayLike,
        tolerance: Any = None,
        method: str | None = None,
        derivatives: bool = False,
    ) -> Displacements:
        """Return the displacements under many wrenches; see `Table.batch`."""
        block = many_wrenches(wrenches)
        table, limit, asked = self._table, _tolerance(tolerance), block + 0.0
        started = perf_counter_ns()
        found = table.batch(asked, limit, method)
        elapsed_us = (perf_counter_ns() - started) / 1e3
        errors = room("whole_bars").whole_bars(table, asked, found, limit, method)
        slopes = None
        if derivatives:
            slopes = room("derivative").derivatives_at(table, asked, limit, method)
        within = room("answer").within_tolerance_many(errors, self._limit(limit))
        return Displacements(
            component=self.name,
            wrenches=block,
            displacements=found.displacement,
            errors=errors,
            coverage=np.array(COVERAGE)[found.coverage],
            jobs={},
            no_job={},
            table_version=table.version,
            elapsed_us=elapsed_us,
            method=method or table.default,
            within_tolerance=judged(within),
            derivatives=slopes,
        )

    def refresh(self) -> bool:
        """Take the server's newest version of the table; see `Table.refresh`."""
        with self._fetching:
            fetched = self._fetch(self._etag)
            if fetched is not None:
                self._take(*fetched)
            return fetched is not None

    def error_parts(
        self, force: ArrayLike, moment: ArrayLike | None = None
    ) -> dict[str, np.ndarray | None]:
        """Return the solver's own share of the bars under one wrench; see `Table.error_parts`."""
        asked = one_wrench(force, moment).tolist()
        table = self._table
        shares = room("whole_bars").solver_parts(table, asked, table.answer(asked), None)
        return {name: share if share is None else np.array(share) for name, share in shares.items()}

    def close(self) -> None:
        """Close the idle connections to the server; a later `refresh` opens a new one."""
        self._client.close()

    def _limit(self, tolerance: Any) -> Any:
        """Return what whole bars must be within; None where the solver's share is not known."""
        own = self.tolerance
        limit = tolerance or (None if own is None else _tolerance(own))
        return limit if self._table.bars_are_whole else None

    def _fetch(self, etag: str | None) -> tuple[bytes, str | None] | None:
        return fetched_table(self._client, self.name, "scene", self._query, etag)

    def _take(self, content: bytes, etag: str | None) -> None:
        self._table = room("scene.file").read_scene(content)
        self._content, self._etag = content, etag

    def __getstate__(self) -> dict[str, Any]:
        """Return what is pickled: the file, not what is read from it."""
        left_out = ("_table", "_fetching")
        return {name: value for name, value in vars(self).items() if name not in left_out}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state, _fetching=threading.Lock())
        self._take(self._content, self._etag)


def _tolerance(tolerance: Any) -> Any:
    """Return a tolerance as the surrogate takes it; None for the scene's own."""
    if tolerance is None:
        return None
    return room("table.rows").Tolerance(**tolerance_body(tolerance))


def _reply(table: Any, asked: tuple[float, ...], answer: Any) -> dict[str, Any]:
    """Return the server's reply to ``estimate`` with an answer to a wrench (6,)."""
    moved, bars = answer.displacement, answer.error
    source, reason = "table" if moved else None, answer.reason
    if answer.method == "row":
        own = EXACT if table.has_row(asked) else ROUNDED
        source, reason = table.source_of(asked), f"{own} {reason}".rstrip()
    return {
        "translation": moved and moved[:3],
        "rotation": moved and moved[3:],
        "error": bars and {"translation": bars[:3], "rotation": bars[3:]},
        "coverage": answer.coverage,
        "source": source,
        "method": answer.method,
        "table_version": table.version,
        "reason": reason,
    }


def _known(derivative: Any) -> Any:
    """Return du/dw (6, 6), or None where none of it is known."""
    return None if derivative is None or np.isnan(derivative).all() else derivative
