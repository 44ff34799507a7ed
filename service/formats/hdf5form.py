"""Tables as HDF5: the form of the table store, with what an upload may not be.

The store's own file is what is sent and taken, so that one file serves both.
Always SI.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from service.formats.jsonform import place_of
from service.formats.limits import excesses
from service.formats.mistakes import RowError
from service.formats.options import Options, Told
from service.formats.parsed import Array, ParsedTable, TableRows, joined, text_problem
from service.formats.spelling import DISPLACEMENT
from surrogate.table.hdf5 import foreign_tables, write_table
from surrogate.table.meta import TableMeta
from surrogate.table.rows import LoadRange, Rows


def write_hdf5(table: TableRows, seq: Sequence[int], meta: TableMeta) -> bytes:
    """Return the file of a table.

    Parameters
    ----------
    table : TableRows
        Rows in SI.
    seq : sequence of int
        The number of each row in the ledger.
    meta : TableMeta
        What the file says about its rows.
    """
    rows = Rows.of(
        table.wrench,
        table.displacement,
        seq=np.array(seq, dtype=np.int64),
        uncertainty=table.uncertainty,
        compliance=table.compliance,
        source=list(table.source),
        fingerprint=list(getattr(table, "fingerprint", ())),
    )
    with tempfile.TemporaryDirectory(prefix="wrenchbook-") as folder:
        path = Path(folder) / "table.h5"
        write_table(path, rows, meta, notes=[str(note) for note in getattr(table, "note", ())])
        return path.read_bytes()


def read_hdf5(content: bytes, *, load_range: LoadRange | None = None) -> ParsedTable:
    """Read an HDF5 table into SI arrays.

    Parameters
    ----------
    content : bytes
        The whole file.
    load_range : LoadRange, optional
        The component's, N and N·m: loads far beyond it are mistakes (see `limits`).

    Returns
    -------
    ParsedTable
        The rows without a mistake, and all mistakes. `RowError.row` is the place in the file's
        columns, from 1, `RowError.field` as for JSON.
    """
    told = Told(format="hdf5")
    with tempfile.TemporaryDirectory(prefix="wrenchbook-") as folder:
        path = Path(folder) / "upload.h5"
        path.write_bytes(content)
        pieces = list(hdf5_file(path, Options(load_range=load_range), told))
    return joined(pieces, told.mistakes)


def hdf5_file(path: Path, options: Options, told: Told) -> Iterator[ParsedTable]:
    """Yield the good rows of an HDF5 file piece by piece; `told` gets what is wrong."""
    try:
        for rows, notes in foreign_tables(path):
            beyond = (
                ()
                if options.tare
                else excesses(rows.wrench, rows.displacement, options.load_range, rows.uncertainty)
            )
            errors = [*_numbers(rows), *_texts(rows, notes)]
            errors += [RowError(x.at + 1, place_of(x.name), x.message) for x in beyond]
            yield _table(rows, notes, errors, told)
            told.read += len(rows)
            if told.is_beyond_limits():
                return
    except (ValueError, RuntimeError, OSError) as error:
        told.mistakes.ruin(RowError(0, "file", str(error)))
        return
    if not told.read:
        told.mistakes.ruin(RowError(0, "file", "there is no row"))


def _numbers(rows: Rows) -> list[RowError]:
    """Name uncertainties below zero or infinite, and tangents that are not whole."""
    errors = []
    bounds = rows.uncertainty
    for at, output in np.argwhere(np.isinf(bounds) | (bounds < 0.0)).tolist():
        message = f"{bounds[at, output]}: an uncertainty of {DISPLACEMENT[output]} is 0 or more"
        errors.append(RowError(at + 1, f"uncertainty[{output}]", message))
    tangents: Array = rows.compliance.reshape(-1, 36)
    broken = ~np.isfinite(tangents).all(axis=1) & ~np.isnan(tangents).all(axis=1)
    for at in np.flatnonzero(broken).tolist():
        message = "is not 36 finite numbers; a row has all 36 tangents or none (NaN)"
        errors.append(RowError(at + 1, "compliance", message))
    return errors


def _texts(rows: Rows, notes: Sequence[str]) -> list[RowError]:
    columns = {"source": rows.source.tolist(), "fingerprint": rows.fingerprint.tolist()}
    return [
        RowError(at, name, problem)
        for name, texts in {**columns, "note": notes}.items()
        for at, text in enumerate(texts, start=1)
        if (problem := text_problem(text))
    ]


def _table(rows: Rows, notes: Sequence[str], errors: list[RowError], told: Told) -> ParsedTable:
    """Keep the rows that no error names."""
    place = np.arange(1, len(rows) + 1)
    kept = ~np.isin(place, [error.row for error in errors])
    told.mistakes.extend(replace(error, row=error.row + told.read) for error in errors)
    told.mistakes.settle()
    good = rows.take(kept)
    return ParsedTable(
        wrench=good.wrench,
        displacement=good.displacement,
        uncertainty=good.uncertainty,
        compliance=good.compliance,
        source=tuple(str(text).strip() for text in good.source),
        note=tuple(note.strip() for note, keep in zip(notes, kept, strict=True) if keep),
        fingerprint=tuple(str(text).strip() for text in good.fingerprint),
        row=place[kept] + told.read,
        errors=(),
    )
