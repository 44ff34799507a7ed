"""Tables from outside: CSV and JSON text in, SI arrays and named errors out, and back.

Pure functions on text: no HTTP, no ledger. What may stand in a file is said in `csvread` and
`jsonform`; the units that a CSV header may name, in `units`.
"""

from service.tablefile.csvread import read_csv
from service.tablefile.csvwrite import write_csv
from service.tablefile.jsonform import read_json, write_json
from service.tablefile.parsed import (
    ROTATION_LIMIT,
    ParsedTable,
    RowError,
    TableRows,
)
from service.tablefile.units import UnitError, si_factor

__all__ = [
    "ROTATION_LIMIT",
    "ParsedTable",
    "RowError",
    "TableRows",
    "UnitError",
    "read_csv",
    "read_json",
    "si_factor",
    "write_csv",
    "write_json",
]
