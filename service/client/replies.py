"""Answers of the server and of tables: frozen, with numpy arrays, in SI."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wrenchbook.surrogate.answer import bars_within

from .. import messages
from ..contract import COVERAGE
from .errors import Document, InvalidArgument, Json, required
from .job import Job, joined
from .notebook import (
    DISPLACEMENT_COLUMNS,
    ERROR_COLUMNS,
    SHOWN,
    WRENCH_COLUMNS,
    html_table,
    named_columns,
)
from .rotation import checked_pose, rotation_matrix
from .transport import Response
from .wrenches import Vector, wrench_of

EXACT = "One row of the table has exactly this wrench."
ROUNDED = "One row of the table has this wrench, rounded to 1e-6 of the load range."


class Displacement(messages.Displacement):
    """The answer to one wrench, in the undeformed interface frame.

    Attributes
    ----------
    component : str
        Name of the component.
    wrench : numpy.ndarray
        Wrench of the request, shape (6,), N and N·m.
    translation, rotation : numpy.ndarray or None
        Shape (3,), m; rotation vector, shape (3,), rad. None while it is not known.
    error_translation, error_rotation : numpy.ndarray or None
        Estimated 95 % error bars, shape (3,), m and rad.
    coverage : str
        ``covered``, ``thin`` or ``outside``.
    source : str or None
        ``table``, or where the row that answers came from: ``fea``, ``measured``.
    method : str or None
        ``kriging``, ``additive``, ``griddata`` or ``linear``; ``row`` where a row has this wrench;
        ``estimate`` where the table has too few rows for a method.
    table_version : int or None
        Version of the table that answered.
    elapsed_us : float or None
        Time the answer took in the server, µs.
    job : Job or None
        The queued solve of this wrench. None for a covered answer, and where nothing was queued:
        beyond the load range, or with a full queue.
    reason : str
        Why it is not covered, or has no job; may be empty.
    within_tolerance : bool or None
        Whether the total error bar is within the tolerance. If it is false of a covered answer,
        compare the parts of the error bar (`detail`): those of the mesh, the linearity or the rig
        are lowered by no row. None if unknown.
    derivative : numpy.ndarray or None
        du/dw, shape (6, 6), m/N, m/(N·m), rad/N, rad/(N·m), a line an output, if it was requested
        and is known; NaN where an output is not.
    interfaces : dict of str to Displacement
        Displacements by interface, of a component with several interfaces; the answer itself then
        has no translation and rotation. Empty otherwise.
    missing : tuple of str
        Outputs that no row has.
    notes : tuple of str
        Notes of the solve of this wrench, such as on distorted cells.
    error, error_parts, error_of_a_reading : mapping or None
        The error bar, its parts, and the error bar of one further reading of a rig, as the JSON
        has them, m and rad; the last two with ``detail``.
    axes, method_detail : tuple of dict, and str
        With ``detail``: the displacement by the loads of each axis; settings of the method.
    raw : dict
        The JSON of the reply.
    """

    wrench: Vector
    job: Job | None = None
    interfaces: Mapping[str, Displacement] = field(default_factory=dict)

    @classmethod
    def read(
        cls,
        body: Mapping[str, Any],
        wrench: Vector | None = None,
        loads: Mapping[str, Json] | None = None,
        **more: Any,
    ) -> Self:
        """Make an answer from the reply to `wrench`, shape (6,), N and N·m, or to `loads`."""
        shared = {name: value for name, value in body.items() if name != "displacements"}
        parts = {
            name: cls.read(shared | part, wrench_of((loads or {}).get(name, {})))
            for name, part in body.get("displacements", {}).items()
        }
        if parts:
            wrench = np.concatenate([part.wrench for part in parts.values()])
        job = Job.read(body["job"], body.get("component", "")) if body.get("job") else None
        return super().read(body, wrench=wrench, interfaces=parts, job=job, **more)

    @property
    def error_translation(self) -> Vector | None:
        """The error bars of the translation, shape (3,), m."""
        return self.error["translation"] if self.error else None

    @property
    def error_rotation(self) -> Vector | None:
        """The error bars of the rotation, shape (3,), rad."""
        return self.error["rotation"] if self.error else None

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
            If nothing is known yet, R0 is no rotation matrix, or a shape is wrong.
        """
        if self.interfaces:
            name = next(iter(self.interfaces))
            raise InvalidArgument(
                f"{self.component} has several interfaces, so its answer has no single value; "
                f"read one interface, such as answer.interfaces[{name!r}]"
            )
        if self.translation is None or self.rotation is None:
            if self.job:
                remedy = f"wait for its solve, client.wait({self.job.id}), and repeat the request"
            else:
                remedy = f"solve it with client.solve({self.component!r}, ...), or import rows"
            why = f" ({self.reason})" if self.reason else ""
            raise InvalidArgument(
                f"the displacement of {self.component} at this wrench is unknown{why}; {remedy}"
            )
        orientation, point = checked_pose(R0, p0)
        return orientation @ rotation_matrix(self.rotation), point + orientation @ self.translation

    def _repr_html_(self) -> str:
        if self.interfaces:
            return "".join(
                f"<p>{name}</p>{part._repr_html_()}" for name, part in self.interfaces.items()
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


class Displacements(messages.Displacements):
    """The answers to a batch of wrenches.

    Attributes
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
        Shape (n,): where the total error bar is known and within the tolerance; None without one.
    derivatives : numpy.ndarray or None
        du/dw, shape (n, outputs, inputs), SI, a line an output, if requested; NaN where it is not
        known.
    """

    # By wrench and as arrays, in place of the JSON's lists.
    jobs: dict[int, Job]  # pyright: ignore[reportIncompatibleVariableOverride]
    coverage: NDArray[np.str_]  # pyright: ignore[reportIncompatibleVariableOverride]
    within_tolerance: NDArray[np.bool_] | None = None  # pyright: ignore[reportIncompatibleVariableOverride]
    derivatives: Vector | None = None  # pyright: ignore[reportIncompatibleVariableOverride]
    wrenches: Vector
    no_job: dict[int, str] = field(default_factory=dict)

    @classmethod
    def read(cls, body: Mapping[str, Any], wrenches: Vector | None = None, **more: Any) -> Self:
        """Make the answers from the reply to `wrenches`, shape (n, inputs), SI."""
        jobs = body.get("jobs") or ()
        blocks: dict[str, Any] = {
            "displacements": _stacked(body["displacements"], (6,)),
            "errors": _stacked(body["errors"], (6,)),
        }
        if body.get("derivatives") is not None:
            blocks["derivatives"] = _stacked(body["derivatives"], (6, 6))
        if (flags := body.get("within_tolerance")) is not None:
            blocks["within_tolerance"] = np.array([flag is True for flag in flags], dtype=bool)
        return super().read(
            body,
            **blocks | more,
            wrenches=wrenches,
            coverage=np.array(body["coverage"], dtype=np.str_),
            jobs={
                job["index"]: Job.read(job, body.get("component", ""))
                for job in jobs
                if job.get("id") is not None
            },
            no_job={job["index"]: job.get("reason") or "" for job in jobs if job.get("id") is None},
        )

    @classmethod
    def read_binary(cls, component: str, wrenches: Vector, reply: Response) -> Self:
        """Make the answers from the binary reply to `wrenches`, shape (n, inputs), SI.

        The reply is float64, shape (n, 2 m + 1): displacement and error bars of m outputs, m and
        rad, then coverage as 0, 1 or 2 for `COVERAGE`; with derivatives shape (n, m, inputs)
        follows, du/dw.
        """
        numbers = np.frombuffer(reply.content, dtype="<f8").astype(float)
        count = len(wrenches)
        m = int(reply.headers.get("Wrenchbook-Outputs", 6))
        width = 2 * m + 1
        block = numbers[: width * count].reshape(count, width)
        slopes = numbers[width * count :]

        version, elapsed, jobs = (
            reply.headers.get(f"Wrenchbook-{name}")
            for name in ("Table-Version", "Elapsed-Us", "Jobs")
        )
        within = None
        if (limits := reply.headers.get("Wrenchbook-Tolerance")) is not None:  # m, rad
            allowed = np.repeat([float(limit) for limit in limits.split(",")], 3)
            within = bars_within(block[:, :m], block[:, m:-1], np.resize(allowed, m))

        return super().read(
            {"jobs_queued": int(jobs or 0)},
            component=component,
            wrenches=wrenches,
            displacements=block[:, :m],
            errors=block[:, m:-1],
            coverage=np.array(COVERAGE)[block[:, -1].astype(int)],
            jobs={},
            table_version=None if version is None else int(version),
            elapsed_us=None if elapsed is None else float(elapsed),
            method=reply.headers.get("Wrenchbook-Method"),
            within_tolerance=within,
            derivatives=slopes.reshape(count, m, -1) if len(slopes) else None,
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
        return required("pandas", "to_pandas", "pandas").DataFrame(self._columns())

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


def _stacked(answers: Sequence[Json], shape: tuple[int, ...]) -> Vector:
    """Return the numbers of n answers as one array (n, ...), NaN for answers without any (null).

    `shape` is that of an answer if none has numbers.
    """
    shape = next((np.shape(answer) for answer in answers if answer is not None), shape)
    missing = np.full(shape, np.nan)
    blocks = [missing if answer is None else np.array(answer, dtype=float) for answer in answers]
    return np.array(blocks).reshape(len(answers), *shape)


def _named(names: Sequence[str], block: Vector, word: str) -> Document:
    """Return a block's columns by name; by `word` and index if there are more or fewer."""
    if block.shape[1] != len(names):
        names = [f"{word} {index}" for index in range(block.shape[1])]
    return named_columns(names, block)
