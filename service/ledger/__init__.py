"""The durable record of jobs and rows; see `Ledger`."""

from wrenchbook.service.ledger.audit import AuditEntry as AuditEntry, noted as noted
from wrenchbook.service.ledger.imports import (
    ImportOrigin as ImportOrigin,
    ImportRecord as ImportRecord,
    ImportSpan as ImportSpan,
    import_numbers as import_numbers,
)
from wrenchbook.service.ledger.ledger import Ledger as Ledger
from wrenchbook.service.ledger.packing import (
    packed as packed,
    row_keys as row_keys,
    unpacked as unpacked,
)
from wrenchbook.service.ledger.records import (
    FINAL as FINAL,
    STATUSES as STATUSES,
    AppendError as AppendError,
    BlockKeyError as BlockKeyError,
    DamagedRowError as DamagedRowError,
    Heartbeat as Heartbeat,
    ImportRunningError as ImportRunningError,
    InvalidTransitionError as InvalidTransitionError,
    JobRecord as JobRecord,
    LedgerBusyError as LedgerBusyError,
    LedgerDamagedError as LedgerDamagedError,
    LedgerError as LedgerError,
    LedgerFileError as LedgerFileError,
    LedgerFullError as LedgerFullError,
    LedgerRow as LedgerRow,
    LedgerUnavailableError as LedgerUnavailableError,
    NotedRows as NotedRows,
    OpenJob as OpenJob,
    Quota as Quota,
    QuotaError as QuotaError,
    ReadOnlyError as ReadOnlyError,
    RowChanges as RowChanges,
    RowEdit as RowEdit,
    RowStatusError as RowStatusError,
    StaleAttemptError as StaleAttemptError,
    Status as Status,
    TableAt as TableAt,
    UnknownImportError as UnknownImportError,
    UnknownJobError as UnknownJobError,
    UnknownRowError as UnknownRowError,
    UnknownVersionError as UnknownVersionError,
)
