"""The durable record of jobs, rows and imports: `Ledger`, its records and its errors.

Code that adds tables or transactions of its own also imports `connection.Connection` and
`audit.note`; code that reports disk errors imports `connection.with_remedy`.
"""

from wrenchbook.service.ledger.audit import noted as noted
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
    LedgerFullError as LedgerFullError,
    LedgerRow as LedgerRow,
    LedgerUnavailableError as LedgerUnavailableError,
    NotedRows as NotedRows,
    OpenJob as OpenJob,
    Quota as Quota,
    QuotaError as QuotaError,
    ReadOnlyError as ReadOnlyError,
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
