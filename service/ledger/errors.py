"""What can go wrong with the ledger; each message says what to do."""


class LedgerError(Exception):
    """Base of every error the ledger raises on purpose."""


class LedgerFileError(LedgerError):
    """The file is not a ledger this program can read: foreign, damaged or newer."""


class LedgerUnavailableError(LedgerError):
    """The ledger could not be read or written now (disk full, locked); nothing was changed."""


class UnknownJobError(LedgerError, LookupError):
    """There is no job with this number."""


class UnknownRowError(LedgerError, LookupError):
    """There is no row with this seq."""


class InvalidTransitionError(LedgerError):
    """The job's status does not allow this; see the table in ``service.ledger.states``."""


class StaleAttemptError(InvalidTransitionError):
    """The report is about an attempt that the job has left behind; drop it."""


class DamagedRowError(LedgerError):
    """The row on disk is not the row that was written; it is used nowhere."""


class RowStatusError(LedgerError):
    """The row is withdrawn already, or is not."""
