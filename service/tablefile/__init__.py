"""Tables from outside: CSV, JSON and HDF5 in, SI arrays and named errors out, and back.

Functions of a file's content: no HTTP, no ledger. What may stand in a file is said in `csvread`,
`jsonform` and `hdf5form`; the units that a CSV header may name, in `units`; what no row may exceed,
in `limits`.
"""

from service.tablefile.csvread import read_csv
from service.tablefile.csvwrite import write_csv
from service.tablefile.hdf5form import read_hdf5, write_hdf5
from service.tablefile.jsonform import read_json, write_json
from service.tablefile.limits import ROTATION_LIMIT, TRANSLATION_LIMIT
from service.tablefile.parsed import ParsedTable, RowError, TableRows
from service.tablefile.units import UnitError, si_factor

__all__ = [
    "ROTATION_LIMIT",
    "TRANSLATION_LIMIT",
    "ParsedTable",
    "RowError",
    "TableRows",
    "UnitError",
    "read_csv",
    "read_hdf5",
    "read_json",
    "si_factor",
    "write_csv",
    "write_hdf5",
    "write_json",
]
