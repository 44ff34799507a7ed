"""A table file of any form: from a path to pieces of SI arrays, in bounded memory.

Plain functions of a file and what its sender says, so that a process with limits of its own can run
them: nothing here knows a ledger or a request.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

from service.formats.content import ContentError, format_of, is_gzip, unpack
from service.formats.csvread import csv_file
from service.formats.hdf5form import hdf5_file
from service.formats.jsonform import json_file
from service.formats.mistakes import RowError
from service.formats.options import Format, Options, Told
from service.formats.parquetread import parquet_file
from service.formats.parsed import ParsedTable
from service.formats.placement import well_placed
from service.formats.tare import tared
from service.formats.xlsxread import xlsx_file

Reader = Callable[[Path, Options, Told], Iterator[ParsedTable]]
_READERS: dict[Format, Reader] = {
    "csv": csv_file,
    "xlsx": xlsx_file,
    "parquet": parquet_file,
    "hdf5": hdf5_file,
    "json": json_file,
}
_TEXTS = ("csv", "json")  # what one of them is called may be the other one, broken


def read_table_file(path: Path, options: Options, told: Told) -> Iterator[ParsedTable]:
    """Yield the rows of a table file that may be loaded, piece by piece.

    Parameters
    ----------
    path : path
        The file; a gzipped one is unpacked beside it.
    options : Options
    told : Told
        Gets all there is to say about the file; it is whole once the last piece has been given.
    """
    pieces = tared(columns_of(path, options, told), options, told)
    yield from well_placed(pieces, options, told)


def columns_of(path: Path, options: Options, told: Told) -> Iterator[ParsedTable]:
    """Yield the rows of a file as they stand in it: without tare, and whatever they solve."""
    try:
        plain = _plain(path, told)
        told.format = _format(plain, options)
    except ContentError as error:
        told.mistakes.ruin(RowError(0, "file", str(error)))
        return
    if options.role != "table" and told.format in ("json", "hdf5"):
        message = f"a log with a time is CSV, XLSX or Parquet, and this is {told.format}"
        told.mistakes.ruin(RowError(0, "file", message))
        return
    yield from _READERS[told.format](plain, options, told)


def _plain(path: Path, told: Told) -> Path:
    """Return the file, unpacked if it is gzipped."""
    if path.stat().st_size == 0:
        raise ContentError("the file is empty")
    if not is_gzip(path):
        return path
    told.gzip = True
    plain = path.with_name(f"{path.name}.plain")
    unpack(path, plain)
    return plain


def _format(path: Path, options: Options) -> Format:
    found = format_of(path)
    said = options.format
    if said is None or said == found:
        return found
    if said in _TEXTS and found in _TEXTS:
        return said
    raise ContentError(f"is {found} by its content, not {said}; leave the format out")
