"""Reasons not to answer a query, each with a remedy."""

from __future__ import annotations

from typing import Any

from wrenchbook.service.ledger import JobRecord
from wrenchbook.surrogate.table.rows import Tolerance


class RefusedError(Exception):
    """Base of the refusals.

    Attributes
    ----------
    facts : dict
        What a program may want to know of it.
    """

    def __init__(self, message: str, **facts: Any) -> None:
        super().__init__(message)
        self.facts = facts


class NotCoveredError(RefusedError):
    """The table does not cover the wrench, and the query takes no other answer.

    Its facts have the tolerance that was applied, m and rad; null where there is none.
    """

    def __init__(self, message: str, limit: Tolerance | None, **facts: Any) -> None:
        if limit is not None:
            message = f"{message} Tolerance: {limit.translation:g} m, {limit.rotation:g} rad."
            facts["tolerance"] = {"translation": limit.translation, "rotation": limit.rotation}
        super().__init__(message, **{"tolerance": None, **facts})


class BeyondRangeError(RefusedError):
    """The wrench is outside the load range, and the query did not say that it may be."""


class SolveFailedError(RefusedError):
    """The solve of this wrench failed."""

    def __init__(self, job: JobRecord) -> None:
        error = job.error or {}
        message, remedy = error.get("message", ""), error.get("remedy", "")
        # Failures that older versions stored end in their remedy already.
        text = message if message.endswith(remedy) else f"{message} {remedy}"
        retry = f"Once mended, POST /v1/jobs/{job.id}/retry."
        super().__init__(f"{text} {retry}".strip(), error=error)
        self.kind = error.get("kind", "unknown")
        self.job = job
