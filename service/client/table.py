"""A component's table in the simulator's own process: the server's answers, without the server."""

from __future__ import annotations

import importlib
import itertools
import os
import threading
from collections.abc import Iterator, Mapping
from pathlib import Path
from time import perf_counter_ns
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..contract import COVERAGE, LOADS
from .errors import InvalidArgument, TableError
from .notebook import html_table, named_columns, require_pandas
from .replies import (
    EXACT,
    ROUNDED,
    Displacement,
    Displacements,
    Vector,
    bars_within,
)
from .request import BlockingRunner, Call, Request, component_path, sync_and_async
from .scene import ComponentPlan, Scene
from .transport import Transport
from .wrenches import loads_body, many_wrenches, one_wrench, tolerance_body, wrench_of


class Table:
    """One version of a component's table; `Client.download` and `Table.open` return one.

    A table of a scene answers by the component's default method alone. Wrenches that cannot occur
    in the scene are ``outside``; an output that the scene does not read is NaN.

    It is the server's packed table, answered by the same compiled code: the numbers are those of
    the server to the last bit, in microseconds. Only `refresh` calls the server. Any number of
    threads may use one. A pickle holds the table's bytes, of an opened file its path.

    Parameters
    ----------
    packed : PackedTable
        The table, of `surrogate.kernel.binding`.
    name : str, optional
        The component; the one that the table names if not given.
    client : Client, optional
        Where `refresh` gets newer versions.
    etag : str, optional
        The server's name of this version.
    scene : Scene, optional
        The scene whose wrenches it answers.
    """

    def __init__(
        self,
        packed: Any,
        name: str | None = None,
        client: BlockingRunner | None = None,
        etag: str | None = None,
        scene: Scene | None = None,
    ) -> None:
        self._now: tuple[Any, str | None] = packed, etag  # replaced as one: threads read it
        self.name = name or packed.words["provenance"]["component"]
        self._call, self._query = _call(self.name, scene)
        self._client = client
        self._fetching = threading.Lock()

    @classmethod
    def open(cls, path: str | os.PathLike[str]) -> Self:
        """Return the table in a ``.wbt`` file, which is mapped; no server is needed.

        Raises
        ------
        TableError
            If it cannot be opened, is no packed table, is damaged, or has another format; a
            ValueError.
        """
        return cls(_opened("open", path))

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the table to a file that `open` opens; it is complete or not there.

        Raises
        ------
        OSError
            If it cannot be written.
        """
        _surrogate("packed.format").write_file(Path(path), [self.packed.content])

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return read-only views of the table's arrays by name; none is copied.

        ``space/range`` (2, n) has the range of the n inputs, SI; ``gK/row/wrench`` (r, n) and
        ``gK/row/moved`` (r, m), m and rad, the rows of the K-th group of outputs. The names,
        shapes and units of all are in surrogate/packed/writer.py.
        """
        return dict(self.packed.arrays)

    @property
    def version(self) -> int:
        """The table's version, the server's `table_version`."""
        return self.packed.words["provenance"]["version"]

    @property
    def method(self) -> str:
        """The method that answers if none is given."""
        return self.packed.words["summary"]["method"]

    @property
    def space(self) -> Any:
        """Its inputs and outputs, a `surrogate.table.space.Space`: names, units, interfaces."""
        return self.packed.space

    @property
    def tolerance(self) -> dict[str, float] | None:
        """The component's own tolerance, ``translation`` in m and ``rotation`` in rad, or None."""
        return _tolerance_of(self.packed)

    @property
    def plan(self) -> ComponentPlan | None:
        """The scene plan that a scene's table follows; None of a whole table."""
        scene = self.packed.words.get("scene")
        return (
            None if scene is None else ComponentPlan.read({**scene["plan"], "component": self.name})
        )

    def answer(
        self,
        force: ArrayLike | None = None,
        moment: ArrayLike | None = None,
        tolerance: Any = None,
        method: str | None = None,
        derivatives: bool = False,
        *,
        loads: Mapping[str, Any] | None = None,
        inputs: Mapping[str, float] | None = None,
    ) -> Displacement:
        """Return the displacement of the component's interface under one wrench, N and N·m.

        Parameters are those of `Client.displacement`, shapes (3,) and (3,) or (6,) and none. It
        answers as the server does with ``estimate``: flagged where it is not covered, without job.
        With several interfaces `Displacement.interfaces` has one each.

        Returns
        -------
        Displacement
            Shapes (3,), m and rad; with `derivatives` also `Displacement.derivative`.

        Raises
        ------
        ValueError
            If a number is not finite, a shape is wrong, an interface or an input is unknown or
            missing, or there is no such method.
        """
        values, wrench, by_name = self._values(force, moment, loads, inputs)
        packed, limit = self.packed, self._allowed(tolerance)
        started = perf_counter_ns()
        try:
            found = packed.answer(values, limit, method)
            elapsed_us = (perf_counter_ns() - started) / 1e3
            slope = packed.derivative(values, limit, method) if derivatives else None
        except ValueError as error:
            raise InvalidArgument(str(error)) from error
        reply = _reply(packed, found)
        reply["elapsed_us"] = elapsed_us
        if slope is not None:
            reply["derivative"] = None if np.isnan(slope).all() else slope
        return Displacement.read(self.name, wrench, reply, by_name)

    def _values(
        self,
        force: ArrayLike | None,
        moment: ArrayLike | None,
        loads: Mapping[str, Any] | None,
        inputs: Mapping[str, float] | None,
    ) -> tuple[list[float], Vector, dict[str, Any] | None]:
        """Return the table's inputs, shape (n,), SI, and the wrench, or the wire's loads by name.

        Negative zeros become zeros, as the server reads them.
        """
        if force is not None and loads is None and inputs is None and self.packed.inputs == _WHOLE:
            wrench = one_wrench(force, moment)
            return (wrench + 0.0).tolist(), wrench, None
        body, space = loads_body(force, moment, loads, inputs), self.space
        if "force" in body and space.several:
            names = ", ".join(space.several)
            raise InvalidArgument(f"{self.name} has the interfaces {names}: give loads by name")
        wrenches = {"": body} if "force" in body else body.get("loads", {})
        six = {name: wrench_of(one).tolist() for name, one in wrenches.items()}
        try:
            values = space.vector(six, body.get("inputs", {}))
        except ValueError as error:
            raise InvalidArgument(f"{self.name}: {error}") from None
        return [value + 0.0 for value in values], wrench_of(body), body.get("loads")

    def _allowed(self, tolerance: Any) -> tuple[float, ...] | None:
        """Return the largest error of each output, shape (m,), m and rad; None for its own."""
        if tolerance is None:
            return None
        pair = tolerance_body(tolerance)
        kinds = (pair["translation"],) * 3 + (pair["rotation"],) * 3
        return kinds * (self.packed.outputs // _WHOLE)

    def batch(
        self,
        wrenches: ArrayLike,
        tolerance: Any = None,
        method: str | None = None,
        derivatives: bool = False,
    ) -> Displacements:
        """Return the displacements under many wrenches, shape (n, inputs), SI.

        Parameters and errors are those of `answer`; the order of the inputs is that of `space`.

        Returns
        -------
        Displacements
            Shapes (n, outputs), m and rad; with `derivatives` also `Displacements.derivatives`.
        """
        packed, limit = self.packed, self._allowed(tolerance)
        block = many_wrenches(wrenches, packed.inputs)
        loads = block + 0.0  # no negative zeros, as the server reads them
        started = perf_counter_ns()
        try:
            found = packed.batch(loads, limit, method)
            elapsed_us = (perf_counter_ns() - started) / 1e3
            slopes = packed.derivatives(loads, limit, method) if derivatives else None
        except ValueError as error:
            raise InvalidArgument(str(error)) from error
        # Errors without the solver's share cannot be compared with a tolerance.
        whole = packed.arrays["solver/flags"][_ALL_PARTS]
        allowed = (limit or self._allowed(_tolerance_of(packed))) if whole else None
        return Displacements(
            component=self.name,
            wrenches=block,
            displacements=found.outputs,
            errors=found.errors,
            coverage=np.array(COVERAGE)[found.coverage],
            jobs={},
            no_job={},
            table_version=packed.words["provenance"]["version"],
            elapsed_us=elapsed_us,
            method=packed.answers_by(method),
            within_tolerance=None if allowed is None else bars_within(found.errors, allowed),
            derivatives=slopes,
        )

    def stiffness(
        self,
        force: ArrayLike | None = None,
        moment: ArrayLike | None = None,
        *,
        loads: Mapping[str, Any] | None = None,
        inputs: Mapping[str, float] | None = None,
    ) -> Vector:
        """Return dw/du under one wrench, shape (6, 6): N/m, N/rad, N·m/m, N·m/rad, a line a load.

        It is the inverse of the derivative that `answer` gives, by the loads alone where there are
        further inputs, shape (m, m) of m outputs; parameters are `answer`'s.

        Raises
        ------
        ValueError
            If the derivative is not known here, or has no inverse: a component with locked
            freedoms, or an interface that is held, has none.
        """
        values = self._values(force, moment, loads, inputs)[0]
        try:
            slope = self.packed.derivative(values)[:, : self.packed.outputs]
        except ValueError as error:
            raise InvalidArgument(str(error)) from error
        if np.isnan(slope).any():
            raise InvalidArgument(f"the derivative of {self.name} under this wrench is not known")
        try:
            return np.linalg.inv(slope)
        except np.linalg.LinAlgError:
            raise InvalidArgument(
                f"the derivative of {self.name} under this wrench has no inverse: a load moves "
                "nothing, as on a locked freedom"
            ) from None

    def error_parts(
        self,
        force: ArrayLike | None = None,
        moment: ArrayLike | None = None,
        *,
        loads: Mapping[str, Any] | None = None,
        inputs: Mapping[str, float] | None = None,
    ) -> dict[str, np.ndarray | None]:
        """Return the parts of the error bars under one wrench, N and N·m, that rows do not lower.

        Returns
        -------
        dict
            ``mesh``, of a linear component ``linearity`` and of measured rows with hysteresis or
            drift ``measurement``: shape (m,), m and rad, None where it is not known. The rest of a
            bar is the table's. Empty where there is no such part.
        """
        packed = self.packed
        error = packed.words["solver_error"] or {}
        found = packed.answer(self._values(force, moment, loads, inputs)[0])
        parts = {"mesh": found.discretisation} if error else {}
        if "linearity" in error:
            parts["linearity"] = found.linearity
        if any(found.measurement or ()):
            parts["measurement"] = found.measurement
        return {
            cause: None if part is None else np.array(part, dtype=float)
            for cause, part in parts.items()
        }

    def refresh(self) -> bool:
        """Take the server's newest version of the table; return whether there was a new one.

        Answers given meanwhile are those of the version before.

        Raises
        ------
        ValueError
            If the table was opened from a file.
        ProblemError, ServerUnreachable, ServerTimeout
            As in `Client.call`; the table is then as it was.
        """
        if self._client is None:
            raise InvalidArgument(
                f"{self!r} is of a file: download the newest version from a server"
            )
        with self._fetching:
            fetch = _fetch(self.name, self._call, self._query, self._now[1])
            fetched = self._client.run(fetch)
            if fetched is None:
                return False
            content, etag = fetched
            self._now = _opened("from_bytes", content), etag
            return True

    def close(self) -> None:
        """Close the idle connections to the server; a later `refresh` opens a new one."""
        if self._client is not None:
            self._client.close()

    @property
    def packed(self) -> Any:
        """Its packed table, `surrogate.kernel.binding.PackedTable`."""
        return self._now[0]

    def __repr__(self) -> str:
        rows, size = self.packed.words["provenance"]["rows"], self.packed.size
        return (
            f"<Table {self.name!r}, version {self.version}: {rows} rows, method {self.method}, "
            f"range {self._range()}, {size / 1e6:.3g} MB>"
        )

    def _range(self) -> str:
        """Return the load range in words, N and N·m, and that of further inputs."""
        low, high = self.packed.arrays["space/range"]
        spans = [
            f"{one.name} {a:g} to {b:g}"
            for one, a, b in zip(self.space.inputs, low, high, strict=True)
            if a or b
        ]
        units = ["N", "N·m", *dict.fromkeys(one.unit for one in self.space.scalars)]
        return f"{', '.join(spans)} ({', '.join(units)})"

    def _repr_html_(self) -> str:
        low, high = self.packed.arrays["space/range"]
        rows = self.packed.words["provenance"]["rows"]
        return html_table(
            f"{self.name}, table version {self.version}: {rows} rows, method {self.method}",
            ["", *_columns(self.space.inputs)],
            [["lowest", *low.tolist()], ["highest", *high.tolist()]],
        )

    def to_pandas(self) -> Any:
        """Return the rows of the table as a pandas DataFrame, a line a row.

        Columns are the loads (``fx [N]``), the displacement (``ux [m]``, NaN where a row has none)
        and ``group``, the number of the group of outputs. pandas must be installed.

        Raises
        ------
        MissingPackage
            If pandas is not installed.
        """
        pandas, frames, space = require_pandas(), [], self.space
        for group, (wrenches, moved) in enumerate(_row_groups(self.packed.arrays)):
            columns = named_columns(_columns(space.inputs), wrenches)
            columns |= named_columns(_columns(space.outputs), moved)
            frames.append(pandas.DataFrame({"group": group, **columns}))
        return pandas.concat(frames, ignore_index=True) if frames else pandas.DataFrame()

    def __getstate__(self) -> dict[str, Any]:
        """Return what is pickled."""
        return {name: value for name, value in vars(self).items() if name != "_fetching"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state, _fetching=threading.Lock())


class DownloadCalls(Transport):
    """Tables for this process."""

    @sync_and_async
    def download(self, name: str, scene: Scene | None = None) -> Call[Table]:
        """Return a component's table, which answers in this process; its calls all block.

        Parameters
        ----------
        name : str
            The component.
        scene : Scene, optional
            The needs of a simulation: the same answers to its wrenches from a smaller table.

        Raises
        ------
        TableError
            If the compiled code is not there and there is no C compiler; if the server's table has
            another format: install the server's version.
        ProblemError
            If there is no such component (404), or the scene goes beyond its load range (422).
        SceneError
            If the scene has no such component.
        ServerUnreachable, ServerTimeout
            See `Client.call`.
        """
        packed_tables()  # an error comes before the download
        fetched = yield from _fetch(name, *_call(name, scene), None)
        assert fetched is not None
        content, etag = fetched
        return Table(_opened("from_bytes", content), name, self.blocking(), etag, scene)


_WHOLE = len(LOADS)  # loads, or outputs, of one interface
_ALL_PARTS = 4  # of the array solver/flags: whether all parts of the error are known


def _tolerance_of(packed: Any) -> dict[str, float] | None:
    translation, rotation = packed.arrays["space/tolerance"][[0, 3]].tolist()
    if np.isnan(translation):
        return None
    return {"translation": translation, "rotation": rotation}


def _columns(quantities: Any) -> list[str]:
    """Return the names of a CSV export: ``left.fx [N]``, ``mx [N*m]``, ``temperature [degC]``."""
    return [f"{one.name} [{one.unit.replace('·', '*')}]" for one in quantities]


def _reply(packed: Any, found: Any) -> dict[str, Any]:
    """Return the server's reply to ``estimate`` with this answer."""
    moved, bars, names = found.outputs, found.error, packed.space.interfaces
    source, reason = "table" if moved else None, found.reason
    if found.row is not None:
        source = found.source
        reason = f"{EXACT if found.exact else ROUNDED} {reason}".rstrip()
    if packed.outputs == _WHOLE:
        answered = _moved(moved, bars)
    else:
        parts = {name: slice(_WHOLE * k, _WHOLE * (k + 1)) for k, name in enumerate(names)}
        each = {name: _moved(moved and moved[k], bars and bars[k]) for name, k in parts.items()}
        answered = {"displacements": each}
    answered |= {
        "coverage": found.coverage,
        "within_tolerance": found.within_tolerance,
        "source": source,
        "method": found.method,
        "table_version": packed.words["provenance"]["version"],
        "reason": reason,
    }
    return answered | ({"missing": found.missing} if found.missing else {})


def _moved(moved: list[float] | None, bars: list[float] | None) -> dict[str, Any]:
    """Return an interface's displacement and error bars, m and rad, as the wire has them."""
    return {
        "translation": moved and moved[:3],
        "rotation": moved and moved[3:],
        "error": bars and {"translation": bars[:3], "rotation": bars[3:]},
    }


def _call(name: str, scene: Scene | None) -> tuple[str, dict[str, str]]:
    """Return the server's call for a table, and its query."""
    if scene is None:
        return "table", {"format": "packed"}
    return "scene", {"wanted": scene.query(name)}


def _row_groups(arrays: dict[str, Any]) -> Iterator[tuple[Vector, Vector]]:
    """Yield inputs (r, n), SI, and displacements (r, m), m and rad, of each group's rows."""
    for number in itertools.count():
        if f"g{number}/row/wrench" not in arrays:
            return
        yield arrays[f"g{number}/row/wrench"], arrays[f"g{number}/row/moved"]


def packed_tables() -> Any:
    """Return the class of packed tables, with its compiled code."""
    try:
        return _surrogate("kernel.binding").PackedTable
    except (ValueError, RuntimeError) as error:
        raise TableError(str(error)) from error


def _opened(constructor: str, source: Any) -> Any:
    """Return a packed table by one of the constructors of its class."""
    try:
        return getattr(packed_tables(), constructor)(source)
    except (ValueError, RuntimeError) as error:
        raise TableError(str(error)) from error


def _surrogate(module: str) -> Any:
    """Return a module of the surrogate package; it needs numpy alone."""
    return importlib.import_module(f"wrenchbook.surrogate.{module}")


def _fetch(
    name: str, call: str, query: dict[str, str], etag: str | None
) -> Call[tuple[bytes, str | None] | None]:
    """Return a component's table file and its ETag; None if the server's is that of `etag`."""
    headers = {"If-None-Match": etag} if etag else None
    reply = yield Request("GET", component_path(name, call), query=query, headers=headers)
    found = reply.headers.get("ETag")
    # Some proxies answer from their cache with 200 where nothing is new.
    if reply.status == 304 or (etag is not None and found == etag):
        return None
    return reply.content, found
