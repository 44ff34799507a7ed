"""A component's table in the simulator's own process: the server's answers, without the server."""

from __future__ import annotations

import threading
from time import perf_counter_ns
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .connection import Connection
from .local import Built, build, build_scene, require_room, room
from .questions import component_path
from .replies import COVERAGE, EXACT, ROUNDED, Displacement, Displacements, judged
from .scene import ComponentPlan, Scene
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
    scene : Scene, optional
        What a simulation needs of it: only that is fetched and kept. Wrenches that the scene has
        not are ``outside``; an output that it does not read is NaN.

    Attributes
    ----------
    plan : ComponentPlan or None
        The plan that a scene's table follows.

    Raises
    ------
    ImportError
        If scipy or h5py is not installed.
    SceneError
        If the scene has no such component.
    ProblemError
        If there is no such component (404).
    ServerUnreachable, ServerTimeout
        See `Connection.call`.
    """

    def __init__(self, client: Connection, name: str, scene: Scene | None = None) -> None:
        require_room()  # before anything is fetched for nothing
        self.name, self._wanted = name, None if scene is None else scene.query(name)
        self._client = client
        self._fetching = threading.Lock()
        fetched = self._fetch(None)
        assert fetched is not None
        self._built = fetched

    @property
    def version(self) -> int:
        """The table's version, the server's `table_version`."""
        return self._built.surrogate.version

    @property
    def tolerance(self) -> Any:
        """The component's own tolerance, ``translation`` in m and ``rotation`` in rad, or None."""
        surrogate = self._built.surrogate
        if self._wanted is None:
            return surrogate.tolerance
        told = surrogate.plan.get("tolerance")  # a scene's table is made by its plan
        return None if told is None else _tolerance(told)

    def _judging(self, asked: Any) -> Any:
        """Return what whole bars are held against; None where the solver's share is not known."""
        return (asked or self.tolerance) if self._built.surrogate.bars_are_whole else None

    @property
    def plan(self) -> ComponentPlan | None:
        """The plan that a scene's table follows; None of a whole table."""
        if self._wanted is None:
            return None
        return ComponentPlan.read(self.name, self._built.surrogate.plan)

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
        if derivatives:
            tell, by_row = room("derivative").derivative_at, answer.method == "row"
            derivative = tell(surrogate, asked, method, by_row=by_row)
        whole = room("whole_bars").whole_bar(surrogate, asked, answer, method)
        answer = answer._replace(error=whole)
        body = _reply(surrogate, asked, answer)
        held = room("answer").within_tolerance(answer.error, self._judging(limit))
        body |= {
            "elapsed_us": elapsed_us,
            "derivative": _known(derivative),
            "within_tolerance": held,
        }
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
        errors = room("whole_bars").whole_bars(surrogate, asked, found, limit, method)
        told = None
        if derivatives:
            told = room("derivative").derivatives_at(surrogate, asked, limit, method)
        held = room("answer").within_tolerance_many(errors, self._judging(limit))
        return Displacements(
            component=self.name,
            wrenches=block,
            displacements=found.displacement,
            errors=errors,
            coverage=np.array(COVERAGE)[found.coverage],
            jobs={},
            no_job={},
            table_version=surrogate.version,
            elapsed_us=elapsed_us,
            method=method or surrogate.default,
            within_tolerance=judged(held),
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

    def error_parts(
        self, force: ArrayLike, moment: ArrayLike | None = None
    ) -> dict[str, np.ndarray | None]:
        """Return the solver's own share of the bars under one wrench, N and N·m, by cause.

        Returns
        -------
        dict
            ``mesh`` and of a linear component ``linearity``: shape (6,), m and rad, None where it
            is not known. The rest of a bar is the table's. Empty of a table that nothing has told
            of, a measured one say.
        """
        asked = one_wrench(force, moment).tolist()
        table = self._built.surrogate
        told = room("whole_bars").solver_parts(table, asked, table.answer(asked), None)
        return {cause: share if share is None else np.array(share) for cause, share in told.items()}

    def close(self) -> None:
        """Close the idle connections to the server; a later `refresh` opens a new one."""
        self._client.close()

    def _fetch(self, etag: str | None) -> Built | None:
        """Return the server's version of the table, or None if it is the one of this name."""
        call, query = "table", {"format": "hdf5"}
        if self._wanted is not None:
            call, query = "scene", {"wanted": self._wanted}
        reply = self._client.call(
            "GET",
            component_path(self.name, call),
            query=query,
            headers={"If-None-Match": etag} if etag else None,
        )
        tag = reply.headers.get("ETag")
        # Some proxies answer from a cache of theirs with 200 where nothing is new.
        if reply.status == 304 or (etag is not None and tag == etag):
            return None
        return self._made(reply.content, tag)

    def _made(self, content: bytes, etag: str | None) -> Built:
        """Return what answers from a file of the server's."""
        if self._wanted is None:
            return build(content, etag)
        return build_scene(content, etag, self.name)

    def __getstate__(self) -> dict[str, Any]:
        """Return what is pickled: the file, not what is built from it."""
        built = self._built
        return {
            "name": self.name,
            "client": self._client,
            "wanted": self._wanted,
            "content": built.content,
            "etag": built.etag,
        }

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.name, self._client = state["name"], state["client"]
        self._wanted = state["wanted"]
        self._fetching = threading.Lock()
        self._built = self._made(state["content"], state["etag"])


class Downloads(Connection):
    """Carry a component's table into this process."""

    def download(self, name: str, scene: Scene | None = None) -> Table:
        """Return a component's table, which answers in this process.

        Parameters
        ----------
        name : str
            The component.
        scene : Scene, optional
            What a simulation needs of it: the same answers to its wrenches, from less.

        Raises
        ------
        ImportError
            If scipy or h5py is not installed: ``pip install 'wrenchbook[local]'``.
        ProblemError
            If there is no such component (404), or the scene goes beyond its load range (422).
        SceneError
            If the scene has no such component.
        """
        return Table(self, name, scene)


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
        own = EXACT if surrogate.has_row(asked) else ROUNDED
        source, reason = surrogate.source_of(asked), f"{own} {reason}".rstrip()
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
