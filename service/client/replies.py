"""Answers of the server and of tables: frozen, with numpy arrays, in SI."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..contract import COVERAGE
from .errors import Document, InvalidArgument, Json
from .job import Job, joined
from .notebook import (
    DISPLACEMENT_COLUMNS,
    ERROR_COLUMNS,
    SHOWN,
    WRENCH_COLUMNS,
    html_table,
    named_columns,
    require_pandas,
)
from .rotation import rotation_matrix
from .transport import Response
from .wrenches import wrench_of

Vector = NDArray[np.float64]

EXACT = "One row of the table has exactly this wrench."
ROUNDED = "One row of the table has this wrench, rounded to 1e-6 of the load range."


@dataclass(frozen=True, eq=False)
class Displacement:
    """The answer to one wrench, in the undeformed interface frame.

    Parameters
    ----------
    component : str
        Its name.
    wrench : numpy.ndarray
        Shape (6,), N and N·m, of the request.
    translation, rotation : numpy.ndarray or None
        Shape (3,), m; rotation vector, shape (3,), rad. None while it is not known.
    error_translation, error_rotation : numpy.ndarray or None
        Estimated 95 % error bars, shape (3,), m and rad.
    coverage : str
        ``covered``, ``thin`` or ``outside``.
    source : str or None
        ``table``, or where the row that answers came from: ``fea``, ``measured``.
    method : str or None
        ``griddata``, ``linear``, ``row``, ...
    table_version : int or None
        Version of the table that answered.
    elapsed_us : float or None
        Time the answer took in the server, µs.
    job : Job or None
        The solve that will make it better; None where it is covered, and where nothing was queued:
        beyond the load range, or with a full queue.
    reason : str
        Why it is not covered, or has no job; may be empty.
    within_tolerance : bool or None
        Whether the whole error bar is within the tolerance. A covered answer that is not has a
        solver whose own error, of its mesh say, is larger; no row lowers that. None if unknown.
    derivative : numpy.ndarray or None
        du/dw, shape (6, 6), m/N, m/(N·m), rad/N, rad/(N·m), a line an output, if it was requested
        and is known; NaN where an output is not.
    interfaces : dict of str to Displacement
        Of a component with several interfaces each one's own displacement by its name; the whole
        has no translation and rotation then. Empty otherwise.
    raw : dict
        The reply as it came; with ``detail`` it has ``axes``.
    """

    component: str
    wrench: Vector
    translation: Vector | None
    rotation: Vector | None
    error_translation: Vector | None
    error_rotation: Vector | None
    coverage: str
    source: str | None
    method: str | None
    table_version: int | None
    elapsed_us: float | None
    job: Job | None
    reason: str
    within_tolerance: bool | None = None
    derivative: Vector | None = None
    raw: Document = field(default_factory=dict, repr=False)
    interfaces: Mapping[str, Displacement] = field(default_factory=dict)

    @classmethod
    def read(
        cls,
        component: str,
        wrench: Vector,
        body: Mapping[str, Json],
        loads: Mapping[str, Json] | None = None,
    ) -> Self:
        """Make one from the reply to `wrench`, shape (6,), N and N·m, or to the wire's loads."""
        error = body.get("error") or {}
        job, shared = body.get("job"), {k: v for k, v in body.items() if k != "displacements"}
        parts = {
            name: cls.read(component, wrench_of((loads or {}).get(name, {})), shared | part)
            for name, part in body.get("displacements", {}).items()
        }
        if parts:
            wrench = np.concatenate([part.wrench for part in parts.values()])
        return cls(
            component=body.get("component") or component,
            wrench=wrench,
            translation=_array(body.get("translation")),
            rotation=_array(body.get("rotation")),
            error_translation=_array(error.get("translation")),
            error_rotation=_array(error.get("rotation")),
            coverage=body["coverage"],
            source=body.get("source"),
            method=body.get("method"),
            table_version=body.get("table_version"),
            elapsed_us=body.get("elapsed_us"),
            job=Job.read(job, component) if job else None,
            reason=body.get("reason") or "",
            within_tolerance=body.get("within_tolerance"),
            derivative=_array(body.get("derivative")),
            raw=dict(body),
            interfaces=parts,
        )

    @property
    def covered(self) -> bool:
        """Whether the table covers this wrench, or a solve of it has answered."""
        return self.coverage == "covered"

    @property
    def vector(self) -> Vector | None:
        """Translation then rotation, shape (6,), m and rad; None while it is not known."""
        return joined(self.translation, self.rotation)

    @property
    def error_vector(self) -> Vector | None:
        """Error bars in the order of `vector`, shape (6,), m and rad."""
        return joined(self.error_translation, self.error_rotation)

    @property
    def matrix(self) -> Vector:
        """The displacement as a homogeneous matrix, shape (4, 4), in the interface frame.

        Its rotation is dimensionless, its last column m.

        Raises
        ------
        ValueError
            If nothing is known yet.
        """
        rotation, position = self.apply(np.eye(3), np.zeros(3))
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = rotation, position
        return matrix

    def apply(self, R0: ArrayLike, p0: ArrayLike) -> tuple[Vector, Vector]:
        """Move the pose of the undeformed interface to the deformed one.

        Parameters
        ----------
        R0 : array_like
            Shape (3, 3): the undeformed interface frame's axes, as columns, in the world.
        p0 : array_like
            Shape (3,), m: the undeformed interface point in the world.

        Returns
        -------
        R, p : numpy.ndarray
            R0 exp(r), shape (3, 3), and p0 + R0 u, shape (3,), m.

        Raises
        ------
        ValueError
            If nothing is known yet, or a shape is wrong.
        """
        if self.interfaces:
            name = next(iter(self.interfaces))
            raise InvalidArgument(
                f"{self.component} has several interfaces: take one, interfaces[{name!r}]"
            )
        if self.translation is None or self.rotation is None:
            remedy = (
                f"wait for job {self.job.id}" if self.job else self.reason or "no job is queued"
            )
            raise InvalidArgument(
                f"the displacement of {self.component} under this wrench is not known ({remedy})"
            )
        orientation, point = np.asarray(R0, dtype=float), np.asarray(p0, dtype=float)
        if orientation.shape != (3, 3) or point.shape != (3,):
            raise InvalidArgument(
                f"R0 must have shape (3, 3) and p0 (3,), not {orientation.shape} and {point.shape}"
            )
        rotated = orientation @ rotation_matrix(self.rotation)
        return rotated, point + orientation @ self.translation

    def _repr_html_(self) -> str:
        if self.interfaces:
            return "".join(
                f"<p>{name}</p>{one._repr_html_()}" for name, one in self.interfaces.items()
            )
        unknown = np.full(6, np.nan)
        moved, errors = self.vector, self.error_vector
        columns = (
            WRENCH_COLUMNS,
            self.wrench.tolist(),
            DISPLACEMENT_COLUMNS,
            (unknown if moved is None else moved).tolist(),
            (unknown if errors is None else errors).tolist(),
        )
        caption = f"{self.component}: {self.coverage}"
        return html_table(
            f"{caption}. {self.reason}" if self.reason else caption,
            ("load", "wrench", "output", "displacement", "error bar, 95 %"),
            zip(*columns, strict=True),
        )


@dataclass(frozen=True, eq=False)
class Displacements:
    """The answers to a batch of wrenches.

    Parameters
    ----------
    component : str
        Its name.
    wrenches : numpy.ndarray
        Shape (n, inputs), SI, of the request.
    displacements, errors : numpy.ndarray
        Shape (n, outputs), m and rad; NaN where it is not known.
    coverage : numpy.ndarray
        Shape (n,), of ``covered``, ``thin``, ``outside``.
    jobs : dict of int to Job
        The solves that are queued, by the number of the wrench, from 0; empty from a binary batch,
        whose ``raw["jobs_queued"]`` says how many there are.
    no_job : dict of int to str
        Why a wrench that is not covered has no job, by its number, from 0: it is beyond the load
        range, or the queue is full; empty from a binary batch.
    table_version : int or None
        Version of the table that answered.
    elapsed_us : float or None
        Time all answers took in the server, µs.
    method : str or None
        How the table answered.
    within_tolerance : numpy.ndarray of bool or None
        Shape (n,): where the whole error bar is known and within the tolerance; None without one.
    derivatives : numpy.ndarray or None
        du/dw, shape (n, outputs, inputs), SI, a line an output, if requested; NaN where it is not
        known.
    """

    component: str
    wrenches: Vector
    displacements: Vector
    errors: Vector
    coverage: NDArray[np.str_]
    jobs: dict[int, Job]
    no_job: dict[int, str]
    table_version: int | None
    elapsed_us: float | None
    method: str | None = None
    within_tolerance: NDArray[np.bool_] | None = None
    derivatives: Vector | None = None
    raw: Document = field(default_factory=dict, repr=False)

    @classmethod
    def read(cls, component: str, wrenches: Vector, body: Mapping[str, Json]) -> Self:
        """Make one from the reply to `wrenches`, shape (n, 6), N and N·m."""
        count, jobs = len(wrenches), body.get("jobs") or ()
        return cls(
            component=body.get("component") or component,
            wrenches=wrenches,
            displacements=_block(body["displacements"], count),
            errors=_block(body["errors"], count),
            coverage=np.array(body["coverage"], dtype=np.str_),
            jobs={
                job["index"]: Job.read(job, component) for job in jobs if job.get("id") is not None
            },
            no_job={job["index"]: job.get("reason") or "" for job in jobs if job.get("id") is None},
            table_version=body.get("table_version"),
            elapsed_us=body.get("elapsed_us"),
            method=body.get("method"),
            within_tolerance=judged(body.get("within_tolerance")),
            derivatives=_tangents(body.get("derivatives")),
            raw=dict(body),
        )

    @classmethod
    def read_binary(cls, component: str, wrenches: Vector, reply: Response) -> Self:
        """Make one from the binary reply to `wrenches`, shape (n, 6), N and N·m.

        The reply is float64, shape (n, 2 m + 1): displacement and error bars of m outputs, m and
        rad, then coverage as 0, 1 or 2 for `COVERAGE`; with derivatives shape (n, m, inputs)
        follows, du/dw.
        """
        numbers, count = np.frombuffer(reply.content, dtype="<f8").astype(float), len(wrenches)
        m = int(reply.headers.get("Wrenchbook-Outputs", 6))
        width = 2 * m + 1
        block, rest = numbers[: width * count].reshape(count, width), numbers[width * count :]
        version, elapsed, jobs = (
            reply.headers.get(f"Wrenchbook-{name}")
            for name in ("Table-Version", "Elapsed-Us", "Jobs")
        )
        return cls(
            component=component,
            wrenches=wrenches,
            displacements=block[:, :m],
            errors=block[:, m:-1],
            coverage=np.array(COVERAGE)[block[:, -1].astype(int)],
            jobs={},
            no_job={},
            table_version=None if version is None else int(version),
            elapsed_us=None if elapsed is None else float(elapsed),
            method=reply.headers.get("Wrenchbook-Method"),
            within_tolerance=_within(block[:, m:-1], reply.headers.get("Wrenchbook-Tolerance")),
            derivatives=rest.reshape(count, m, -1) if len(rest) else None,
            raw={"jobs_queued": int(jobs or 0)},
        )

    def __len__(self) -> int:
        return len(self.wrenches)

    def to_pandas(self) -> Any:
        """Return a pandas DataFrame, a line a wrench; pandas must be installed.

        Columns are the loads (``fx [N]``), the displacement (``ux [m]``, ``rx [rad]``), its error
        bars (``error ux [m]``) and ``coverage``.

        Raises
        ------
        MissingPackage
            If pandas is not installed.
        """
        return require_pandas().DataFrame(self._columns())

    def _columns(self) -> Document:
        return {
            **_named(WRENCH_COLUMNS, self.wrenches, "input"),
            **_named(DISPLACEMENT_COLUMNS, self.displacements, "output"),
            **_named(ERROR_COLUMNS, self.errors, "error of output"),
            "coverage": self.coverage,
        }

    def _repr_html_(self) -> str:
        columns = self._columns()
        rows = zip(*(column[:SHOWN].tolist() for column in columns.values()), strict=True)
        more = f", the first {SHOWN} of {len(self)}" if len(self) > SHOWN else ""
        return html_table(f"{self.component}: {len(self)} answers{more}", list(columns), rows)

    @property
    def covered(self) -> NDArray[np.bool_]:
        """Where the table covers the wrench: shape (n,), dimensionless."""
        return self.coverage == "covered"


def _named(names: Sequence[str], block: Vector, word: str) -> Document:
    """Return a block's columns, by their places where they are not those of one wrench."""
    if block.shape[1] != len(names):
        names = [f"{word} {place}" for place in range(block.shape[1])]
    return named_columns(names, block)


def _array(values: Json) -> Vector | None:
    """Return floats, NaN for null, as an array that is not written to by mistake, or None."""
    if values is None:
        return None
    array = np.array(values, dtype=float)
    array.flags.writeable = False
    return array


def judged(flags: Json) -> NDArray[np.bool_] | None:
    """Return where error bars are within the tolerance, shape (n,), dimensionless, or None."""
    return None if flags is None else np.array([one is True for one in flags], dtype=bool)


def _within(bars: Vector, tolerance: str | None) -> NDArray[np.bool_] | None:
    """Return the same of error bars (n, m), m and rad, and "translation, rotation", m and rad."""
    if tolerance is None:
        return None
    allowed = np.repeat([float(one) for one in tolerance.split(",")], 3)
    return bars_within(bars, np.resize(allowed, bars.shape[1]))


def bars_within(bars: Vector, allowed: ArrayLike) -> NDArray[np.bool_]:
    """Return where error bars (n, m), m and rad, are known and within the allowed ones (m,)."""
    unknown = np.isnan(bars)
    within = np.all(unknown | (bars <= np.asarray(allowed, dtype=float)), axis=1)
    return np.logical_and(within, ~np.all(unknown, axis=1))


def _tangents(found: Json) -> Vector | None:
    """Return shape (n, m, inputs) of a batch's derivatives, NaN for null; None without any."""
    if found is None:
        return None
    shape = next((np.shape(one) for one in found if one is not None), (6, 6))
    unknown = np.full(shape, np.nan)
    blocks = [unknown if one is None else np.array(one, dtype=float) for one in found]
    return np.array(blocks).reshape(len(blocks), *shape)


def _block(rows: Json, count: int) -> Vector:
    """Return shape (n, m); a row, or a number, that is null becomes NaN."""
    outputs = next((len(row) for row in rows if row is not None), 6)
    unknown = (np.nan,) * outputs
    block = np.array([unknown if row is None else row for row in rows], dtype=float)
    return block.reshape(count, outputs)
