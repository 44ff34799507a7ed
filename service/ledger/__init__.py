"""The durable record of jobs and rows; see `Ledger`."""

from service.ledger.errors import (
    InvalidTransitionError,
    LedgerError,
    LedgerFileError,
    LedgerUnavailableError,
    StaleAttemptError,
    UnknownJobError,
    UnknownRowError,
)
from service.ledger.ledger import Ledger
from service.ledger.records import (
    FINAL,
    STATUSES,
    Change,
    Job,
    LedgerRow,
    NewRow,
    OpenJob,
    Status,
)

__all__ = [
    "FINAL",
    "STATUSES",
    "Change",
    "InvalidTransitionError",
    "Job",
    "Ledger",
    "LedgerError",
    "LedgerFileError",
    "LedgerRow",
    "LedgerUnavailableError",
    "NewRow",
    "OpenJob",
    "StaleAttemptError",
    "Status",
    "UnknownJobError",
    "UnknownRowError",
]
