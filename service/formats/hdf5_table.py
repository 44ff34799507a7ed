"""HDF5 tables: the format of the table store, always SI; an upload has further checks."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from wrenchbook.service.formats.cells import text_problem
from wrenchbook.service.formats.column_names import DISPLACEMENT, WritableRows
from wrenchbook.service.formats.options import Options, ReadReport
from wrenchbook.service.formats.table_rows import Array, ParsedTable, Problem, good_rows
from wrenchbook.surrogate.table.hdf5 import foreign_tables, write_table
from wrenchbook.surrogate.table.meta import TableMeta
from wrenchbook.surrogate.table.rows import Rows


def read_hdf5(path: Path, options: Options, report: ReadReport) -> Iterator[ParsedTable]:
    """Yield the good rows of an HDF5 file piece by piece; `report` gets the mistakes."""
    try:
        for rows, notes in foreign_tables(path):
            piece = ParsedTable(
                wrench=rows.wrench,
                displacement=rows.displacement,
                uncertainty=rows.uncertainty,
                compliance=rows.compliance,
                source=tuple(str(text).strip() for text in rows.source),
                note=tuple(note.strip() for note in notes),
                fingerprint=tuple(str(text).strip() for text in rows.fingerprint),
                row=np.arange(1, len(rows) + 1) + report.read,
            )
            good = np.ones(len(piece), dtype=bool)
            for at, key, message in (*_number_problems(piece), *_text_problems(piece)):
                good[at] = False
                report.mistakes.add(int(piece.row[at]), key, message)
            yield good_rows(piece, good, options, report)
            report.read += len(rows)
            if report.is_beyond_limits():
                return
    except (ValueError, RuntimeError, OSError) as error:
        report.mistakes.ruin(0, "file", str(error))
        return
    if not report.read:
        report.mistakes.ruin(0, "file", "there is no row")


def write_hdf5(table: WritableRows, seq: Sequence[int], meta: TableMeta) -> bytes:
    """Return the content of the file of a table; `seq` are the rows' numbers in the ledger."""
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


def _number_problems(piece: ParsedTable) -> Iterator[Problem]:
    """Yield wrong uncertainties and incomplete tangents."""
    bounds = piece.uncertainty
    for at, output in np.argwhere(np.isinf(bounds) | (bounds < 0.0)).tolist():
        message = f"{bounds[at, output]}: an uncertainty of {DISPLACEMENT[output]} is 0 or more"
        yield at, f"uncertainty[{output}]", message
    tangents: Array = piece.compliance.reshape(-1, 36)
    broken = ~np.isfinite(tangents).all(axis=1) & ~np.isnan(tangents).all(axis=1)
    for at in np.flatnonzero(broken).tolist():
        yield at, "compliance", "is not 36 finite numbers; a row has all 36 tangents or none (NaN)"


def _text_problems(piece: ParsedTable) -> Iterator[Problem]:
    columns = {"source": piece.source, "fingerprint": piece.fingerprint, "note": piece.note}
    for key, texts in columns.items():
        for at, text in enumerate(texts):
            if problem := text_problem(text):
                yield at, key, problem
