"""What a table file says about its rows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from .axes import OffAxis
from .rows import LoadRange, Tolerance

SCHEMA_VERSION = 2  # 1 had no digest
CONTRACT = (
    "SI: N, N·m, m, rad. Order: force then moment; translation then rotation. The wrench acts ON "
    "the deformable component at the interface reference point where it is now (it moves with the "
    "section), in axes fixed to the undeformed interface frame; the moment is about that point. "
    "The displacement is of the same point in the same axes; the rotation is a rotation vector, "
    "applied as R0 exp(r)."
)


@dataclass(frozen=True)
class TableMeta:
    """What a table file says about its rows.

    Attributes
    ----------
    component : str
    last_seq : int
        The ledger's number up to which rows are in the file.
    load_range : LoadRange
        N and N·m.
    fingerprint : str
        Of the component's present set-up; each row carries its own.
    title : str
    schema_version : int
    contract : str
        Order, units, frame and sign in words.
    tolerance : Tolerance or None, m and rad
        The component's own; with `linear` and `off_axis` what a surrogate is built with.
    linear : bool
        Whether the component is linear.
    off_axis : {"correct", "ignore", "exclude"}
        What becomes of rows that are clean for no axis.
    ledger : str
        Digest of the ledger's rows up to `last_seq`: a file that another ledger wrote, or this
        one before it lost rows, is recognised by it.
    edits : tuple of (str, bool, float), or None
        The newest withdrawal or restoring of each row that had one: the row's content key in
        hexadecimal, whether it is withdrawn, when (seconds since the epoch). Withdrawn rows are
        not among the file's rows, so nothing else tells a ledger that was put back from an older
        copy. None if they were not known.
    solver_error : mapping or None
        What the solver of the rows may be wrong by, as `surrogate.solver_error` reads it; None if
        no solve has estimated it.
    locked : tuple of int
        Places, in `LOADS`, of the loads on locked freedoms: answers leave these loads out. The file
        has the names of the freedoms; a file of an older version has none, and no load is locked.
    """

    component: str
    last_seq: int
    load_range: LoadRange
    fingerprint: str = ""
    title: str = ""
    schema_version: int = SCHEMA_VERSION
    contract: str = CONTRACT
    tolerance: Tolerance | None = None
    linear: bool = False
    off_axis: OffAxis = "correct"
    ledger: str = ""
    edits: tuple[tuple[str, bool, float], ...] | None = None
    solver_error: Mapping[str, Any] | None = None
    locked: tuple[int, ...] = ()
