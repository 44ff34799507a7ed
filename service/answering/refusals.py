"""Reasons not to answer a query, each with a remedy."""

from __future__ import annotations

from typing import Any

from wrenchbook.service.ledger import JobRecord


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
    """The table does not cover the wrench, and the query takes no other answer."""


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
