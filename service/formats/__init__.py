"""Tables from outside: SI arrays and named errors out of CSV, XLSX, Parquet, JSON, HDF5, and back.

Functions of a file's content: no HTTP, no ledger. What may stand in a file is said in `header`
(CSV, XLSX, Parquet), `jsonform` and `hdf5form`; the units that a header may name, in `units`; what
no row may exceed, in `limits`.
"""

from service.formats.csvread import read_csv
from service.formats.csvwrite import write_csv
from service.formats.hdf5form import read_hdf5, write_hdf5
from service.formats.jsonform import read_json
from service.formats.jsonwrite import write_json
from service.formats.mistakes import Mistakes, RowError
from service.formats.options import FORMATS, Format, Options, Told
from service.formats.parsed import ParsedTable, TableRows
from service.formats.parts import MOST_PREVIEW, Read, read_fenced
from service.formats.reading import read_table_file
from service.formats.units import UnitError, si_factor

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
