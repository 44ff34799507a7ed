"""CSV, XLSX, Parquet, JSON, HDF5 and MAT files to rows in SI with named mistakes, and back."""

from wrenchbook.service.formats.cells import UnitError, chosen_units, text_problem
from wrenchbook.service.formats.columnar import write_hdf5, write_parquet
from wrenchbook.service.formats.columns import Layout, layout
from wrenchbook.service.formats.csv import csv_text
from wrenchbook.service.formats.json import json_text
from wrenchbook.service.formats.options import MAX_ZERO_ROWS, Options, ParsedTable
from wrenchbook.service.formats.read import MAX_PREVIEW, ReadResult, read_untrusted
from wrenchbook.service.formats.xlsx import SheetFullError, write_xlsx

__all__ = [
    "MAX_PREVIEW",
    "MAX_ZERO_ROWS",
    "Layout",
    "Options",
    "ParsedTable",
    "ReadResult",
    "SheetFullError",
    "UnitError",
    "chosen_units",
    "csv_text",
    "json_text",
    "layout",
    "read_untrusted",
    "text_problem",
    "write_hdf5",
    "write_parquet",
    "write_xlsx",
]
