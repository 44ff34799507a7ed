"""The durable record of jobs and rows; see `Ledger`."""

from service.ledger.errors import (
    DamagedRowError,
    InvalidTransitionError,
    LedgerError,
    LedgerFileError,
    LedgerUnavailableError,
    RowStatusError,
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
    News,
    OpenJob,
    RowEdit,
    Status,
)

__all__ = [
    "FINAL",
    "STATUSES",
    "Change",
    "DamagedRowError",
    "InvalidTransitionError",
    "Job",
    "Ledger",
    "LedgerError",
    "LedgerFileError",
    "LedgerRow",
    "LedgerUnavailableError",
    "NewRow",
    "News",
    "OpenJob",
    "RowEdit",
    "RowStatusError",
    "StaleAttemptError",
    "Status",
    "UnknownJobError",
    "UnknownRowError",
]
