"""Queries and outcomes, as plain values. All quantities are SI."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from wrenchbook.service.ledger import JobRecord
from wrenchbook.surrogate.table.rows import Tolerance

Floats = NDArray[np.float64]
Wanted = Literal["queue", "wait", "estimate", "reject", "solve"]


class Query(NamedTuple):
    """One question; a tuple, since the main call makes one each time, in a third of the time.

    Attributes
    ----------
    wrench : tuple of floats
        The component's inputs, SI: of one interface N and N·m.
    on_thin : str
        What to do where the table is not thick enough; ``solve`` does not ask the table at all.
    wait_s : float, s
        How long ``wait`` and ``solve`` may take.
    tolerance : Tolerance or None
        The component's own if None.
    method : str or None
        One of `surrogate.answer.METHODS`; the component's own if None.
    detail : bool
        Whether the axes are to be explained.
    beyond_range : bool
        Whether a wrench outside the load range may be solved.
    derivatives : bool
        Whether the outcome has du/dw.
    """

    wrench: tuple[float, ...]
    on_thin: Wanted = "queue"
    wait_s: float = 30.0
    tolerance: Tolerance | None = None
    method: str | None = None
    detail: bool = False
    beyond_range: bool = False
    derivatives: bool = False


@dataclass(frozen=True, slots=True)
class BatchQuery:
    """Many questions at once; as `Query`, with ``wrenches`` of shape (n, inputs), SI."""

    wrenches: Floats
    on_thin: Wanted = "queue"
    wait_s: float = 30.0
    tolerance: Tolerance | None = None
    method: str | None = None
    beyond_range: bool = False
    derivatives: bool = False


@dataclass(slots=True)
class Outcome:
    """One answer.

    Attributes
    ----------
    displacement, error : tuple of floats or None, m and rad
        Six an interface; None, as a whole or a number, where nothing is known.
    coverage : str
        "covered", "thin" or "outside".
    source : str or None
        "table", or the source of the row that answers.
    method : str or None
    table_version : int
    elapsed_us : float
        Time the table took to answer, µs.
    reason : str
        Why not covered, why nothing is queued, or which row answers; may be empty.
    unsolved : bool
        Whether a solve was asked for and has not answered: ask again later.
    job : Job or None
        The solve that answers or will answer; None if none is queued.
    began : float or None
        When the request that has the job began, s since the epoch; later jobs are its own.
    row : int or None
        The ledger's number of the row that a solve gave.
    notes : list of str
        Notes of the solver about that row.
    axes : list or None
        `Surrogate.explain`, if asked for.
    missing : tuple of str
        The outputs that no row of the table holds.
    derivative : ndarray, shape (outputs, inputs), SI, or None
        du/dw if asked for; NaN, or None as a whole, where it is not known.
    method_detail : str
        How the method answers, in words, if asked for.
    within_tolerance : bool or None
        Whether the bars, the solver's share included, are within the tolerance; None if unknown.
    error_parts : dict or None
        What the bars are the sum of, by cause, if asked for.
    error_of_a_reading : dict or None
        The error bars of one more reading, if asked for; None where its noise is not known.
    interfaces : tuple of str
        Their names where there are several.
    """

    component: str
    displacement: tuple[float, ...] | None
    error: tuple[float, ...] | None
    coverage: str
    source: str | None
    method: str | None
    table_version: int
    elapsed_us: float
    reason: str = ""
    unsolved: bool = False
    job: JobRecord | None = None
    began: float | None = None
    row: int | None = None
    notes: list[str] = field(default_factory=list)
    axes: list[dict[str, Any]] | None = None
    missing: tuple[str, ...] = ()
    derivative: Floats | None = None
    method_detail: str | None = None
    within_tolerance: bool | None = None
    error_parts: dict[str, Any] | None = None
    error_of_a_reading: dict[str, Any] | None = None
    interfaces: tuple[str, ...] = ()


def also(reason: str, more: str) -> str:
    """Join two reasons, of which either may be empty."""
    return f"{reason}; {more}" if reason and more else reason or more


@dataclass(frozen=True, slots=True)
class QueuedWrench:
    """The solve of one wrench of a batch: the wrench's number, its job, or why it has none.

    Attributes
    ----------
    index : int
    job : Job or None
    own : bool
        Whether the job solves this very wrench, not one near by.
    reason : str
        ``beyond-range`` or ``queue-limit`` if there is no job.
    """

    index: int
    job: JobRecord | None
    own: bool
    reason: str = ""


@dataclass(slots=True)
class BatchOutcome:
    """Many answers.

    Attributes
    ----------
    displacements, errors : ndarray, shape (n, outputs), m and rad
        NaN where nothing is known.
    coverage : ndarray of uint8, shape (n,)
        0 covered, 1 thin, 2 outside.
    jobs : list of WrenchJob
        One for each wrench that the table did not cover, in their order.
    table_version : int
    elapsed_us : float
        Time the table took to answer, µs.
    method : str
        How the table answers.
    derivatives : ndarray, shape (n, outputs, inputs), SI, or None
        du/dw if asked for; NaN where it is not known.
    tolerance : Tolerance or None
        The limit of the error bars: the query's, else the component's own.
    """

    component: str
    displacements: Floats
    errors: Floats
    coverage: NDArray[np.uint8]
    table_version: int
    elapsed_us: float
    jobs: list[QueuedWrench]
    method: str
    derivatives: Floats | None = None
    tolerance: Tolerance | None = None

    @property
    def unsolved(self) -> bool:
        """Whether a solve that was asked for has not answered."""
        return any(one.job is None or not one.job.is_final for one in self.jobs)
