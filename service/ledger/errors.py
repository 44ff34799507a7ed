"""What can go wrong with the ledger; each message says what to do."""


class LedgerError(Exception):
    """Base of every error the ledger raises on purpose."""


class LedgerFileError(LedgerError):
    """The file is not a ledger this program can read: foreign, damaged or newer."""


class LedgerDamagedError(LedgerFileError):
    """The file is a ledger, or was one, and its bytes are not those that were written."""


class LedgerUnavailableError(LedgerError):
    """The ledger could not be read or written now (disk full, locked); nothing was changed."""


class LedgerFullError(LedgerUnavailableError):
    """The disk has no room for what was to be written; nothing was changed."""


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


class BlockKeyError(LedgerError):
    """A block of wrenches has a key that says nothing about whether it was recorded."""


class ImportRunningError(LedgerError):
    """Another import has the ledger for too long; nothing was loaded."""


class UnknownVersionError(LedgerError, LookupError):
    """The table has no such version, or none yet."""
