"""A component's table in the simulator's own process: the server's answers, without the server."""

from __future__ import annotations

import threading
from time import perf_counter_ns
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .connection import Connection
from .local import Built, build, require_room, room
from .questions import component_path
from .replies import COVERAGE, EXACT, Displacement, Displacements
from .wrenches import many_wrenches, one_wrench, tolerance_body


class Table:
    """One component's table and the surrogate built from it, as `Client.download` returns it.

    It answers in microseconds what the server would, to the last digit where the same versions of
    numpy, scipy and numba are installed, and asks the server only in `refresh`. Any number of
    threads may use one. A pickle holds the table's rows, and is built again where it is loaded.

    Parameters
    ----------
    client : Connection
        Where the table is fetched.
    name : str
        The component.

    Raises
    ------
    ImportError
        If scipy or h5py is not installed.
    ProblemError
        If there is no such component (404).
    ServerUnreachable, ServerTimeout
        See `Connection.call`.
    """

    def __init__(self, client: Connection, name: str) -> None:
        require_room()  # before anything is fetched for nothing
        self.name = name
        self._client = client
        self._fetching = threading.Lock()
        fetched = self._fetch(None)
        assert fetched is not None
        self._built = fetched

    @property
    def version(self) -> int:
        """The table's version, the server's `table_version`."""
        return self._built.surrogate.version

    def answer(
        self,
        force: ArrayLike,
        moment: ArrayLike | None = None,
        tolerance: Any = None,
        method: str | None = None,
        derivatives: bool = False,
    ) -> Displacement:
        """Return the displacement of the component's interface under one wrench, N and N·m.

        Parameters are those of `Client.displacement`, shapes (3,) and (3,) or (6,) and none. It
        answers as the server does with ``estimate``: flagged where it is not covered, without job.

        Returns
        -------
        Displacement
            Shapes (3,), m and rad; with `derivatives` also `Displacement.derivative`.

        Raises
        ------
        ValueError
            If a number is not finite, a shape is wrong, or there is no such method.
        """
        wrench = one_wrench(force, moment)
        asked = tuple((wrench + 0.0).tolist())  # no negative zeros, as in the server
        surrogate, limit = self._built.surrogate, _tolerance(tolerance)
        started = perf_counter_ns()
        answer = surrogate.answer(asked, limit, method)
        elapsed_us = (perf_counter_ns() - started) / 1e3
        derivative = None
        if derivatives and answer.displacement:
            tell, by_row = room("derivative").derivative_at, answer.method == "row"
            derivative = tell(surrogate, asked, method, by_row=by_row)
        body = _reply(surrogate, asked, answer)
        body |= {"elapsed_us": elapsed_us, "derivative": _known(derivative)}
        return Displacement.read(self.name, wrench, body)

    def batch(
        self,
        wrenches: ArrayLike,
        tolerance: Any = None,
        method: str | None = None,
        derivatives: bool = False,
    ) -> Displacements:
        """Return the displacements under many wrenches, shape (n, 6), N and N·m.

        Parameters and errors are those of `answer`.

        Returns
        -------
        Displacements
            Shapes (n, 6), m and rad; with `derivatives` also `Displacements.derivatives`.
        """
        block = many_wrenches(wrenches)
        surrogate, limit, asked = self._built.surrogate, _tolerance(tolerance), block + 0.0
        started = perf_counter_ns()
        found = surrogate.batch(asked, limit, method)
        elapsed_us = (perf_counter_ns() - started) / 1e3
        told = None
        if derivatives:
            told = room("derivative").derivatives_at(surrogate, asked, limit, method)
        return Displacements(
            component=self.name,
            wrenches=block,
            displacements=found.displacement,
            errors=found.error,
            coverage=np.array(COVERAGE)[found.coverage],
            jobs={},
            no_job={},
            table_version=surrogate.version,
            elapsed_us=elapsed_us,
            method=method or surrogate.default,
            derivatives=told,
        )

    def refresh(self) -> bool:
        """Take the server's newest version of the table; return whether there was a new one.

        Answers given meanwhile are those of the version before.

        Raises
        ------
        ProblemError, ServerUnreachable, ServerTimeout
            As in `Connection.call`; the table is then as it was.
        """
        with self._fetching:
            fetched = self._fetch(self._built.etag)
            if fetched is not None:
                self._built = fetched
            return fetched is not None

    def close(self) -> None:
        """Close the idle connections to the server; a later `refresh` opens a new one."""
        self._client.close()

    def _fetch(self, etag: str | None) -> Built | None:
        """Return the server's version of the table, or None if it is the one of this name."""
        reply = self._client.call(
            "GET",
            component_path(self.name, "table"),
            query={"format": "hdf5"},
            headers={"If-None-Match": etag} if etag else None,
        )
        tag = reply.headers.get("ETag")
        # Some proxies answer from a cache of theirs with 200 where nothing is new.
        if reply.status == 304 or (etag is not None and tag == etag):
            return None
        return build(reply.content, tag)

    def __getstate__(self) -> dict[str, Any]:
        """Return what is pickled: the file, not what is built from it."""
        built = self._built
        return {
            "name": self.name,
            "client": self._client,
            "content": built.content,
            "etag": built.etag,
        }

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.name, self._client = state["name"], state["client"]
        self._fetching = threading.Lock()
        self._built = build(state["content"], state["etag"])


class Downloads(Connection):
    """Carry a component's table into this process."""

    def download(self, name: str) -> Table:
        """Return a component's table, which answers in this process.

        Parameters
        ----------
        name : str
            The component.

        Raises
        ------
        ImportError
            If scipy or h5py is not installed: ``pip install 'wrenchbook[local]'``.
        ProblemError
            If there is no such component (404).
        """
        return Table(self, name)


def _tolerance(tolerance: Any) -> Any:
    """Return a tolerance as the surrogate takes it; None for the component's own."""
    if tolerance is None:
        return None
    return room("table.rows").Tolerance(**tolerance_body(tolerance))


def _reply(surrogate: Any, asked: tuple[float, ...], answer: Any) -> dict[str, Any]:
    """Return what the server's reply to ``estimate`` says, of an answer to a wrench (6,)."""
    moved, bars = answer.displacement, answer.error
    source, reason = "table" if moved else None, answer.reason
    if answer.method == "row":
        source, reason = surrogate.source_of(asked), f"{EXACT} {reason}".rstrip()
    return {
        "translation": moved and moved[:3],
        "rotation": moved and moved[3:],
        "error": bars and {"translation": bars[:3], "rotation": bars[3:]},
        "coverage": answer.coverage,
        "source": source,
        "method": answer.method,
        "table_version": surrogate.version,
        "reason": reason,
    }


def _known(derivative: Any) -> Any:
    """Return du/dw (6, 6), or None where none of it is known."""
    return None if derivative is None or np.isnan(derivative).all() else derivative
