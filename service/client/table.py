"""A component's table in the simulator's process: the server's answers without the server."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from time import perf_counter_ns
from typing import TYPE_CHECKING, Any, Self, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wrenchbook.surrogate.answer import allowed_by, bars_within
from wrenchbook.surrogate.kernel.binding import PackedTable, kernel
from wrenchbook.surrogate.kernel.format import write_file
from wrenchbook.surrogate.table.rows import Tolerance as ErrorLimits

from ..contract import COVERAGE, LOADS, Coverage
from ..messages import Part
from .errors import InvalidArgument, TableError, required
from .notebook import html_table, named_columns
from .replies import EXACT, ROUNDED, Displacement, Displacements
from .scene import ComponentPlan, Scene
from .transport import Connection, component_path
from .wrenches import (
    Load,
    Tolerance,
    Vector,
    loads_body,
    many_wrenches,
    single_wrench,
    tolerance_body,
    wrench_of,
)

if TYPE_CHECKING:
    from wrenchbook.surrogate.kernel.replies import Floats, Reply
    from wrenchbook.surrogate.table.space import Input, Output, Space

_PER_INTERFACE = len(LOADS)  # number of loads, or of outputs, of one interface


class Table:
    """One version of a component's table; `Client.download` and `Table.open` return one.

    A table of a scene answers by the component's default method alone. Wrenches that cannot occur
    in the scene are ``outside``; an output that the scene does not read is NaN.

    It is the server's packed table, answered by the same compiled code: the numbers are those of
    the server to the last bit. Only `refresh` calls the server. Any number of threads may use one.
    A pickle holds the table's bytes, of an opened file its path.

    Parameters
    ----------
    packed : PackedTable
        The table, of `wrenchbook.surrogate.kernel.binding`.
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
        packed: PackedTable,
        name: str | None = None,
        client: Connection | None = None,
        etag: str | None = None,
        scene: Scene | None = None,
    ) -> None:
        if isinstance(packed, str | os.PathLike):
            raise TypeError(f"Table takes a packed table, not a path; use Table.open({packed!r})")
        self._now = packed, etag  # replaced as a pair: threads read it
        self.name: str = name or packed.meta["provenance"]["component"]
        self._client = client
        self._scene = scene
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
        try:
            return cls(PackedTable.open(path))
        except (ValueError, RuntimeError) as error:
            raise TableError(str(error)) from error

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the table to a file that `open` opens; it is complete or not there.

        Raises
        ------
        OSError
            If it cannot be written.
        """
        write_file(Path(path), [self.packed.content])

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return read-only views of the table's arrays by name; none is copied.

        ``space/range`` (2, n) has the range of the n inputs, SI; ``gK/row/wrench`` (r, n) and
        ``gK/row/moved`` (r, m), m and rad, the rows of the K-th group of outputs. The names,
        shapes and units of all are in surrogate/packed/arrays.py.
        """
        return dict(self.packed.arrays)

    @property
    def version(self) -> int:
        """The table's version, the server's `table_version`."""
        return self.packed.meta["provenance"]["version"]

    @property
    def method(self) -> str:
        """The method that answers if none is given."""
        return self.packed.meta["summary"]["method"]

    @property
    def space(self) -> Space:
        """Inputs and outputs of the table: names, units, interfaces."""
        return self.packed.space

    @property
    def tolerance(self) -> dict[str, float] | None:
        """The component's own tolerance, ``translation`` in m and ``rotation`` in rad, or None."""
        limits = self.packed.tolerance
        return None if limits is None else {"translation": limits[0], "rotation": limits[1]}

    @property
    def plan(self) -> ComponentPlan | None:
        """The scene plan that a scene's table follows; None of a whole table."""
        scene = self.packed.meta.get("scene")
        if scene is None:
            return None
        return ComponentPlan.read({**scene["plan"], "component": self.name})

    def answer(
        self,
        force: ArrayLike | None = None,
        moment: ArrayLike | None = None,
        tolerance: Tolerance | None = None,
        method: str | None = None,
        derivatives: bool = False,
        *,
        loads: Mapping[str, Load] | None = None,
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
        packed = self.packed  # all of an answer is this version's, also beside a refresh
        values, wrenches = self._values(packed, force, moment, loads, inputs)
        limit = self.allowed_errors(tolerance, packed)
        started = perf_counter_ns()
        try:
            reply = packed.answer(values, limit, method)
            elapsed_us = (perf_counter_ns() - started) / 1e3
            slope = packed.derivative(values, limit, method) if derivatives else None
        except ValueError as error:
            raise InvalidArgument(str(error)) from error
        if slope is not None:
            slope.flags.writeable = False
            slope = None if np.isnan(slope).all() else slope
        if packed.outputs == _PER_INTERFACE:
            wrench = next(iter(wrenches.values()))
            return self._displacement(packed, wrench, reply, 0, elapsed_us, slope)
        parts = {}
        for k, name in enumerate(packed.space.interfaces):
            wrench = wrenches.get(name, np.zeros(_PER_INTERFACE))
            first = _PER_INTERFACE * k
            parts[name] = self._displacement(packed, wrench, reply, first, elapsed_us, slope)
        wrench = np.concatenate([part.wrench for part in parts.values()])
        return self._displacement(packed, wrench, reply, None, elapsed_us, slope, parts)

    def _displacement(
        self,
        packed: PackedTable,
        wrench: Vector,
        reply: Reply,
        first: int | None,
        elapsed_us: float,
        slope: Floats | None,
        interfaces: Mapping[str, Displacement] | None = None,
    ) -> Displacement:
        """Return an answer with a reply's six outputs from index `first` on, if it is given."""
        moved = {} if first is None else _parts(reply.outputs, first)
        error = None if first is None else _parts(reply.error, first)
        source = "table" if reply.outputs else None
        reason = reply.reason
        if reply.row is not None:
            source = reply.source
            reason = f"{EXACT if reply.exact else ROUNDED} {reason}".rstrip()
        return Displacement(
            component=self.name,
            wrench=wrench,
            translation=moved.get("translation"),
            rotation=moved.get("rotation"),
            error=error or None,
            coverage=cast(Coverage, reply.coverage),
            source=source,
            method=reply.method,
            table_version=packed.meta["provenance"]["version"],
            elapsed_us=elapsed_us,
            reason=reason,
            missing=reply.missing,
            within_tolerance=reply.within_tolerance,
            derivative=slope,
            interfaces=interfaces or {},
        )

    def _values(
        self,
        packed: PackedTable,
        force: ArrayLike | None,
        moment: ArrayLike | None,
        loads: Mapping[str, Load] | None,
        inputs: Mapping[str, float] | None,
    ) -> tuple[list[float], dict[str, Vector]]:
        """Return the table's inputs (n,), SI, and the wrenches by interface, "" for the only one.

        Negative zeros become zeros, as the server reads them.
        """
        if (
            force is not None
            and loads is None
            and inputs is None
            and packed.inputs == _PER_INTERFACE
        ):
            wrench = single_wrench(force, moment)
            return (wrench + 0.0).tolist(), {"": wrench}
        body = loads_body(force, moment, loads, inputs)
        space = packed.space
        if "force" in body and space.several:
            names = ", ".join(f"{name!r}: WRENCH" for name in space.several)
            raise InvalidArgument(
                f"{self.name} has several interfaces, so force and moment are ambiguous; give "
                f"loads={{{names}}} instead"
            )
        by_name = {"": body} if "force" in body else body.get("loads", {})
        wrenches = {name: wrench_of(load) for name, load in by_name.items()}
        six = {name: wrench.tolist() for name, wrench in wrenches.items()}
        try:
            values = space.vector(six, body.get("inputs", {}))
        except ValueError as error:
            raise InvalidArgument(f"{self.name}: {error}") from None
        return [value + 0.0 for value in values], wrenches or {"": np.zeros(_PER_INTERFACE)}

    def allowed_errors(
        self, tolerance: Tolerance | None, packed: PackedTable | None = None
    ) -> tuple[float, ...] | None:
        """Return the largest error of each output, shape (m,), m and rad; None for its own.

        `packed` is the version of the answers, by default the present one.
        """
        if tolerance is None:
            return None
        return allowed_by(ErrorLimits(**tolerance_body(tolerance)), (packed or self.packed).space)

    def batch(
        self,
        wrenches: ArrayLike,
        tolerance: Tolerance | None = None,
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
        packed = self.packed
        limit = self.allowed_errors(tolerance, packed)
        block = many_wrenches(wrenches, packed.inputs)
        loads = block + 0.0  # no negative zeros, as the server reads them
        started = perf_counter_ns()
        try:
            replies = packed.batch(loads, limit, method)
            elapsed_us = (perf_counter_ns() - started) / 1e3
            slopes = packed.derivatives(loads, limit, method) if derivatives else None
        except ValueError as error:
            raise InvalidArgument(str(error)) from error

        # Errors without the solver's part cannot be compared with a tolerance.
        complete = packed.bars_are_complete
        allowed = (limit or self.allowed_errors(packed.tolerance, packed)) if complete else None
        return Displacements(
            component=self.name,
            wrenches=block,
            displacements=replies.outputs,
            errors=replies.errors,
            coverage=np.array(COVERAGE)[replies.coverage],
            jobs={},
            table_version=packed.meta["provenance"]["version"],
            elapsed_us=elapsed_us,
            method=packed.answers_by(method),
            within_tolerance=None
            if allowed is None
            else bars_within(replies.outputs, replies.errors, allowed),
            derivatives=slopes,
        )

    def stiffness(
        self,
        force: ArrayLike | None = None,
        moment: ArrayLike | None = None,
        *,
        loads: Mapping[str, Load] | None = None,
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
        packed = self.packed
        values = self._values(packed, force, moment, loads, inputs)[0]
        try:
            slope = packed.derivative(values)[:, : packed.outputs]
        except ValueError as error:
            raise InvalidArgument(str(error)) from error
        names = np.array(packed.space.output_names)
        unknown = np.isnan(slope).any(axis=1)
        if unknown.any():
            raise InvalidArgument(
                f"{self.name} has no stiffness at this wrench, because the derivative of "
                f"{', '.join(names[unknown])} is unknown. Solve rows near it (wrenchbook fill "
                f"{self.name}), or import rows with these outputs; then download the table again"
            )
        try:
            return np.asarray(np.linalg.inv(slope), dtype=float)
        except np.linalg.LinAlgError:
            still = ~slope.any(axis=1)  # outputs that no load moves
            locked = f"no load moves the locked freedoms {', '.join(names[still])}"
            cause = locked if still.any() else "it is singular"
            raise InvalidArgument(
                f"the derivative of {self.name} at this wrench has no inverse: {cause}. Take "
                "answer(..., derivatives=True).derivative, and invert the rows and columns of "
                "the freedoms that move"
            ) from None

    def error_parts(
        self,
        force: ArrayLike | None = None,
        moment: ArrayLike | None = None,
        *,
        loads: Mapping[str, Load] | None = None,
        inputs: Mapping[str, float] | None = None,
    ) -> dict[str, np.ndarray | None]:
        """Return the parts of the error bars under one wrench, N and N·m, that rows do not lower.

        Returns
        -------
        dict
            ``mesh``, of a linear component ``linearity`` and of measured rows with hysteresis,
            drift or sessions ``measurement``: shape (m,), m and rad, None where it is not known.
            The rest of a bar is the table's. Empty where there is no such part.
        """
        packed = self.packed
        error = packed.meta["solver_error"] or {}
        reply = packed.answer(self._values(packed, force, moment, loads, inputs)[0])
        parts = {"mesh": reply.discretisation} if error else {}
        if "linearity" in error:
            parts["linearity"] = reply.linearity
        if any(reply.measurement or ()):
            parts["measurement"] = reply.measurement
        return {
            cause: None if part is None else np.array(part, dtype=float)
            for cause, part in parts.items()
        }

    def refresh(self) -> bool:
        """Take the server's newest version of the table; return whether there was a new one.

        It waits up to 25 s for a version with all present rows. Answers given meanwhile are those
        of the version before.

        Raises
        ------
        ValueError
            If the table was opened from a file.
        ProblemError, ServerUnreachable, ServerTimeout
            As in `Client.call`; the table is then as it was.
        """
        if self._client is None:
            raise InvalidArgument(
                f"the table of {self.name} was opened from a file and has no server to ask; get "
                f"the newest version with client.download({self.name!r})"
            )
        with self._fetching:
            fetched = _fetch(self._client, self.name, self._scene, self._now[1])
            if fetched is not None:
                self._now = fetched
            return fetched is not None

    def close(self) -> None:
        """Close the idle connections to the server; a later `refresh` opens a new one."""
        if self._client is not None:
            self._client.close()

    @property
    def packed(self) -> PackedTable:
        """The packed table that answers: arrays and metadata."""
        return self._now[0]

    def __repr__(self) -> str:
        low, high = self.packed.load_range
        spans = [
            f"{load.name} {least:g} to {largest:g}"
            for load, least, largest in zip(self.space.inputs, low, high, strict=True)
            if least or largest
        ]
        units = ["N", "N·m", *dict.fromkeys(load.unit for load in self.space.scalars)]
        rows = self.packed.meta["provenance"]["rows"]
        size = self.packed.size
        return (
            f"<Table {self.name!r}, version {self.version}: {rows} rows, method {self.method}, "
            f"range {', '.join(spans)} ({', '.join(units)}), {size / 1e6:.3g} MB>"
        )

    def _repr_html_(self) -> str:
        low, high = self.packed.load_range
        rows = self.packed.meta["provenance"]["rows"]
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
        pandas = required("pandas", "to_pandas", "pandas")
        frames = []
        arrays, space = self.packed.arrays, self.space
        for group in range(len(self.packed.meta["groups"])):
            columns = named_columns(_columns(space.inputs), arrays[f"g{group}/row/wrench"])
            columns |= named_columns(_columns(space.outputs), arrays[f"g{group}/row/moved"])
            frames.append(pandas.DataFrame({"group": group, **columns}))
        return pandas.concat(frames, ignore_index=True) if frames else pandas.DataFrame()

    def __getstate__(self) -> dict[str, object]:
        """Everything but the lock."""
        return {name: value for name, value in vars(self).items() if name != "_fetching"}

    def __setstate__(self, state: dict[str, object]) -> None:
        vars(self).update(state, _fetching=threading.Lock())


class DownloadCalls(Connection):
    """Tables for this process."""

    def download(self, name: str, scene: Scene | None = None) -> Table:
        """Return a component's table, which answers in this process; its calls all block.

        It has the rows of now if their build ends within 25 s, else those of the server's present
        version. After an import compare `Table.version` with the reply's ``table_version``.

        Parameters
        ----------
        name : str
            The component.
        scene : Scene, optional
            The needs of a simulation: the same answers to its wrenches from a table cut to them.

        Raises
        ------
        TableError
            If the compiled code is not there and there is no C compiler; if the server's table has
            another format: install the server's version.
        ProblemError
            If there is no such component (404), or the scene goes beyond its load range (422).
        InvalidArgument
            If the scene is no `Scene`; SceneError if it has no such component.
        ServerUnreachable, ServerTimeout
            See `Client.call`.
        """
        if not (scene is None or isinstance(scene, Scene)):
            raise InvalidArgument(
                f"scene must be a Scene, such as Scene.read('scene.toml'), not {scene!r}"
            )
        try:
            kernel()  # an error must come before the download
        except RuntimeError as error:
            raise TableError(str(error)) from error
        fetched = _fetch(self, name, scene, None)
        assert fetched is not None
        packed, etag = fetched
        return Table(packed, name, self, etag, scene)


def _parts(outputs: Sequence[float | None] | None, first: int) -> dict[Part, Vector]:
    """Return translation and rotation from an index on, read-only, NaN for None; empty if none."""
    if not outputs:
        return {}
    six = np.array(outputs[first : first + _PER_INTERFACE], dtype=float)
    six.flags.writeable = False
    return {"translation": six[:3], "rotation": six[3:]}


def _columns(quantities: Iterable[Input | Output]) -> list[str]:
    """Return the columns of a CSV export: ``left.fx [N]``, ``mx [N*m]``, ``temperature [degC]``."""
    return [f"{quantity.name} [{quantity.unit.replace('·', '*')}]" for quantity in quantities]


def _fetch(
    client: Connection, name: str, scene: Scene | None, etag: str | None
) -> tuple[PackedTable, str | None] | None:
    """Return a component's table and its ETag; None if the server's is that of `etag`."""
    call = "table"
    query = {"format": "packed"}
    if scene is not None:
        call = "scene"
        query = {"wanted": scene.query(name)}
    headers = {"If-None-Match": etag} if etag else None
    reply = client.call("GET", component_path(name, call), query=query, headers=headers)
    newest = reply.headers.get("ETag")
    # Some proxies answer from their cache with 200 although nothing is new.
    if reply.status == 304 or (etag is not None and newest == etag):
        return None
    try:
        return PackedTable.from_bytes(reply.content), newest
    except (ValueError, RuntimeError) as error:
        raise TableError(str(error)) from error
