"""Tables from outside: SI arrays and named errors out of CSV, XLSX, Parquet, JSON, HDF5, and back.

Functions of a file's content: no HTTP, no ledger. What may stand in a file is said in `header`
(CSV, XLSX, Parquet), `jsonform` and `hdf5form`; the units that a header may name, in `units`; what
no row may exceed, in `limits`.
"""

from service.tablefile.csvread import read_csv
from service.tablefile.csvwrite import write_csv
from service.tablefile.hdf5form import read_hdf5, write_hdf5
from service.tablefile.jsonform import read_json
from service.tablefile.jsonwrite import write_json
from service.tablefile.mistakes import Mistakes, RowError
from service.tablefile.options import FORMATS, Format, Options, Told
from service.tablefile.parsed import ParsedTable, TableRows
from service.tablefile.parts import MOST_PREVIEW, Read, read_fenced
from service.tablefile.reading import read_table_file
from service.tablefile.units import UnitError, si_factor

__all__ = [
    "FORMATS",
    "MOST_PREVIEW",
    "Format",
    "Mistakes",
    "Options",
    "ParsedTable",
    "Read",
    "RowError",
    "TableRows",
    "Told",
    "UnitError",
    "read_csv",
    "read_fenced",
    "read_hdf5",
    "read_json",
    "read_table_file",
    "si_factor",
    "write_csv",
    "write_hdf5",
    "write_json",
]
